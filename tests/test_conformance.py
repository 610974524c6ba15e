"""What holds for every robot, simulator, observation, action and reward of the tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, Transition
from reachlab.envs.streams import env_keys
from reachlab.robots.catalogue import ROBOTS
from reachlab.settings.presets import configure
from reachlab.settings.validation import InputError
from reachlab.sims import SIMULATORS
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.rewards import REWARDS

LANES, STEPS, EPISODE = 4, 60, 25

CONSTANT = {"target": {2}, "target+tool": {2}, "state": {26}}
"""Elements of an observation that never change: the height of the tutorial's targets."""

LAG = {"state": set(range(14, 21))}
"""Elements that do not change where joints are set: how far they are behind their commands."""

SOFT_LIMIT = 0.01
"""How far a joint stop gives way where it is a spring [rad]."""

SEEN_WITH = ("tool_delta", "sparse")
"""Action and reward with which pictures are tried: they change nothing of what is seen."""

COMBINATIONS = [
    names
    for names in product(ROBOTS, SIMULATORS, OBSERVATIONS, ACTIONS, REWARDS)
    if not OBSERVATIONS[names[2]].pictured or names[3:] == SEEN_WITH
]


@dataclass(frozen=True)
class Trajectory:
    """What was seen: `observation [T, B, k]`, `reward, done [T, B]`, joints `q [T, B, n]`, starts `first [E, B, k]`."""

    observation: np.ndarray
    reward: np.ndarray
    done: np.ndarray
    q: np.ndarray
    first: np.ndarray


class Subject:
    """An environment of the tables under random actions."""

    def __init__(self, robot: str, sim: str, observation: str, action: str, reward: str) -> None:
        config = configure(
            robot=robot, sim=sim, observation=observation, action=action, reward=reward, max_steps=EPISODE
        )
        self.observation, self.sim = observation, sim
        self.give = SOFT_LIMIT if SIMULATORS[sim].real_time else 0.0
        self.env = Env(config, LANES)
        self.init: Callable[..., EnvState] = self.env.compile_whole(self.env.init)
        self.step: Callable[..., tuple[EnvState, Transition]] = self.env.compile_whole(self.env.step)
        self.reset: Callable[..., EnvState] = self.env.compile_whole(self.env.reset)
        self.look: Callable[..., np.ndarray] = lambda state: flat(self.env.observe_now(state))

    def start(self, seed: int = 0) -> EnvState:
        return self.init(env_keys(seed, LANES))

    def actions(self, steps: int) -> np.ndarray:
        low, high = self.env.action_bounds
        return np.random.default_rng(7).uniform(low, high, (steps, LANES, len(low))).astype(np.float32)

    def trajectory(self, seed: int) -> Trajectory:
        state, rows = self.start(seed), []
        firsts = [self.look(state)]
        for actions in self.actions(STEPS):
            state, done = self.step(state, actions)
            seen = self.look(state) if done.observation is None else done.observation
            rows.append([np.array(x) for x in (seen, done.reward, done.done, state.arm.q)])
            state = self.reset(state, done.done)
            if done.done.any():
                firsts.append(self.look(state))
        observation, reward, ends, q = (np.stack(column) for column in zip(*rows, strict=True))
        return Trajectory(observation, reward, ends, q, np.stack(firsts))


def flat(observation: object) -> np.ndarray:
    """Observation `[B, k]`, the parts of one that has several joined."""
    return np.concatenate([np.asarray(part).reshape(LANES, -1) for part in jax.tree.leaves(observation)], axis=1)


@pytest.fixture(scope="module", params=COMBINATIONS, ids="-".join)
def subject(request: pytest.FixtureRequest) -> Iterator[Subject]:
    try:
        subject = Subject(*request.param)
    except InputError as error:
        # An optional simulator that is not installed says how to install it.
        if "pip install" not in str(error):
            raise
        pytest.skip(str(error))
    yield subject
    subject.env.close()


