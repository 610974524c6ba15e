"""Objects in PyBullet: its arm follows as MuJoCo's does, its objects slide, and the scripts work there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reachlab.agents.acting import make_act
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import REPORT_STREAM, episode_keys
from reachlab.tasks.push import Push

pytest.importorskip("pybullet")

ENVS, GRAVITY = 8, 9.81


def begun(task: str = "push", sim: str = "pybullet", **settings: object) -> tuple[Env, EnvState]:
    env = Env(configure(task, robot="panda", sim=sim, **{"randomise": (), **settings}), ENVS)
    return env, env.init(episode_keys(0, REPORT_STREAM, 0, ENVS))


@pytest.fixture(scope="module")
def pushing() -> Iterator[tuple[Env, EnvState]]:
    env, start = begun()
    yield env, start
    env.close()


def held(env: Env, state: EnvState, steps: int) -> EnvState:
    """The state after steps in which the arm is held where it is."""
    idle = np.zeros((ENVS, len(env.action_bounds[0])), np.float32)
    for _ in range(steps):
        state, _ = env.step(state, idle, instead=state.command)
    return state


def moved(env: Env, state: EnvState, up: float, speed: float | np.ndarray) -> EnvState:
    """The state with objects that are lifted by hand [m], and slide along y [m/s]."""
    bodies = state.arm.bodies
    position, velocity = np.array(bodies.position), np.array(bodies.velocity)
    position[:, -1, 2] += up
    velocity[:, -1, 1] = speed
    return env.rearrange(state, replace(bodies, position=jnp.asarray(position), velocity=jnp.asarray(velocity)))


def place(state: EnvState) -> np.ndarray:
    return np.asarray(state.arm.bodies.position)[:, -1]


def test_environments_that_go_on_keep_their_tools(pushing: tuple[Env, EnvState]) -> None:
    env, start = pushing
    state = held(env, start, 3)
    rows = np.arange(ENVS) < 2
    begun = env.reset(state, rows)
    for name in ("position", "quaternion"):
        before, after = (np.asarray(getattr(one.arm.tool, name))[2:] for one in (state, begun))
        np.testing.assert_array_equal(after, before)


@pytest.mark.parametrize("task", ["push", "lift", "place"])
def test_the_script_moves_objects_to_their_goals(task: str) -> None:
    env, state = begun(task)
    act, transition, key = make_act(env, "ik"), None, jax.random.key(0)
    for _ in range(env.config.rules.max_steps):
        state, transition, key = act(None, state, key)
    env.close()
    assert transition is not None
    assert np.asarray(transition.terms["success"]).mean() > 0.8


@pytest.mark.parametrize("task", ["push", "lift"])
def test_arm_and_fingers_follow_their_commands_as_in_mujoco(task: str) -> None:
    ways = []
    for sim in ("mujoco", "pybullet"):
        env, state = begun(task, sim)
        ways.append([])
        for number in range(40):
            command = np.asarray(state.command) + (0.02 if number < 20 else -0.01)
            command[:, 7:] = max(0.03, 0.08 - 0.002 * number)
            state, _ = env.step(
                state, np.zeros((ENVS, len(env.action_bounds[0])), np.float32), instead=jnp.asarray(command)
            )
            ways[-1].append(np.asarray(state.arm.actuated))
        lag = env.setup.lag
        env.close()
        assert max(lag) > 0.05
    here, there = map(np.array, ways)
    assert np.abs(here[-1] - here[0]).max() > 0.1
    assert np.abs(here - there)[..., :7].max() < 0.01
    assert np.abs(here - there)[..., 7:].max(initial=0.0) < 0.001


def test_objects_rest_on_the_table_until_friction_has_to_stop_them(pushing: tuple[Env, EnvState]) -> None:
    env, start = pushing
    assert np.abs(place(held(env, start, 25)) - place(start)).max() < 5e-4
    slid = place(held(env, moved(env, start, 0.0, 0.3), 25)) - place(start)
    assert slid[:, 1] == pytest.approx(0.3**2 / (2 * Push.object_friction * GRAVITY), rel=0.1)


def test_a_state_is_continued_from_and_an_object_moved_by_hand_falls_from_there(
    pushing: tuple[Env, EnvState],
) -> None:
    env, start = pushing
    middle = held(env, moved(env, start, 0.0, 0.3), 1)
    ends = [place(held(env, state, 5)) for state in (middle, jax.tree.map(jnp.array, middle))]
    assert np.abs(ends[0] - place(middle)).max() > 0.002
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-3)
    fallen = held(env, moved(env, middle, 0.1, 0.0), 30)
    assert np.abs(place(fallen)[:, 2] - place(start)[:, 2]).max() < 1e-3


def test_an_object_that_slides_is_stopped_by_a_wall() -> None:
    env, start = begun("place")
    wall, size = (np.asarray(part)[:, 0] for part in (start.arm.bodies.position, start.arm.bodies.size))
    to_wall = np.sign(wall - place(start))[:, 1]
    slid = held(env, moved(env, start, 0.0, 2.5 * to_wall), 50)
    env.close()
    gap = np.abs(place(slid) - wall)[:, 1] - size[:, 1]
    assert (np.sign(wall - place(slid))[:, 1] == to_wall).all()
    assert (gap > 0.018).all()
    assert gap.min() < 0.03


def test_objects_that_vary_have_a_size_and_a_friction_each() -> None:
    env, start = begun(randomise=("objects",))
    slid = place(held(env, moved(env, start, 0.0, 0.3), 25)) - place(start)
    env.close()
    assert np.ptp(np.asarray(start.arm.bodies.size)) > 0.003
    assert slid[:, 1].max() > 1.5 * slid[:, 1].min()
    assert np.abs(slid[:, 2]).max() < 5e-4


@pytest.mark.parametrize("shape", ["cylinder", "ball"])
def test_other_shapes_rest_on_the_table(shape: str) -> None:
    env, start = begun("lift", object_shape=shape)
    after = held(env, start, 25)
    env.close()
    assert np.abs(place(after) - place(start)).max() < 1e-3
