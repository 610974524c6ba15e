"""Episodes of the environment, with the tutorial's arm."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from params import tried
from reachlab.agents.acting import make_act
from reachlab.envs.ahead import steps_ahead
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, Transition
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys

NUM_ENVS = 4
TOOL = slice(3, 6)
"""Where `target+tool` holds the tool."""

HELD = np.array([0.0, 0.5**0.5, -(0.5**0.5), 0.0])
"""Euler (0, -π, π/2) as a quaternion wxyz."""


class Compiled:
    """An environment with its functions compiled, whatever the batch."""

    def __init__(self, **settings: Any) -> None:
        self.env = Env(configure("tutorial", **settings), NUM_ENVS)
        self.init: Callable[..., EnvState] = self.env.compile_whole(self.env.init)
        self.step: Callable[..., tuple[EnvState, Transition]] = self.env.compile_whole(self.env.step)
        self.reset: Callable[..., EnvState] = self.env.compile_whole(self.env.reset)
        self.observe: Callable[..., jax.Array] = self.env.compile_whole(self.env.observe)

    def start(self, seed: int = 0, num_envs: int = NUM_ENVS) -> EnvState:
        return self.init(env_keys(seed, num_envs))

    def walk(self, state: EnvState, action: tuple[float, ...], steps: int) -> tuple[EnvState, Transition]:
        actions = np.tile(np.array(action, np.float32), (len(state.clock), 1))
        for _ in range(steps - 1):
            state, _ = self.step(state, actions)
        return self.step(state, actions)

    def rise(self, state: EnvState) -> tuple[EnvState, Transition]:
        """Upwards out of the workspace."""
        while True:
            state, transition = self.walk(state, (0, 0, 0.3), 1)
            if transition.done.all():
                return state, transition


@pytest.fixture(scope="module")
def tutorial() -> Compiled:
    return Compiled()


@pytest.fixture(scope="module")
def unclipped() -> Compiled:
    return Compiled(clip_actions=False)


@pytest.fixture(scope="module")
def settled(tutorial: Compiled) -> EnvState:
    return tutorial.walk(tutorial.start(), (0, 0, 0), 60)[0]


def leaves(state: EnvState) -> list[np.ndarray]:
    return [
        np.array(jax.random.key_data(leaf) if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) else leaf)
        for leaf in jax.tree.leaves(state)
    ]


# --- how the tool moves ---------------------------------------------------------------------------


def test_the_tool_turns_to_the_held_orientation_within_a_few_dozen_steps(tutorial: Compiled) -> None:
    state = tutorial.start()
    assert np.abs(np.asarray(state.arm.tool_quaternion) @ HELD).max() < 0.8, "the start is a quarter turn away"
    state, _ = tutorial.walk(state, (0, 0, 0), 36)
    angle = 2 * np.arccos(np.minimum(np.abs(np.asarray(state.arm.tool_quaternion, np.float64) @ HELD), 1))
    assert angle.max() < 2e-3


def test_a_zero_action_leaves_the_tool_where_it_is(tutorial: Compiled, settled: EnvState) -> None:
    later, _ = tutorial.walk(settled, (0, 0, 0), 100)
    assert np.asarray(later.arm.tool_position) == pytest.approx(np.asarray(settled.arm.tool_position), abs=1e-5)
    assert np.asarray(later.arm.q) == pytest.approx(np.asarray(settled.arm.q), abs=1e-3)


@pytest.mark.parametrize("action", [(0.2, 0, 0), (0, -0.4, 0), (0, 0, -0.6), (-0.3, 0.2, -0.1)])
def test_an_action_moves_the_tool_by_five_millimetres_for_each_unit(
    tutorial: Compiled, settled: EnvState, action: tuple[float, ...]
) -> None:
    later, _ = tutorial.walk(settled, action, 50)
    moved = np.asarray(later.arm.tool_position - settled.arm.tool_position)
    wanted = 50 * 0.005 * np.array(action)
    assert np.linalg.norm(moved - wanted, axis=-1).max() < 0.01 * np.linalg.norm(wanted)
    last, _ = tutorial.walk(later, action, 1)
    assert np.asarray(last.arm.qd) == pytest.approx(np.asarray(last.arm.q - later.arm.q) * 240, abs=1e-3)
    assert np.abs(np.asarray(last.arm.qd)).max() > 0.1


def test_actions_beyond_the_box_move_the_tool_further_only_where_they_are_not_clipped(
    tutorial: Compiled, unclipped: Compiled
) -> None:
    for env, fastest in ((tutorial, 0.6), (unclipped, 1.5)):
        begun, _ = env.walk(env.start(), (0, 0, 0), 60)
        later, _ = env.walk(begun, (0, 0, -1.5), 20)
        descended = float((begun.arm.tool_position - later.arm.tool_position)[0, 2])
        assert descended == pytest.approx(20 * 0.005 * fastest, rel=0.01)


@pytest.mark.parametrize("action", ["tool_delta", "joint_delta"])
def test_joint_limits_hold_under_extreme_actions(unclipped: Compiled, action: str) -> None:
    env = unclipped if action == "tool_delta" else Compiled(action=action, clip_actions=False)
    chain, random = env.env.setup.robot.chain, np.random.default_rng(0)
    low, high = np.array(chain.lower, np.float32), np.array(chain.upper, np.float32)
    state = env.start()
    touched = np.zeros(chain.n, bool)
    for _ in range(40):
        push = random.uniform(-1, 1, state.last_action.shape) * 10.0 ** random.uniform(0, 4)
        for _ in range(5):
            state, _ = env.step(state, push.astype(np.float32))
        q = np.asarray(state.arm.q)
        assert np.isfinite(q).all()
        assert (q >= low).all()
        assert (q <= high).all()
        touched |= ((q == low) | (q == high)).any(0)
    assert touched.any(), "no action was extreme enough to reach a limit"


# --- ends -----------------------------------------------------------------------------------------


def test_an_idle_arm_is_truncated_exactly_on_step_1000(tutorial: Compiled) -> None:
    state = tutorial.start()
    for _ in range(999):
        state, transition = tutorial.walk(state, (0, 0, 0), 1)
        assert not transition.done.any()
    state, transition = tutorial.walk(state, (0, 0, 0), 1)
    assert transition.truncated.all()
    assert not transition.terminated.any()
    assert np.asarray(transition.reward) == pytest.approx(-0.1, abs=1e-4)


def test_a_straight_descent_ends_as_success_and_pays_one(tutorial: Compiled) -> None:
    state, sparse, steps = tutorial.start(num_envs=1), 0.0, 0
    returned, first = 0.0, float(state.distance[0])
    while True:
        offset = np.asarray(state.goal.position - state.arm.tool_position)
        state, transition = tutorial.step(state, np.clip(offset / 0.005, -0.4, 0.4).astype(np.float32))
        parts = [value for name, value in transition.terms.items() if name not in ("distance", "error", "success")]
        assert np.asarray(transition.reward) == pytest.approx(np.sum(parts, axis=0), abs=1e-6), "terms add up"
        sparse += sum(float(transition.terms[name][0]) for name in ("reach", "outside", "timeout"))
        returned, steps = returned + float(transition.reward[0]), steps + 1
        if transition.done[0]:
            break
    assert transition.terminated[0]
    assert not transition.truncated[0]
    assert transition.terms["success"][0]
    assert sparse == 1.0
    assert float(transition.errors.distance[0]) < 0.1
    assert steps < 300
    # The approach terms telescope: five for every metre of the way.
    assert returned == pytest.approx(1 + 5 * (first - float(state.distance[0])), abs=1e-3)


def test_leaving_the_workspace_ends_the_episode_without_success(tutorial: Compiled) -> None:
    state, transition = tutorial.rise(tutorial.start(num_envs=1))
    assert transition.terminated[0]
    assert not transition.terms["success"][0]
    assert float(transition.terms["outside"][0]) == pytest.approx(-0.1)
    assert float(state.arm.tool_position[0, 2]) > 0.55


# --- resets ---------------------------------------------------------------------------------------


def test_a_reset_changes_the_masked_environments_and_no_other(tutorial: Compiled, settled: EnvState) -> None:
    mask = np.array([True, False, False, True])
    before, after = leaves(settled), leaves(tutorial.reset(settled, mask))
    for old, new in zip(before, after, strict=True):
        assert np.array_equal(old[~mask], new[~mask])
    fresh = tutorial.reset(settled, mask)
    assert np.asarray(fresh.clock).tolist() == [0, 60, 60, 0]
    assert np.asarray(fresh.arm.q)[mask] == pytest.approx(np.tile(tutorial.env.setup.robot.home, (2, 1)), abs=1e-6)
    assert np.asarray(fresh.command)[mask] == pytest.approx(np.asarray(fresh.arm.q)[mask])
    assert not np.asarray(fresh.arm.qd)[mask].any()
    assert not np.asarray(fresh.last_action)[mask].any()


def test_every_reset_samples_a_new_goal(tutorial: Compiled) -> None:
    state = tutorial.start()
    sampled = [np.asarray(state.goal.position)]
    for _ in range(100):
        state = tutorial.reset(state, np.ones(NUM_ENVS, bool))
        sampled.append(np.asarray(state.goal.position))
    assert len(np.unique(np.concatenate(sampled), axis=0)) == 101 * NUM_ENVS


def test_the_final_observation_is_the_one_before_the_reset(tutorial: Compiled, settled: EnvState) -> None:
    state, transition = tutorial.rise(settled)
    final = np.asarray(transition.observation)
    assert np.array_equal(final, np.asarray(tutorial.observe(state)))
    assert (final[:, 5] > 0.55).all()
    fresh = np.asarray(tutorial.observe(tutorial.reset(state, transition.done)))
    assert fresh[:, TOOL] == pytest.approx(np.tile((0.5321, -0.0011, 0.4963), (NUM_ENVS, 1)), abs=1e-4)
    assert (fresh[:, :2] != final[:, :2]).all()


# --- randomness -----------------------------------------------------------------------------------


def with_staggered_episodes(sim: str, observation: str) -> tuple[Compiled, EnvState]:
    """Three environments two steps into episodes of five, and one that begins."""
    there = Compiled(sim=sim, observation=observation, max_steps=5)
    state, _ = there.walk(there.start(), (0.1, -0.2, -0.3), 2)
    return there, there.reset(state, np.arange(NUM_ENVS) == 0)


WATCHED = [("kinematic", "target+tool"), ("mujoco", "target+tool"), ("pybullet", "target+tool"), ("kinematic", "image")]


@pytest.mark.parametrize("watched", tried(WATCHED, WATCHED[:2]), ids=" ".join)
def test_an_action_taken_several_times_ends_where_the_episode_does(watched: tuple[str, str]) -> None:
    sim, observation = watched
    once, state = with_staggered_episodes(sim, observation)
    several, begun = with_staggered_episodes(sim, observation) if sim == "pybullet" else (once, state)
    walked = []
    for _ in range(4):
        walked.append(once.walk(state, (0.1, -0.2, -0.3), 1))
        state = walked[-1][0]
    states, transitions = zip(*walked, strict=True)
    actions = np.tile(np.array((0.1, -0.2, -0.3), np.float32), (NUM_ENVS, 1))
    step = several.env.compile_whole(lambda state, action: several.env.step(state, action, 4))
    end, transition = step(begun, actions)

    lasted = np.array([4, 3, 3, 3])  # an episode ends on its fifth step
    assert np.asarray(transition.done).tolist() == [False, True, True, True]
    assert np.asarray(end.clock).tolist() == [4, 5, 5, 5]
    for index, steps in enumerate(lasted):
        assert np.asarray(end.arm.q)[index] == pytest.approx(np.asarray(states[steps - 1].arm.q)[index], abs=1e-6)
        reward = sum(float(given.reward[index]) for given in transitions[:steps])
        assert float(transition.reward[index]) == pytest.approx(reward, abs=1e-5)
        if transition.observation is not None:
            seen = np.asarray(transitions[steps - 1].observation)[index]
            assert np.asarray(transition.observation)[index] == pytest.approx(seen, abs=1e-5)
    for there in (once, several):
        there.env.close()


def test_an_environment_of_a_batch_is_the_single_one_with_its_own_seed(tutorial: Compiled) -> None:
    seed, index, random = 11, 2, np.random.default_rng(5)
    batch, single = tutorial.start(seed), tutorial.start(seed + index, num_envs=1)
    low, high = tutorial.env.action_bounds
    pushes = random.uniform(low, high, (13, NUM_ENVS, 3)).astype(np.float32)
    ends = 0
    for actions in np.repeat(pushes, 80, axis=0)[:1000]:
        batch, here = tutorial.step(batch, actions)
        single, there = tutorial.step(single, actions[index : index + 1])
        assert np.asarray(here.observation[index]) == pytest.approx(np.asarray(there.observation[0]), abs=1e-4)
        assert float(here.reward[index]) == pytest.approx(float(there.reward[0]), abs=1e-3)
        assert bool(here.terminated[index]) == bool(there.terminated[0])
        assert bool(here.truncated[index]) == bool(there.truncated[0])
        ends += int(here.done[index])
        batch, single = tutorial.reset(batch, here.done), tutorial.reset(single, there.done)
    assert ends >= 3
    first, far = (set(map(tuple, np.asarray(tutorial.start(at).goal.position).tolist())) for at in (seed, 100))
    assert not first & far, "distant seeds share no episode"


# --- at the target --------------------------------------------------------------------------------


@functools.cache
def reach_and_stay(at_goal: str, sim: str, **settings: Any) -> tuple[list[EnvState], Transition, np.ndarray]:
    """States and last transition of an episode of inverse kinematics, and the sum of its rewards for success."""
    # The tutorial's own targets lie below the workspace's floor: an arm that continues to their middle leaves it.
    box = {"targets": "box", "target_low": (0.4, -0.2, 0.2), "target_high": (0.6, 0.2, 0.3)}
    env = Env(configure(sim=sim, at_goal=at_goal, max_steps=300, **box, **settings), NUM_ENVS)
    act = env.compile_whole(make_act(env, "ik"))
    state, key = env.compile_whole(env.init)(env_keys(0, NUM_ENVS)), jax.random.key(0)
    states, paid = [state], np.zeros(NUM_ENVS)
    while True:
        state, transition, key = act(None, state, key)
        states.append(state)
        paid += np.asarray(transition.terms["reach"])
        if np.asarray(transition.done).any():
            env.close()
            return states, transition, paid


BOTH = tried(["kinematic", "mujoco"], ["kinematic"])


@pytest.mark.parametrize("sim", BOTH)
@pytest.mark.parametrize("at_goal", ["continue", "hold"])
def test_an_episode_that_continues_at_the_target_ends_with_the_clock_in_success(at_goal: str, sim: str) -> None:
    states, last, paid = reach_and_stay(at_goal, sim)
    assert len(states) == 301
    assert np.asarray(last.truncated).all()
    assert not np.asarray(last.terminated).any()
    assert np.asarray(last.terms["success"]).all()
    np.testing.assert_array_equal(paid, 1.0)


@pytest.mark.parametrize("sim", BOTH)
def test_held_at_the_target_the_joints_get_no_new_command(sim: str) -> None:
    states, _, _ = reach_and_stay("hold", sim)
    for before, after in pairwise(states):
        rests = np.asarray(before.distance) < 0.1
        np.testing.assert_array_equal(np.asarray(after.command)[rests], np.asarray(before.command)[rests])
    assert (np.asarray(states[-2].distance) < 0.1).all()
    assert (np.asarray(states[-1].distance) > 0.05).all() or sim == "mujoco", "the tool stays where it came in"
    states, _, _ = reach_and_stay("continue", "kinematic")
    assert (np.asarray(states[-1].distance) < 0.05).all(), "it continues to the middle where nothing holds the arm"


HOLDING = {
    "hold_steps": 20,
    "hold_speed": 10.0,
    "action": "tool_delta",
    "reward": "dense",
    "success_distance": 0.1,
    "start_noise": 0.0,
    "control_period": 1 / 240,
    "tool": "link_7",
}
"""The tutorial's rules, but for how long the target has to be held."""


