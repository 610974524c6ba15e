"""The wrench at the wrist: what it is at rest and under load, in both engines, and where it is told."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import reachlab  # noqa: F401 (registers the environments)
from params import tried
from reachlab.agents.acting import make_act
from reachlab.cli import main as cli
from reachlab.deploy.check import load_controller, start_controller
from reachlab.deploy.export import write_files
from reachlab.deploy.ros2 import PolicyNode
from reachlab.deploy.topics import Topics
from reachlab.emit.behaviour import rows_of
from reachlab.envs.consistency import check
from reachlab.envs.core import Env
from reachlab.envs.delays import WRENCH_NOISE
from reachlab.envs.functions import EnvState
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import REPORT_STREAM, env_keys, episode_keys
from reachlab.evaluation.report import evaluate
from reachlab.learn.learner import make_initial_policy
from reachlab.settings.validation import InputError
from reachlab.sims.mujoco_model import physics_model
from reachlab.watch.page.shown import why_streamed

G, ENVS = 9.81, 4

ENGINES = ("mujoco", "pybullet")


def made(task: str = "lift", sim: str = "mujoco", robot: str = "panda", **settings: Any) -> Env:
    if sim == "pybullet":
        pytest.importorskip("pybullet")
    given = {"randomise": (), "wrench": True, **settings}
    return Env(configure(task, robot=robot, sim=sim, **given), ENVS)


def begun(env: Env) -> EnvState:
    return env.compile_whole(env.init)(episode_keys(0, REPORT_STREAM, 0, ENVS))


def held(env: Env, state: EnvState, steps: int) -> EnvState:
    """The state after steps in which the arm is held where it is."""
    idle = np.zeros((ENVS, len(env.action_bounds[0])), np.float32)
    for _ in range(steps):
        state, _ = env.step(state, idle, instead=state.command)
    return state


def weight(env: Env, state: EnvState, row: int) -> tuple[np.ndarray, float]:
    """Wrench `[6]` of the weight of what the last joint holds, and its mass [kg], by the model alone."""
    model = physics_model(env.setup.robot, env.config.physics)
    data, n = mujoco.MjData(model), env.setup.robot.chain.n
    posture = env.setup.robot.posture(np.asarray(state.arm.actuated, float)[row])
    data.qpos[: len(posture)] = posture
    mujoco.mj_forward(model, data)
    body = model.jnt_bodyid[n - 1]
    mass, turn = model.body_subtreemass[body], data.xmat[body].reshape(3, 3)
    pull = np.array([0.0, 0.0, -mass * G])
    return np.concatenate([pull @ turn, np.cross(data.subtree_com[body] - data.xpos[body], pull) @ turn]), mass


def assert_rests(env: Env, state: EnvState) -> None:
    for row, felt in enumerate(np.asarray(state.arm.wrench)):
        expected, mass = weight(env, state, row)
        assert felt[:3] == pytest.approx(expected[:3], abs=0.01 * mass * G)
        assert felt[3:] == pytest.approx(expected[3:], abs=0.01 * mass * G * 0.1)


# --- what it is -------------------------------------------------------------------------------------


@pytest.mark.parametrize("sim", ENGINES)
@pytest.mark.parametrize("robot", tried(["panda", "so101", "ur5e"], ["panda", "so101"]))
def test_at_rest_it_is_the_weight_of_what_the_last_joint_holds_and_its_lever(robot: str, sim: str) -> None:
    """After a reset, and when the arm has been held for a second; the cube lies on the table, and is not felt."""
    env = made("push", sim, robot)
    state = begun(env)
    assert_rests(env, state)
    assert_rests(env, held(env, state, 50))
    env.close()


def test_an_arm_without_compensation_feels_the_same_weight() -> None:
    env = made("precise", gravity_compensation=False)
    assert_rests(env, held(env, begun(env), 150))
    env.close()


@pytest.mark.parametrize("sim", ENGINES)
def test_a_cube_that_is_gripped_and_lifted_adds_its_weight(sim: str) -> None:
    env = made("lift", sim, object_mass=0.3)
    state, act, key, success = begun(env), make_act(env, "ik"), jax.random.key(0), np.zeros(ENVS, bool)
    for _ in range(env.config.rules.max_steps - 1):
        state, transition, key = act(None, state, key)
        success = np.asarray(transition.terms["success"])
    lifted = np.asarray(state.arm.bodies.position)[:, -1, 2] > env.setup.robot.table_top + 0.06
    assert lifted.any()
    assert success[lifted].all()
    for row in np.flatnonzero(lifted).tolist():
        expected, mass = weight(env, state, row)
        felt = np.asarray(state.arm.wrench)[row]
        assert np.linalg.norm(felt[:3]) == pytest.approx((mass + 0.3) * G, rel=0.01)
        out = felt[:3] / np.linalg.norm(felt[:3])
        assert out @ expected[:3] / np.linalg.norm(expected[:3]) > 0.999, "it pulls down"
        # It is held below the middle of the hand: a few millimetres off are some thousandths of a newton metre.
        assert felt[3:] == pytest.approx(expected[3:], abs=0.02 + 0.3 * G * 0.25 * 0.1)
    env.close()


def test_both_engines_agree_at_rest_and_under_the_same_load() -> None:
    felt = {}
    for sim in ENGINES:
        env = made("lift", sim)
        state, act, key = begun(env), make_act(env, "ik"), jax.random.key(0)
        rest = np.asarray(held(env, state, 40).arm.wrench)
        for _ in range(env.config.rules.max_steps - 1):
            state, _, key = act(None, state, key)
        # What rests on the table too is held up by both, in shares that no law of statics tells.
        lifted = np.asarray(state.arm.bodies.position)[:, -1, 2] > env.setup.robot.table_top + 0.06
        assert lifted.sum() > 1
        felt[sim] = rest, np.asarray(state.arm.wrench)[lifted]
        env.close()
    for ours, theirs in zip(*felt.values(), strict=True):
        assert ours[:, :3] == pytest.approx(theirs[:, :3], abs=0.02 * 15)  # of 15 N
        assert ours[:, 3:] == pytest.approx(theirs[:, 3:], abs=0.01)


@pytest.mark.parametrize("sim", ENGINES)
def test_a_hand_that_presses_on_the_table_is_pushed_up(sim: str) -> None:
    env = made("push", sim, start_noise=0.0)
    state = begun(env)
    down, (_, mass) = np.asarray(state.command).copy(), weight(env, state, 0)
    # By the joints that bring the tool straight down, 3 mm into the table.
    deep = float(np.asarray(state.arm.tool_position)[0, 2]) - env.setup.robot.table_top
    model = physics_model(env.setup.robot, env.config.physics)
    data, n, jacobian = mujoco.MjData(model), env.setup.robot.chain.n, np.zeros((3, model.nv))
    q = down[0, :n].astype(float)
    for _ in range(50):
        data.qpos[:n] = q
        mujoco.mj_forward(model, data)
        site = model.site(env.setup.robot.tool).id
        mujoco.mj_jacSite(model, data, jacobian, None, site)
        wanted = np.array(state.arm.tool_position)[0] - [0, 0, deep - 0.005] - data.site_xpos[site]
        q += np.linalg.pinv(jacobian[:, :n]) @ np.clip(wanted, -0.02, 0.02)
    idle = np.zeros((ENVS, len(env.action_bounds[0])), np.float32)
    for share in np.linspace(0.0, 1.0, 60):
        command = np.asarray(state.command).copy()
        command[:, :n] = down[:, :n] + share * (q - down[0, :n])
        state, _ = env.step(state, idle, instead=jnp.asarray(command, jnp.float32))
    state = held(env, state, 30)
    felt = np.asarray(state.arm.wrench)[0]
    expected, _ = weight(env, state, 0)
    up = -expected[:3] / np.linalg.norm(expected[:3])
    assert (felt - expected)[:3] @ up > 2.0
    assert mass * G > 5.0
    env.close()


# --- where it is told -------------------------------------------------------------------------------


@pytest.mark.parametrize("sim", ENGINES)
def test_the_observation_is_within_its_bounds_and_repeats(sim: str) -> None:
    def played() -> tuple[np.ndarray, Any]:
        env = made("push", sim)
        state, seen = begun(env), []
        actions = np.random.default_rng(0).uniform(*env.action_bounds, (30, ENVS, len(env.action_bounds[0])))
        for action in actions.astype(np.float32):
            state, transition = env.step(state, action)
            seen.append(np.asarray(transition.observation))
        low, high = env.schema.bounds
        env.close()
        return np.array(seen), (low, high)

    seen, (low, high) = played()
    assert ((low <= seen) & (seen <= high)).all()
    assert np.ptp(seen[..., :6], axis=0).min() > 0, "no number stays the same"
    assert (played()[0] == seen).all()


def test_what_is_beyond_a_sensors_range_is_observed_at_its_end() -> None:
    env = made()
    state, (low, high) = begun(env), env.schema.bounds
    struck = replace(state, arm=replace(state.arm, wrench=1e4 * jnp.array([[1.0, -1.0] * 3] * ENVS)))
    assert (np.asarray(env.observe(struck))[:, :6] == np.where(np.arange(6) % 2, low[:6], high[:6])).all()
    env.close()


def test_environments_of_a_batch_are_the_single_ones_and_those_that_go_on_keep_theirs() -> None:
    env, alone = made(), Env(configure("lift", robot="panda", wrench=True, randomise=()), 1)
    together = held(env, env.init(env_keys(5, ENVS)), 5)
    single = alone.init(env_keys(7, 1))
    for _ in range(5):
        single, _ = alone.step(single, np.zeros((1, len(env.action_bounds[0])), np.float32), instead=single.command)
    assert np.asarray(together.arm.wrench)[2] == pytest.approx(np.asarray(single.arm.wrench)[0], abs=1e-5)
    mask = np.array([True, False, True, False])
    after = env.reset(together, mask)
    assert (np.asarray(after.arm.wrench)[~mask] == np.asarray(together.arm.wrench)[~mask]).all()
    assert (np.asarray(after.arm.wrench)[mask] != np.asarray(together.arm.wrench)[mask]).any()
    # Any state is continued from as it was.
    on, again = held(env, together, 3), held(env, together, 3)
    assert (np.asarray(on.arm.wrench) == np.asarray(again.arm.wrench)).all()
    for one in (env, alone):
        one.close()


def test_noise_is_that_of_a_sensor_where_dynamics_vary_and_none_otherwise() -> None:
    env = made()
    state = begun(env)
    assert (np.asarray(env.observe(state))[:, :6] == np.asarray(state.arm.wrench)).all()
    noisy, truly, seen = replace(env.functions, randomise=("dynamics",)), np.asarray(state.arm.wrench), []
    for step in range(100):
        felt = noisy.situation(replace(state, clock=jnp.full(ENVS, step))).wrench
        seen.append(np.asarray(felt) - truly)
    assert np.concatenate(seen).std(axis=0) == pytest.approx(WRENCH_NOISE, rel=0.15)
    env.close()


def test_without_the_setting_nothing_is_measured() -> None:
    env = made(wrench=False)
    state = held(env, begun(env), 1)
    assert state.arm.wrench is None
    assert "wrench" not in [field.name for field in env.schema.fields]
    assert env.simulator._model.nsensor == 0  # type: ignore[attr-defined]
    env.close()


@pytest.mark.parametrize(
    ("task", "sim", "sentence"),
    [
        ("push", "kinematic", "setting wrench needs a wrench that is measured, as in simulator mujoco, or in"),
        ("precise", "kinematic", "setting wrench needs a wrench that is measured, as in simulator mujoco, or in"),
    ],
)
def test_a_simulator_that_cannot_measure_it_is_refused(task: str, sim: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        check(configure(task, sim=sim, wrench=True))


def test_pybullet_refuses_it_where_it_sets_joints() -> None:
    pytest.importorskip("pybullet")
    with pytest.raises(InputError, match="'pybullet' measures no wrench where it sets joints, without an object"):
        Env(configure("precise", sim="pybullet", wrench=True), 1)


def test_gymnasium_tells_it() -> None:
    env = gymnasium.make("reachlab/Reach-v0", task="push", robot="panda", wrench=True, disable_env_checker=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)
    observation, info = env.reset(seed=3)
    assert (info["wrench"] == observation[:6]).all()
    assert info["wrench"].shape == (6,)
    env.close()
    batch = gymnasium.make_vec("reachlab/Reach-v0", num_envs=3, task="push", robot="panda", wrench=True)
    _, infos = batch.reset(seed=3)
    assert infos["wrench"].shape == (3, 6)
    assert infos["_wrench"].all()
    assert infos["wrench"][0] == pytest.approx(info["wrench"], abs=1e-5)
    batch.close()


@pytest.mark.parametrize("measured", [True, False])
def test_a_report_has_the_largest_force_where_it_is_measured(
    capsys: pytest.CaptureFixture[str], *, measured: bool
) -> None:
    words = ["eval", "--task", "lift", "--robot", "panda", "--agent", "ik", "--episodes", "8"]
    assert cli.main([*words, *["--wrench", "True"] * measured]) == 0
    assert ("N at the wrist in the median episode" in capsys.readouterr().out) == measured
    env = made(wrench=measured)
    report = json.loads(json.dumps(evaluate(env, "ik", episodes=ENVS).to_json()))
    assert (report["largest_force_n"] is None) != measured
    if measured:
        force = report["largest_force_n"]
        assert 15.0 < force["median"] <= force["p95"] <= force["max"] < 60.0
    env.close()


def test_a_policy_is_not_evaluated_with_a_wrench_that_it_does_not_know(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["eval", "panda/push", "--wrench", "True", "--episodes", "2"]) == 2
    assert "a policy observes the wrench or not as it was trained" in capsys.readouterr().err


# --- out to a robot ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Env, Any]:
    folder = tmp_path_factory.mktemp("wrench")
    env = made("push", hidden=(16,), shaping=True)
    policy = make_initial_policy(env.config, env, jax.random.key(0))
    write_files(folder, env, policy, {"run": {}, "held_out": [], "versions": {}})
    return folder, env, policy


def told(state: EnvState) -> dict[str, Any]:
    given = next(rows_of(state, None, ["q", "qd", "goal_position"]))
    bodies = state.arm.bodies
    thing = {name: np.asarray(getattr(bodies, name), float)[0, -1] for name in ("position", "quaternion", "half")}
    return {"q": given["q"], "qd": given["qd"], "goal": given["goal_position"], "objects": [thing]}


def test_the_controller_takes_what_the_environment_measures(exported: tuple[Path, Env, Any]) -> None:
    folder, env, policy = exported
    assert json.loads((folder / "policy.json").read_text())["wrench"]["frame"] == "link_7"
    controller, act, key = load_controller(folder).Controller(folder), make_act(env, "trained"), jax.random.key(0)
    state = begun(env)
    controller.reset(np.asarray(state.arm.actuated, float)[0])
    for step in range(30):
        wrench = np.asarray(state.arm.wrench, float)[0]
        command = controller.step(time=step * controller.period, wrench=wrench, **told(state))
        assert controller.problem == ""
        state, _, key = act(policy, state, key)
        assert command == pytest.approx(np.asarray(state.command)[0], abs=1e-5)


MISSING: dict[str, Callable[[np.ndarray], Any]] = {
    "none": lambda _: None,
    "short": lambda wrench: wrench[:5],
    "not finite": lambda wrench: wrench * np.nan,
    "no numbers": lambda _: "strong",
}


@pytest.mark.parametrize("name", MISSING)
def test_without_it_the_controller_brakes_and_says_why(exported: tuple[Path, Env, Any], name: str) -> None:
    folder, env, _ = exported
    controller, state = load_controller(folder).Controller(folder), begun(env)
    controller.reset(np.asarray(state.arm.actuated, float)[0])
    wrench = np.asarray(state.arm.wrench, float)[0]
    for step, given in enumerate((wrench, MISSING[name](wrench))):
        controller.step(time=step * controller.period, wrench=given, **told(state))
    assert controller.braking
    assert controller.problem.startswith("the policy needs the wrench at the wrist, 6 finite numbers [N, Nm]")


@pytest.mark.parametrize("age", [0.0, 0.3])
def test_over_ros_2_it_has_a_topic_and_counts_as_long_as_it_is_new(
    exported: tuple[Path, Env, Any], age: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rclpy")
    from geometry_msgs.msg import WrenchStamped
    from sensor_msgs.msg import JointState

    taken: dict[str, Any] = {}
    node = SimpleNamespace(
        create_publisher=lambda *_: SimpleNamespace(publish=lambda _: None),
        create_subscription=lambda kind, topic, act, _: taken.update({topic: (kind, act)}),
        create_timer=lambda *_: None,
        get_logger=lambda: SimpleNamespace(warning=lambda _: None),
    )
    controller, told, now = load_controller(exported[0]).Controller(exported[0]), list[Any](), 100.0
    monkeypatch.setattr(controller, "step", lambda *_, **beside: told.append(beside) or controller.home)
    monkeypatch.setattr("reachlab.deploy.ros2.time", SimpleNamespace(monotonic=lambda: now))
    policy = PolicyNode(node, controller, Topics(), trajectory=False, feels=True)
    kind, felt = taken[Topics().wrenches]
    assert kind is WrenchStamped
    message = WrenchStamped()
    force, torque = message.wrench.force, message.wrench.torque
    force.x, force.y, force.z, torque.x, torque.y, torque.z = range(6)
    felt(message)
    now += age
    home = controller.home.tolist()
    policy._on_joints(JointState(name=controller.joints, position=home, velocity=[0.0] * len(home)))
    assert told == [{"wrench": [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]} if age < 0.2 else {}]


def test_who_does_not_measure_it_does_not_drive_an_arm_by_it(exported: tuple[Path, Env, Any]) -> None:
    with pytest.raises(InputError, match="observes the wrench at the wrist, which is not measured here: call"):
        start_controller(exported[0])
    assert start_controller(exported[0], feels=True).problem == ""


def test_a_page_does_not_measure_it() -> None:
    assert "measures no wrench" in why_streamed(configure("push", wrench=True), "trained")
