"""What holds for an environment of the tables, whatever its robot, task, simulator, observation, action and reward.

`CHECKS` are functions of a `Subject`: the conformance suite runs them over the combinations of the tables, and the test
of extensions over entries of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, Transition
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.tasks.schema import Schema

NUM_ENVS, STEPS, EPISODE = 4, 60, 25

SOFT_LIMIT = 0.01
"""How far a joint stop gives way where it is a spring [rad]."""


OF_OBSTACLES = ("bodies", "clearance", "scene")
"""Parts of observations of which some are still as long as no obstacle has come near a link, or a point of a grid; and
of bodies, as upright ones, which numbers never change."""


def parts_of(schema: Schema, observation: Any) -> list[Any]:
    """Picture, vector and rows of an observation, those that it has."""
    return [part for part in (*schema.split(observation), schema.rows(observation)) if part is not None]


@dataclass(frozen=True)
class Trajectory:
    """What was observed: `observation [T, B, k]`, `reward, done [T, B]`, `q [T, B, n]`, starts `first [E, B, k]`."""

    observation: np.ndarray
    reward: np.ndarray
    done: np.ndarray
    q: np.ndarray
    first: np.ndarray


class Subject:
    """An environment of the tables under random actions, and its trajectory of seed 0 as `seen`."""

    def __init__(self, task: str, robot: str, sim: str, observation: str, action: str, reward: str) -> None:
        config = configure(
            task,
            robot=robot,
            sim=sim,
            observation=observation,
            action=action,
            reward=reward,
            max_steps=EPISODE,
            randomise=(),
            start_noise=0.0,
            **({"settle_steps": 5} if task == "track" else {}),
        )
        self.sim, self.task = sim, task
        self.env = Env(config, NUM_ENVS)
        self.give = SOFT_LIMIT if max(self.env.setup.lag) > 0 else 0.0
        self.init: Callable[..., EnvState] = self.env.compile_whole(self.env.init)
        self.step: Callable[..., tuple[EnvState, Transition]] = self.env.compile_whole(self.env.step)
        self.reset: Callable[..., EnvState] = self.env.compile_whole(self.env.reset)
        self.seen = self.trajectory(0)

    def observe(self, state: EnvState) -> np.ndarray:
        return self.flat(self.env.observe_now(state))

    def flat(self, observation: object) -> np.ndarray:
        """Observation `[B, k]`, the parts of one that has several joined."""
        return np.concatenate(
            [np.asarray(part).reshape(NUM_ENVS, -1) for part in parts_of(self.env.schema, observation)], axis=1
        )

    def start(self, seed: int = 0) -> EnvState:
        return self.init(env_keys(seed, NUM_ENVS))

    def actions(self, steps: int) -> np.ndarray:
        low, high = self.env.action_bounds
        return np.random.default_rng(7).uniform(low, high, (steps, NUM_ENVS, len(low))).astype(np.float32)

    def trajectory(self, seed: int) -> Trajectory:
        state, rows = self.start(seed), []
        firsts = [self.observe(state)]
        for actions in self.actions(STEPS):
            state, done = self.step(state, actions)
            seen = self.observe(state) if done.observation is None else self.flat(done.observation)
            rows.append([np.array(x) for x in (seen, done.reward, done.done, state.arm.q)])
            state = self.reset(state, done.done)
            if done.done.any():
                firsts.append(self.observe(state))
        observation, reward, ends, q = (np.stack(column) for column in zip(*rows, strict=True))
        return Trajectory(observation, reward, ends, q, np.stack(firsts))


def copied(tree: object) -> list[np.ndarray]:
    return [
        np.array(jax.random.key_data(leaf) if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) else leaf)
        for leaf in jax.tree.leaves(tree)
    ]


def the_same_seed_gives_the_same_trajectory(subject: Subject) -> None:
    again = subject.trajectory(0)
    for name, value in vars(subject.seen).items():
        assert np.array_equal(value, vars(again)[name]), name


def another_seed_gives_another_trajectory(subject: Subject) -> None:
    assert not np.array_equal(subject.trajectory(1000).observation, subject.seen.observation)


def two_resets_differ(subject: Subject) -> None:
    starts = subject.seen.first[:, 0]
    assert len(starts) >= 2
    assert len(np.unique(starts, axis=0)) == len(starts)


def environments_differ(subject: Subject) -> None:
    assert len(np.unique(subject.seen.first[0], axis=0)) == NUM_ENVS


def observations_are_finite_and_inside_the_bounds_of_their_schema(subject: Subject) -> None:
    schema = subject.env.schema
    low, high = (np.concatenate([part.ravel() for part in parts_of(schema, side)]) for side in schema.bounds)
    for observation in (subject.seen.observation, subject.seen.first):
        assert observation.shape[1:] == (NUM_ENVS, len(low))
        assert np.isfinite(observation).all()
        assert (observation >= low).all()
        assert (observation <= high).all()


def an_observation_has_the_form_that_its_schema_says(subject: Subject) -> None:
    schema, observation = subject.env.schema, subject.env.observe_now(subject.start())
    low, _ = schema.bounds
    assert jax.tree.structure(observation) == jax.tree.structure(low)
    for part, bound in zip(jax.tree.leaves(observation), jax.tree.leaves(low), strict=True):
        assert (part.shape[1:], part.dtype) == (bound.shape, bound.dtype)
    _, vector = schema.split(observation)
    assert (0 if vector is None else vector.shape[-1]) == schema.vector_size


def no_number_of_an_observation_is_constant_but_those_of_which_the_schema_says_so(subject: Subject) -> None:
    if subject.env.pictured:
        return  # a picture has parts that nothing passes through
    seen = subject.seen
    everything = np.concatenate([seen.observation, seen.first]).reshape(-1, seen.first.shape[-1])
    still = np.ptp(everything, axis=0) < 1e-6
    fields = subject.env.schema.fields
    declared = np.concatenate([field.constant for field in fields])
    judged = np.concatenate([np.full(len(field.constant), field.name not in OF_OBSTACLES) for field in fields])
    assert np.array_equal(still[judged], declared[judged])
    assert still[~judged].sum() <= (~judged).sum() / 2


def rewards_are_finite_and_bounded(subject: Subject) -> None:
    assert np.isfinite(subject.seen.reward).all()
    assert np.abs(subject.seen.reward).max() <= 1.5


def joints_stay_within_their_limits_and_move(subject: Subject) -> None:
    chain, q = subject.env.setup.robot.chain, subject.seen.q
    assert (q >= np.array(chain.lower, np.float32) - subject.give).all()
    assert (q <= np.array(chain.upper, np.float32) + subject.give).all()
    moved = np.ptp(q, axis=(0, 1)) > 1e-4
    rules = subject.env.config.rules
    if subject.env.config.robot == "ur5e" and rules.action == "tool_delta":
        moved[4] = True  # the second wrist joint of a UR stays where it is while its tool is held upright
    assert moved.all()


def every_episode_ends_in_time(subject: Subject) -> None:
    lengths = np.diff(np.flatnonzero(np.concatenate([[True], subject.seen.done[:, 0]])))
    assert len(lengths) >= 2
    assert lengths.max() <= EPISODE


def a_step_leaves_the_state_it_was_given_as_it_was(subject: Subject) -> None:
    state = subject.start()
    for _ in range(2):
        before = copied(state)
        after, _ = subject.step(state, subject.actions(1)[0])
        for old, now in zip(before, copied(state), strict=True):
            assert np.array_equal(old, now)
        assert not np.array_equal(np.asarray(after.arm.q), np.asarray(state.arm.q))
        state = after


def results_share_no_memory_with_later_ones(subject: Subject) -> None:
    state, actions = subject.start(), subject.actions(3)
    state, first = subject.step(state, actions[0])
    kept = [np.asarray(leaf) for leaf in jax.tree.leaves(first)]
    before = [leaf.copy() for leaf in kept]
    for action in actions[1:]:
        state, _ = subject.step(state, action)
    assert all(np.array_equal(old, now) for old, now in zip(before, kept, strict=True))


CHECKS: tuple[Callable[[Subject], None], ...] = (
    the_same_seed_gives_the_same_trajectory,
    another_seed_gives_another_trajectory,
    two_resets_differ,
    environments_differ,
    observations_are_finite_and_inside_the_bounds_of_their_schema,
    an_observation_has_the_form_that_its_schema_says,
    no_number_of_an_observation_is_constant_but_those_of_which_the_schema_says_so,
    rewards_are_finite_and_bounded,
    joints_stay_within_their_limits_and_move,
    every_episode_ends_in_time,
    a_step_leaves_the_state_it_was_given_as_it_was,
    results_share_no_memory_with_later_ones,
)