@pytest.fixture(scope="module")
def seen(subject: Subject) -> Trajectory:
    return subject.trajectory(0)


def copied(tree: object) -> list[np.ndarray]:
    return [
        np.array(jax.random.key_data(leaf) if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) else leaf)
        for leaf in jax.tree.leaves(tree)
    ]


def test_the_same_seed_gives_the_same_trajectory(subject: Subject, seen: Trajectory) -> None:
    again = subject.trajectory(0)
    for name, value in vars(seen).items():
        assert np.array_equal(value, vars(again)[name]), name


def test_another_seed_gives_another_trajectory(subject: Subject, seen: Trajectory) -> None:
    assert not np.array_equal(subject.trajectory(1000).observation, seen.observation)


def test_two_resets_differ(seen: Trajectory) -> None:
    starts = seen.first[:, 0]
    assert len(starts) >= 3
    assert len(np.unique(starts, axis=0)) == len(starts)


def test_lanes_differ(seen: Trajectory) -> None:
    assert len(np.unique(seen.first[0], axis=0)) == LANES


def test_observations_are_finite_and_inside_their_bounds(subject: Subject, seen: Trajectory) -> None:
    low, high = (np.concatenate([x.ravel() for x in jax.tree.leaves(side)]) for side in subject.env.schema.bounds)
    for observation in (seen.observation, seen.first):
        assert observation.shape[1:] == (LANES, len(low))
        assert observation.dtype == (np.uint8 if subject.observation == "image" else np.float32)
        assert np.isfinite(observation).all()
        assert (observation >= low).all()
        assert (observation <= high).all()


def test_no_element_of_an_observation_is_constant_but_the_declared_ones(subject: Subject, seen: Trajectory) -> None:
    if subject.env.pictured:
        pytest.skip("a picture has parts that nothing passes through")
    everything = np.concatenate([seen.observation, seen.first]).reshape(-1, seen.first.shape[-1])
    still = set(np.flatnonzero(np.ptp(everything, axis=0) < 1e-6).tolist())
    lag = set() if SIMULATORS[subject.sim].real_time else LAG.get(subject.observation, set())
    assert still == CONSTANT[subject.observation] | lag


def test_rewards_are_finite_and_bounded(seen: Trajectory) -> None:
    assert np.isfinite(seen.reward).all()
    assert np.abs(seen.reward).max() <= 1.5
    assert (seen.reward[seen.done] != 0).all()


def test_joints_stay_within_their_limits_and_move(subject: Subject, seen: Trajectory) -> None:
    chain = subject.env.setup.robot.chain
    assert (seen.q >= np.array(chain.lower, np.float32) - subject.give).all()
    assert (seen.q <= np.array(chain.upper, np.float32) + subject.give).all()
    assert (np.ptp(seen.q, axis=(0, 1)) > 1e-4).all()


def test_every_episode_ends_in_time(seen: Trajectory) -> None:
    lengths = np.diff(np.flatnonzero(np.concatenate([[True], seen.done[:, 0]])))
    assert len(lengths) >= 2
    assert lengths.max() <= EPISODE


def test_a_step_leaves_the_state_it_was_given_as_it_was(subject: Subject) -> None:
    state = subject.start()
    for _ in range(2):
        before = copied(state)
        after, _ = subject.step(state, subject.actions(1)[0])
        for old, now in zip(before, copied(state), strict=True):
            assert np.array_equal(old, now)
        assert not np.array_equal(np.asarray(after.arm.q), np.asarray(state.arm.q))
        state = after


def test_results_share_no_memory_with_later_ones(subject: Subject) -> None:
    state, actions = subject.start(), subject.actions(3)
    state, first = subject.step(state, actions[0])
    kept = [np.asarray(leaf) for leaf in jax.tree.leaves(first)]
    before = [leaf.copy() for leaf in kept]
    for action in actions[1:]:
        state, _ = subject.step(state, action)
    assert all(np.array_equal(old, now) for old, now in zip(before, kept, strict=True))
