"""Bodies that move: where their paths go, that the engine has them where they are, and that the arm gives way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reachlab.agents.planner import Following
from reachlab.control.bodies import Shape
from reachlab.control.evading import after, evaded
from reachlab.deploy.onboard.bodies import FASTEST, OLD, Followed, placed
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.envs.setup import configure_env
from reachlab.robots.shapes.clearance import capsules_at
from reachlab.settings.validation import InputError
from reachlab.sims.mujoco import MujocoSimulator
from reachlab.tasks.clutter import AROUND_FURNITURE
from reachlab.tasks.scenes.balls import clearances
from reachlab.tasks.scenes.moving import AHEAD, CLEAR, MOST

COUNT, SPEED = 32, 0.4


@pytest.fixture(scope="module")
def env() -> Iterator[Env]:
    env = Env(configure("clutter", robot="ur5e", scene=("moving",), body_speed=SPEED, randomise=()), COUNT)
    yield env
    env.close()


@pytest.fixture(scope="module")
def begun(env: Env) -> EnvState:
    return env.init(env_keys(0, COUNT))


def far(env: Env, joints: jax.Array, state: EnvState, time: float) -> np.ndarray:
    """Distances `[B, K]` m of arms at joints `[B, n]` from where bodies are after a time [s]."""
    robot, bodies = env.setup.robot, after(state.arm.bodies, time)
    at = jax.jit(lambda q: capsules_at(robot.chain, robot.capsules, q))(joints)
    rows = [jax.tree.map(lambda x, i=i: x[i], bodies) for i in range(COUNT)]
    each = [jax.tree.map(lambda x, i=i: x[:, i : i + 1], at) for i in range(COUNT)]
    found = jax.jit(lambda one, row: clearances(robot.capsules, one, row))
    return np.array([found(one, row)[0] for one, row in zip(each, rows, strict=True)])


def test_bodies_are_balls_and_capsules_with_the_speed_of_the_settings(begun: EnvState) -> None:
    bodies = jax.tree.map(np.asarray, begun.arm.bodies)
    there = np.asarray(begun.arm.bodies.present)
    assert bodies.kind.shape == (COUNT, MOST)
    assert set(there.sum(axis=1)) >= {1, 2}
    assert set(bodies.kind[there]) == {Shape.BALL, Shape.CAPSULE}
    np.testing.assert_allclose(np.linalg.norm(bodies.velocity[there][:, :3], axis=-1), SPEED, rtol=1e-5)
    assert not bodies.velocity[there][:, 3:].any()
    assert not bodies.velocity[~there].any()


def test_they_meet_an_arm_that_stays_at_the_goal_or_goes_there_and_leave_it_time(env: Env, begun: EnvState) -> None:
    there, clear = np.asarray(begun.arm.bodies.present), CLEAR * env.setup.robot.scale - 2e-3
    assert far(env, begun.arm.q, begun, 0.0)[there].min() > clear + AHEAD * SPEED
    last = far(env, begun.goal.joints, begun, env.config.rules.max_steps * env.setup.period)
    assert last[there].min() > clear
    met = np.min([far(env, begun.goal.joints, begun, time) for time in np.arange(0.8, 4.0, 0.1)], axis=0)
    assert (met[there] < 0).mean() > 0.8
    assert env.config.rules.max_steps == AROUND_FURNITURE


def test_the_engine_has_them_where_they_are(env: Env, begun: EnvState) -> None:
    state, still = begun, np.zeros((COUNT, len(env.action_bounds[0])), np.float32)
    command = begun.arm.q
    for _ in range(5):
        state, _ = env.step(state, still, instead=command)
    now, wanted = (jax.tree.map(np.asarray, one) for one in (state.arm.bodies, after(begun.arm.bodies, 0.1)))
    np.testing.assert_allclose(now.position, wanted.position, atol=1e-5)
    np.testing.assert_array_equal(now.velocity, begun.arm.bodies.velocity)
    env.step(state, still, instead=command)
    assert isinstance(env.simulator, MujocoSimulator)
    geoms = env.simulator.layout.fixed
    for row in (0, COUNT - 1):
        np.testing.assert_array_equal(env.simulator.model(row).geom_pos[geoms], now.position[row])


def held(env: Env, state: EnvState, *, known: bool) -> tuple[float, float]:
    """Shares of episodes that end in success and by contact, where dampers know velocities or do not."""
    functions = env.functions

    @jax.jit
    def command(state: EnvState) -> jax.Array:
        bodies = state.arm.bodies
        seen = bodies if known else replace(bodies, velocity=jnp.zeros_like(bodies.velocity))
        state = replace(state, arm=replace(state.arm, bodies=seen, engine=None))
        return functions.command(state, still, None)[1]

    still = jnp.zeros((COUNT, len(env.action_bounds[0])))
    success, contact = np.zeros(COUNT, bool), np.zeros(COUNT, bool)
    for _ in range(env.config.rules.max_steps):
        state, now = env.step(state, still, instead=command(state))
        contact |= np.asarray(state.arm.contact)
        success = np.asarray(now.terms["success"]) & ~contact
    return success.mean(), contact.mean()


def test_an_arm_that_knows_how_they_move_gives_way(env: Env, begun: EnvState) -> None:
    success, contact = held(env, begun, known=True)
    assert success > 0.8
    assert contact < 0.15
    _, contact = held(env, begun, known=False)
    assert contact > 0.8


def test_a_body_that_comes_along_moves_the_arm_out_of_its_way_or_on(env: Env, begun: EnvState) -> None:
    robot, setup = env.setup.robot, env.setup
    now = env.situation(begun)
    tool, bodies = np.asarray(now.tool_position), now.bodies
    position = np.repeat(tool[:, None] + [[0.25, 0.0, 0.0]], MOST, axis=1).astype(np.float32)
    velocity = np.zeros((COUNT, MOST, 6), np.float32)
    step = np.zeros((COUNT, robot.chain.n), np.float32)
    law = jax.jit(lambda bodies: evaded(setup, now._replace(bodies=bodies), jnp.asarray(step)))
    size, kind = (
        np.tile(np.array([0.05, 0, 0], np.float32), (COUNT, MOST, 1)),
        np.full((COUNT, MOST), int(Shape.BALL), np.int32),
    )
    still = replace(bodies, position=jnp.asarray(position), velocity=jnp.asarray(velocity), size=size, kind=kind)
    assert np.abs(law(still)).max(axis=1).mean() < 0.01
    comes = replace(still, velocity=jnp.asarray(velocity - np.array([SPEED, 0, 0, 0, 0, 0], np.float32)))
    assert (np.abs(law(comes)).max(axis=1) > 0.005).mean() > 0.9


def test_what_cannot_be_is_refused_in_a_sentence(env: Env) -> None:
    with pytest.raises(InputError, match="a planner plans among bodies that stay"):
        Following(env)
    with pytest.raises(InputError, match="name balls or moving alone"):
        configure_env("clutter", scene=("moving", "wall"))
    with pytest.raises(InputError, match="body_speed is that of scene moving"):
        configure_env("clutter", body_speed=0.2)
    with pytest.raises(InputError, match=r"body_speed must be at least 0.1 and at most 0.5, got 0.6"):
        configure("clutter", scene=("moving",), body_speed=0.6)
    with pytest.raises(InputError, match="task 'clutter' needs contacts, as in simulator mujoco"):
        Env(configure("clutter", scene=("moving",), sim="pybullet"), 1)


# --- velocities on board --------------------------------------------------------------------------


def seen(followed: Followed, places: list[float], times: list[float], **more: float) -> list[float]:
    """Velocity along x of an obstacle that is seen at places along x [m] at times [s]."""
    found = []
    for place, time in zip(places, times, strict=True):
        one = {"radius": 0.1, **more}
        obstacles = [{"position": np.array([place, 0.0, 0.0]), **{name: np.array(x) for name, x in one.items()}}]
        around = placed(obstacles, 2)
        followed.fill(around, obstacles, time)
        found.append(around["velocity"][0])
        assert not any(around["velocity"][1:])
    return found


def test_velocities_follow_from_the_last_places() -> None:
    assert seen(Followed(), [0.0, 0.006, 0.012], [0.0, 0.02, 0.04]) == pytest.approx([0.0, 0.3, 0.3])
    slow = seen(Followed(), [0.0, 0.0, 0.012, 0.012, 0.024], [0.0, 0.02, 0.04, 0.06, 0.08])
    assert slow == pytest.approx([0.0, 0.0, 0.3, 0.3, 0.3]), "a camera may be slower than the controller"
    gone = seen(Followed(), [0.0, 0.006, 0.006], [0.0, 0.02, 0.04 + OLD])
    assert gone == pytest.approx([0.0, 0.3, 0.0]), "it has stopped"
    assert seen(Followed(), [0.0, 2 * FASTEST], [0.0, 0.02]) == [0.0, 0.0], "it is another"
    followed = Followed()
    seen(followed, [0.0], [0.0])
    followed.clear()
    assert seen(followed, [0.006], [0.02]) == [0.0]


def test_velocities_that_are_given_stay() -> None:
    obstacle = {"position": np.zeros(3), "radius": np.array(0.1), "velocity": np.array([0.1, 0.2, 0.3])}
    around = placed([obstacle], 1)
    Followed().fill(around, [obstacle], 0.0)
    assert around["velocity"][:3] == [0.1, 0.2, 0.3]