def test_held_long_enough_an_episode_ends_in_success_if_the_task_says_so() -> None:
    states, last, _ = reach_and_stay("end", "kinematic", task="precise", **HOLDING)
    assert len(states) < 301
    ended = np.asarray(last.terminated)
    assert np.asarray(last.terms["success"])[ended].all()
    for state in states[-20:]:
        assert (np.asarray(state.distance)[ended] < 0.1).all()


def test_a_caller_may_change_what_it_gave() -> None:
    env = Env(configure("clutter", clip_actions=False, randomise=()), 2)
    state = env.init(env_keys(0, 2))
    goal, action = jax.tree.map(np.array, state.goal), np.full((2, 7), 0.01, np.float32)
    begun = env.init(env_keys(0, 2), goal)
    after, _ = env.step(begun, action)
    goal.position[:], action[:] = 9.0, 9.0
    np.testing.assert_array_equal(begun.goal.position, state.goal.position)
    np.testing.assert_allclose(after.last_action, 0.01, rtol=1e-6)
    bodies, simulator = jax.tree.map(np.array, after.arm.bodies), cast("Any", env.simulator)
    for height in (0.7, 0.8):
        bodies.position[..., 2] = height
        after, _ = env.step(env.rearrange(after, bodies), action)
        assert simulator.model(0).geom("reachlab_body_0").pos[2] == pytest.approx(height)
    env.close()


