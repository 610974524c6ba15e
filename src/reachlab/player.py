"""Plays an agent's episodes on one arm in real time; the target may be moved by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab import task
from reachlab.env import Env, EnvState, Transition
from reachlab.evaluation import compile_agent
from reachlab.policy import Policy
from reachlab.streams import AGENT_STREAM, REPORT_STREAM, episode_keys

Advance = Callable[[Policy | None, EnvState, Array], tuple[EnvState, Transition, Array]]


@dataclass(frozen=True)
class Moment:
    """What there is to see.

    Attributes:
        q: joints `[n]` [rad or m].
        tool, orientation: of the tool, `[3]` [m] and `[4]` wxyz.
        target: `[3]` [m].
        distance: from tool to target [m].
        reached: the task calls this a success; a target that is held stays reached until it is moved.
    """

    q: np.ndarray
    tool: np.ndarray
    orientation: np.ndarray
    target: np.ndarray
    distance: float
    reached: bool


class Player:
    """One arm, driven step by step.

    Attributes:
        moment: the arm now.
        over: the episode has ended; it begins anew with `new_episode`.
        steps: control steps taken.
        episodes, successes: those that ended, and in success. One whose target was held or moved does not count.
    """

    def __init__(self, env: Env, seed: int) -> None:
        """Player of the held-out targets of a seed, on an environment of one lane."""
        self._env = env
        self._advances: dict[str, Advance] = {}
        self._begin = env.compile(lambda state: env.reset(state, np.ones(1, bool)))
        keys = episode_keys(seed, REPORT_STREAM, 0, 1)
        self._state: EnvState = env.compile(env.init)(keys)
        self._key = jax.random.fold_in(keys[0], AGENT_STREAM)
        self._held = self._touched = self.over = False
        self.steps = self.episodes = self.successes = 0
        self.moment = self._look(reached=False)

    def step(self, agent: str, policy: Policy | None) -> None:
        """Take one control step with an agent of `AGENTS`."""
        if agent not in self._advances:
            self._advances[agent] = make_advance(self._env, agent)
        self._state, transition, self._key = self._advances[agent](policy, self._state, self._key)
        self.steps += 1
        done, success = (bool(np.asarray(row)[0]) for row in (transition.done, transition.terms["success"]))
        self.moment = self._look(reached=success or (self._held and self.moment.reached))
        self.over = done and not self._held
        if self.over and not self._touched:
            self.episodes += 1
            self.successes += success

    def see(self) -> np.ndarray | None:
        """What the policy sees now, `[SIZE, SIZE, 3]` uint8, if that is a picture."""
        seen = self._env.see(self._state)
        return None if seen is None else np.stack([seen[0]] * 3, axis=-1)

    def hold(self, held: bool) -> None:
        """Let no episode end while `held`."""
        self._held, self._touched = held, self._touched or held
        self.over = self.over and not held

    def move_target(self, target: np.ndarray) -> None:
        """Put the target at `[3]` [m]; the arm goes on from where it is, with all the time of an episode."""
        state = self._state
        row = jnp.asarray(target, jnp.float32)[None]
        distance = jnp.linalg.norm(state.arm.tool_position - row, axis=-1)
        recent = task.nothing_held(self._env.reach, 1)
        self._state = replace(state, target=row, distance=distance, recent=recent, clock=jnp.zeros_like(state.clock))
        self._touched, self.over = True, False
        self.moment = self._look(reached=False)

    def new_episode(self) -> None:
        """Begin an episode with a new target."""
        self._state = self._begin(self._state)
        self._touched = self.over = False
        self.moment = self._look(reached=False)

    def _look(self, *, reached: bool) -> Moment:
        state = self._state
        rows = (state.arm.q, state.arm.tool_position, state.arm.tool_quaternion, state.target)
        q, tool, orientation, target = (np.asarray(row)[0] for row in rows)
        return Moment(q, tool, orientation, target, float(np.asarray(state.distance)[0]), reached)


def make_advance(env: Env, agent: str) -> Advance:
    """Function that gives state, transition and random key after a control step of an agent."""
    decide = compile_agent(env, agent)

    def advance(policy: Policy | None, state: EnvState, key: Array) -> tuple[EnvState, Transition, Array]:
        key, now = jax.random.split(key)
        state, transition = env.step(state, decide(policy, state, now, None))
        return state, transition, key

    return env.compile(advance)


def target_box(reach: task.Reach) -> np.ndarray:
    """Lower and upper corner `[2, 3]` of the task's targets [m]."""
    return np.stack(task.TARGETS[reach.config.targets](reach))
