"""Policies that remember: what they compute, that nothing is remembered across episodes, and what they can learn."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reachlab.agents.acting import make_act
from reachlab.agents.memory import Cell
from reachlab.agents.policy import Inputs, Policy, features, gaussian, remembered
from reachlab.cli import train_command
from reachlab.cli.flags import Distil
from reachlab.deploy.check import load_controller
from reachlab.deploy.export import write_files
from reachlab.deploy.onnx_network import OnnxNetwork
from reachlab.envs.consistency import check
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import REPORT_STREAM, env_keys, episode_keys
from reachlab.jax_setup import jit
from reachlab.learn import ppo
from reachlab.learn.learner import make_initial_policy
from reachlab.learn.ppo_method import initial_state
from reachlab.learn.rollout import collect
from reachlab.learn.train import train
from reachlab.settings.config import RunConfig
from reachlab.settings.validation import InputError
from reachlab.watch.page.shown import why_streamed

SIZE, B, T = 8, 8, 40
"""Numbers that are remembered, environments, and steps in each."""

SHORT: dict[str, Any] = {"num_envs": B, "rollout_steps": T, "hidden": (16,), "memory": SIZE, "max_steps": 15}
"""Episodes of which several end in a rollout."""


def untrained(config: RunConfig, env: Env, seed: int = 0) -> Policy:
    """A policy whose actions depend on what it observes and remembers."""
    policy = env.compile_part(lambda key: make_initial_policy(config, env, key))(jax.random.key(seed))
    random = np.random.default_rng(seed)
    noise = jax.tree.map(lambda x: (x + 0.2 * random.normal(size=x.shape)).astype(x.dtype), policy.parameters)
    return replace(policy, parameters=noise)


# --- the unit ---------------------------------------------------------------------------------------


def test_a_sequence_is_its_steps_and_begins_anew_where_it_should() -> None:
    cell = Cell.make(jax.random.key(0), 3, SIZE)
    x = np.asarray(jax.random.normal(jax.random.key(1), (T, B, 3)))
    begins = np.asarray(jax.random.uniform(jax.random.key(2), (T, B)) < 0.1)
    memory = first = np.asarray(jax.random.normal(jax.random.key(3), (B, SIZE)))
    together = np.asarray(jit(cell.over)(first, x, begins))
    one = jit(cell.__call__)
    for t in range(T):
        memory = np.asarray(one(np.where(begins[t][:, None], 0, memory), x[t]))
        assert memory == pytest.approx(together[t], abs=1e-5)


def test_its_gates_are_those_of_torch() -> None:
    torch = pytest.importorskip("torch")
    cell = Cell.make(jax.random.key(0), 3, SIZE)
    gates = [cell.reset, cell.keep, cell.new]
    other = torch.nn.GRUCell(3, SIZE)
    with torch.no_grad():
        for name, part in (("weight_ih", "given"), ("weight_hh", "kept")):
            rows = np.concatenate([np.asarray(getattr(gate, part)).T for gate in gates])
            getattr(other, name).copy_(torch.tensor(rows))
        other.bias_ih.copy_(torch.tensor(np.concatenate([gate.bias for gate in gates])))
        zero = np.zeros(2 * SIZE, np.float32)
        other.bias_hh.copy_(torch.tensor(np.concatenate([zero, np.asarray(cell.kept_bias)])))
        x, memory = (np.random.default_rng(i).normal(size=(B, n)).astype(np.float32) for i, n in ((0, 3), (1, SIZE)))
        expected = other(torch.tensor(x), torch.tensor(memory)).numpy()
    assert np.asarray(cell(jnp.asarray(memory), jnp.asarray(x))) == pytest.approx(expected, abs=1e-6)


# --- learning ---------------------------------------------------------------------------------------


def test_an_update_computes_what_the_rollout_did() -> None:
    config = configure("tutorial", **SHORT)
    env = Env(config, B)
    state = env.compile_part(lambda seed: initial_state(env, config, seed))(np.uint32(0))
    policy = untrained(config, env)
    gather = env.compile_whole(lambda state, key: collect(env, policy, state, key, config.loop))
    before = replace(state.env, memory=jnp.ones((B, SIZE)))
    after, rollout = gather(before, jax.random.key(1))
    batch = jit(lambda rollout: ppo._samples(policy, rollout, config.ppo))(rollout)
    assert np.asarray(rollout.done).sum() > B
    assert np.asarray(batch.inputs.begins).any()
    head = gaussian(policy.parameters, features(policy.parameters, batch.inputs))
    assert np.asarray(head.log_prob(batch.output)) == pytest.approx(np.asarray(rollout.log_prob), abs=2e-4)
    begun = np.asarray(rollout.clock) == 1
    assert not np.asarray(rollout.memory)[begun][B:].any()  # the first B of them went on from what was given
    assert np.asarray(rollout.memory)[~begun].any(axis=-1).all()
    assert np.asarray(after.memory).shape == (B, SIZE)


def test_without_memory_nothing_is_there() -> None:
    config = configure("tutorial", num_envs=B, hidden=(16,))
    env = Env(config, B)
    policy = untrained(config, env)
    assert policy.parameters.memory is None
    assert policy.initial(B) is None
    assert env.compile_whole(env.init)(env_keys(0, B)).memory is None


def test_a_policy_that_remembers_is_not_asked_without_its_memory() -> None:
    config = configure("tutorial", **SHORT)
    env = Env(config, B)
    policy = untrained(config, env)
    seen = np.zeros((B, env.schema.vector_size), np.float32)
    with pytest.raises(InputError, match="give its memory to `decide`"):
        policy.act(seen)
    with pytest.raises(InputError, match="has to be given its memory"):
        features(policy.parameters, Inputs(None, jnp.asarray(seen)))
    action, memory = policy.decide(seen, policy.initial(B))
    again, _ = policy.decide(seen, memory)
    assert np.abs(np.asarray(action) - np.asarray(again)).max() > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("size", "least", "most"), [(16, 0.99, 1.0), (0, 0.4, 0.6)])
def test_a_cue_is_remembered_for_50_steps(tmp_path: Path, size: int, least: float, most: float, entered: None) -> None:
    del entered
    config = configure("cue", memory=size, total_steps=700_000, report_episodes=400)
    assert least <= train(config, tmp_path / "run").report.success_rate <= most


# --- targets that are not seen ----------------------------------------------------------------------


def test_a_target_is_seen_for_its_steps_and_lost_in_its_share() -> None:
    hidden = {"goal_steps": 20, "goal_lost": 0.25, "action": "joint_delta", "observation": "glimpse"}
    env = Env(configure("precise", robot="so101", num_envs=64, **hidden), 64)
    state = env.init(env_keys(0, 64))
    shown, zero = [], np.zeros(state.last_action.shape, np.float32)
    for _ in range(40):
        now = env.situation(state)
        there = (np.asarray(now.goal.position) == np.asarray(state.goal.position)).all(axis=1)
        hidden = (np.asarray(now.goal.position) == np.asarray(now.tool_position)).all(axis=1)
        assert (there ^ hidden).all()
        assert there.tolist() == env.goal_seen(state.key, state.clock).tolist()
        assert there.tolist() == np.asarray(env.observe(state))[:, -1].tolist()
        shown.append(there)
        state, _ = env.step(state, zero)
    low, high = env.schema.bounds
    seen = np.asarray(env.observe(state))
    assert ((seen >= low) & (seen <= high)).all()
    assert np.mean(shown[:20]) == pytest.approx(0.75, abs=0.05)
    assert not np.any(shown[20:])
    env.close()


def test_where_a_hidden_target_is_belongs_to_what_is_learnt() -> None:
    config = configure("tutorial", **SHORT, goal_lost=0.5)
    env = Env(config, B)
    state = env.compile_part(lambda seed: initial_state(env, config, seed))(np.uint32(0))
    policy = untrained(config, env)
    _, rollout = env.compile_whole(lambda one, key: collect(env, policy, one, key, config.loop))(
        state.env, jax.random.key(1)
    )
    assert rollout.target is not None
    place, way = map(np.asarray, rollout.target)
    goal, tool = np.asarray(state.env.goal.position), np.asarray(state.env.arm.tool_position)
    low, high = np.array(env.setup.robot.workspace)
    np.testing.assert_allclose(low + (place[0] + 1) / 2 * (high - low), goal, atol=1e-5)
    np.testing.assert_allclose(tool + way[0], goal, atol=1e-5, err_msg="of the tool before it moved")

    def learnt(batch: ppo.Batch) -> dict[str, Any]:
        gradient, watched = jax.grad(ppo.loss, has_aux=True)(policy.parameters, batch, config.ppo)
        return watched | {"gates": gradient.memory, "actor": gradient.actor}

    batch = ppo._samples(policy, rollout, config.ppo)
    taught, untaught = (jit(learnt)(one) for one in (batch, batch._replace(target=None)))
    memory = remembered(policy.parameters, features(policy.parameters, batch.inputs))
    assert memory is not None
    off = np.asarray(memory)[..., :6] - np.concatenate([ppo.SMALL * place, np.tanh(way / ppo.CLOSE)], axis=-1)
    for name, part in (("place_error", off[..., :3]), ("way_error", off[..., 3:])):
        assert float(taught[name]) == pytest.approx(np.square(part).sum(axis=-1).mean(), rel=1e-4)
        assert name not in untaught
    jax.tree.map(partial(np.testing.assert_allclose, atol=1e-6), taught["actor"], untaught["actor"])
    change = jax.tree.map(lambda a, b: float(jnp.abs(a - b).max()), taught["gates"], untaught["gates"])
    assert max(jax.tree.leaves(change)) > 0.1, "and the gates are moved by it"
    env.close()


def test_a_picture_that_does_not_come_is_black() -> None:
    env = Env(configure("tutorial", observation="image", goal_lost=0.5), 8)
    state = env.init(env_keys(0, 8))
    seen = env.goal_seen(state.key, state.clock)
    pictures = env.observe_now(state)
    assert 0 < seen.sum() < 8
    assert np.asarray(pictures).any(axis=(1, 2)).tolist() == seen.tolist()
    env.close()


def test_where_targets_are_always_seen_or_must_be_that_is_said() -> None:
    with pytest.raises(InputError, match="are of targets that are points alone"):
        check(configure("pose", goal_lost=0.5))
    with pytest.raises(InputError, match="stays where it is while the target is not seen: choose joint_delta"):
        check(configure("precise", goal_lost=0.5))
    assert "always sees the target" in why_streamed(configure("precise", goal_steps=5, action="joint_delta"), "trained")
    assert not why_streamed(configure("precise", memory=SIZE), "trained")


# --- out of the environment -------------------------------------------------------------------------


def test_the_controller_remembers_as_the_environment_does(tmp_path: Path) -> None:
    """Over episodes of 1,000 steps, with targets that are lost at times, and again after a reset."""
    hidden = {"goal_lost": 0.3, "goal_steps": 800, "observation": "glimpse", "action": "joint_delta"}
    still = {"shaping": True, "randomise": (), "max_steps": 1000, "num_envs": 1}
    config = configure("precise", robot="ur5e", memory=16, hidden=(16,), **hidden, **still)
    env = Env(config, 1)
    policy, act, key = untrained(config, env), make_act(env, "trained"), jax.random.key(0)
    write_files(tmp_path, env, policy, {"run": {}, "held_out": [], "versions": {}})
    controller, worst, lost = load_controller(tmp_path).Controller(tmp_path), 0.0, 0
    assert controller.limits.n == 6
    begun = (env.init(episode_keys(1, REPORT_STREAM, number, 1)) for number in range(9))
    for begin in [one for one in begun if env.goal_seen(one.key, one.clock)[0]][:2]:
        state = begin
        controller.reset(np.asarray(state.arm.q, float)[0])
        for step in range(1000):
            q, qd, goal = (np.asarray(part, float)[0] for part in (state.arm.q, state.arm.qd, state.goal.position))
            seen = env.goal_seen(state.key, state.clock)[0]
            command = controller.step(q, qd, goal if seen else None, step * controller.period)
            lost += not seen
            state, _, key = act(policy, state, key)
            assert controller.problem == ""
            worst = max(worst, np.abs(command - np.asarray(state.command)[0]).max())
    assert lost > 600
    assert worst < 2e-5  # training computes in single precision, and errors of 1,000 steps add up
    env.close()


def test_a_graph_remembers_and_is_told_where_episodes_begin(tmp_path: Path) -> None:
    config = configure("tutorial", **SHORT)
    env = Env(config, B)
    policy = untrained(config, env)
    write_files(tmp_path, env, policy, {"run": {}, "held_out": [], "versions": {}})
    graph = OnnxNetwork(tmp_path)
    graph.check(env)
    by_graph, own = env.compile_whole(make_act(env, "trained")), make_act(env, graph.act)
    ours, reset = env.compile_whole(env.init)(env_keys(0, B)), env.compile_whole(env.reset)
    theirs = ours
    key = jax.random.key(0)
    for _ in range(T):
        ours, transition, _ = by_graph(policy, ours, key)
        theirs, _, _ = own(None, theirs, key)
        assert np.asarray(theirs.command) == pytest.approx(np.asarray(ours.command), abs=1e-4)
        done = np.asarray(transition.done)
        ours, theirs = (reset(state, done) for state in (ours, theirs))


@pytest.mark.slow
def test_a_recurrent_model_of_stable_baselines3_is_told_where_episodes_begin(tmp_path: Path) -> None:
    from sb3_contrib import RecurrentPPO

    from reachlab.agents.sb3_policy import load_model
    from reachlab.sb3 import make_vec_env

    vector = make_vec_env("reachlab/Reach-v0", n_envs=B, seed=0, max_steps=15, observation="target+tool")
    model = RecurrentPPO("MlpLstmPolicy", vector, n_steps=16, batch_size=64, seed=0, device="cpu")
    model.learn(256)
    model.save(tmp_path / "model")
    loaded = load_model(tmp_path / "model.zip")
    seen, kept = np.asarray(vector.reset()), None
    begins = np.ones(B, bool)
    for _ in range(T):
        expected, kept = model.predict(np.asarray(seen), kept, begins, deterministic=True)
        assert loaded.act(seen, begins) == pytest.approx(expected, abs=1e-6)
        seen, _, begins, _ = vector.step(expected)


def test_a_memory_that_would_be_another_in_training_is_refused() -> None:
    with pytest.raises(InputError, match="one step in 8 in training, and every step when it acts"):
        check(configure("tutorial", reward="sparse", memory=SIZE))
    check(configure("tutorial", reward="sparse", memory=SIZE, action_repeat=1))


def test_a_student_of_a_task_whose_goal_is_always_seen_is_not_asked_about_it() -> None:
    config = train_command._distillation(Distil(teacher=Path("panda/push")))
    assert not config.rules.hides_goal
    hidden = train_command._distillation(Distil(teacher=Path("panda/precise"), goal_lost=0.5))
    assert hidden.rules.hides_goal