# --- where episodes begin -------------------------------------------------------------------------


@pytest.mark.parametrize("sim", tried(["kinematic", "mujoco"], ["mujoco"]))
def test_a_share_of_episodes_begins_where_the_last_one_ended_if_that_is_inside(sim: str) -> None:
    env = Env(configure(sim=sim), 200)
    state, reset = env.compile_whole(env.init)(env_keys(0, 200)), env.compile_whole(env.reset)
    home, away = np.asarray(state.arm.q), np.asarray(state.arm.q) + np.float32(0.05)
    inside = replace(state, arm=replace(state.arm, q=jnp.asarray(away)))
    begun = reset(inside, np.ones(200, bool), 0.5)
    stayed = np.isclose(np.asarray(begun.arm.q), away, atol=1e-6).all(axis=1)
    np.testing.assert_allclose(np.asarray(begun.arm.q)[~stayed], home[~stayed], atol=1e-6)
    assert 0.35 < stayed.mean() < 0.65
    assert not np.allclose(np.asarray(begun.goal.position), np.asarray(state.goal.position), atol=1e-3)
    outside = replace(inside, arm=replace(inside.arm, tool_position=inside.arm.tool_position + 1.0))
    np.testing.assert_allclose(np.asarray(reset(outside, np.ones(200, bool), 1.0).arm.q), home, atol=1e-6)
    env.close()


@pytest.mark.parametrize(("task", "sim"), [("precise", "mujoco"), ("clutter", "mujoco"), ("push", "pybullet")])
def test_what_is_compiled_ahead_is_what_episodes_and_their_steps_need(task: str, sim: str) -> None:
    env = Env(configure(task, sim=sim), 2)
    steps_ahead(env)
    parts = [env.parts.begin, env.parts.command, env.parts.judge, env.observed]
    parts.append(env.sample._sample)
    ahead = [dict(part._programs) for part in parts]
    state = env.init(env_keys(0, 2))
    env.observe_now(state)
    env.step(state, np.zeros((2, len(env.action_bounds[0])), np.float32))
    assert [part._programs for part in parts] == ahead
    assert list(map(len, ahead)) == [1] * len(parts)
    env.close()
