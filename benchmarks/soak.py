"""Suite `soak`: bad actions, environments that take turns, and simulators made and closed many times."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import jax
import numpy as np

from reachlab.bench.table import Row, row
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.envs.gymnasium_single import ReachEnv
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.settings.validation import InputError
from reachlab.sims import SIMULATORS

ACTIONS, BAD_SHARE = 100_000, 0.01
"""Random actions, and how many of them are bad."""

INTERLEAVINGS, NUM_ENVS, STEPS = 100, 2, 25
"""Random orders in which two batches take turns; environments and steps of each."""

OPENINGS, WARM_UP = 200, 20
"""Times that a simulator is made and closed, and how many of them may still grow the process."""


MAKINGS, LONG_RUN = 1000, 10_000_000
"""Times that an environment of Gymnasium is made, stepped and closed; and steps of one that stays."""


def soak() -> Iterator[Row]:
    """The rows of suite `soak`."""
    yield makings()
    yield long_run()
    for name in SIMULATORS:
        yield bad_actions(name)
        yield interleavings(name)
        yield openings(name)


Spoil = Callable[[np.ndarray, np.random.Generator], object]


def _put(value: float) -> Spoil:
    def spoil(action: np.ndarray, random: np.random.Generator) -> np.ndarray:
        spoilt = action.astype(np.float64)
        spoilt[random.integers(len(action))] = value
        return spoilt

    return spoil


BAD: dict[str, Spoil] = {
    "nan": _put(np.nan),
    "infinite": _put(-np.inf),
    "beyond float32": _put(1e300),
    "too long": lambda action, _: np.append(action, 0.0),
    "too short": lambda action, _: action[:-1],
    "batched": lambda action, _: action[None],
    "text": lambda _, __: "left",
    "nothing": lambda _, __: None,
}
"""Actions that have to be refused."""

HUGE = 1e30
"""Finite: not refused, but it must not break anything [action]."""


def bad_actions(sim: str, actions: int = ACTIONS, share: float = BAD_SHARE) -> Row:
    """Faults among random actions, without clipping.

    A fault is a number that is not finite, or a bad action that is not refused or has moved the arm.
    """
    env = ReachEnv(sim=sim, clip_actions=False)
    random, faults, refused = np.random.default_rng(0), 0, 0
    env.action_space.seed(0)
    env.reset(seed=0)
    for _ in range(actions):
        action = env.action_space.sample()
        if random.random() < share:
            kind = random.choice([*BAD, "huge"])
            if kind != "huge":
                refused += 1
                faults += not _refuses(env, BAD[kind](action, random))
                continue
            action = _put(HUGE)(action, random)
        observation, reward, terminated, truncated, _ = env.step(np.asarray(action))
        faults += not (np.isfinite(observation).all() and np.isfinite(reward))
        if terminated or truncated:
            env.reset()
    env.close()
    return row(f"bad_action_faults/{sim}", faults, "of all", actions=actions, refused=refused)


def _refuses(env: ReachEnv, action: object) -> bool:
    """Whether an action is refused in a sentence and the state is as before."""
    before = _plain(env.state)
    try:
        env.step(action)  # pyright: ignore[reportArgumentType]
    except InputError as error:
        return str(error).startswith("action") and _equal(before, _plain(env.state))
    return False


def interleavings(sim: str, count: int = INTERLEAVINGS) -> Row:
    """Random orders of two batches' steps in which each came to exactly the state that it comes to alone."""
    envs = [Env(configure(sim=sim, max_steps=STEPS // 2), NUM_ENVS) for _ in range(2)]
    low, high = envs[0].action_bounds
    turns = [_turn(env) for env in envs]
    begin = envs[0].compile_whole(envs[0].init)
    same = 0
    for number in range(count):
        random = np.random.default_rng(number)
        moves = random.uniform(low, high, (2, STEPS, NUM_ENVS, len(low))).astype(np.float32)
        alone = []
        for which in range(2):
            state = begin(env_keys(number + which, NUM_ENVS))
            for move in moves[which]:
                state = turns[which](state, move)
            alone.append(_plain(state))
        states = [begin(env_keys(number + which, NUM_ENVS)) for which in range(2)]
        queues = [iter(moves[which]) for which in range(2)]
        for which in random.permutation(np.repeat(range(2), STEPS)):
            states[which] = turns[which](states[which], next(queues[which]))
        same += all(_equal(x, _plain(state)) for x, state in zip(alone, states, strict=True))
    for env in envs:
        env.close()
    return row(f"interleavings_as_alone/{sim}", same, f"of {count}", num_envs=NUM_ENVS, steps=STEPS)


def _turn(env: Env) -> Callable[[EnvState, np.ndarray], EnvState]:
    """A function that makes a step, and resets the episodes that end in it."""
    step, reset = env.compile_whole(env.step), env.compile_whole(env.reset)

    def turn(state: EnvState, move: np.ndarray) -> EnvState:
        state, transition = step(state, move)
        return reset(state, transition.done) if np.asarray(transition.done).any() else state

    return turn


def _plain(state: EnvState) -> list[np.ndarray]:
    return [np.array(x) for x in jax.tree.leaves((state.arm, state.goal.position, state.command, state.clock))]


def _equal(a: list[np.ndarray], b: list[np.ndarray]) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def openings(sim: str, count: int = OPENINGS) -> Row:
    """Growth of the process while a simulator is made and closed many times."""
    config = configure(sim=sim)
    begun = (0.0, 0, 0)
    for number in range(count):
        if number == WARM_UP:
            begun = _held()
        env = Env(config, 2)
        env.init(env_keys(0, 2))
        env.close()
        del env
        gc.collect()
    return _growth(sim, begun, openings=count, warm_up=WARM_UP)


def makings(count: int = MAKINGS) -> Row:
    """Growth of the process while an environment of Gymnasium is made, stepped and closed many times."""
    begun = (0.0, 0, 0)
    for number in range(count):
        if number == WARM_UP:
            begun = _held()
        env = gymnasium.make("reachlab:reachlab/Reach-v0", max_steps=100 + number % 2)
        env.reset(seed=number)
        env.step(np.zeros(3, np.float32))
        env.close()
    gc.collect()
    return _growth("make and close", begun, makings=count)


def long_run(steps: int = LONG_RUN) -> Row:
    """Growth of the process in a long run of one environment of Gymnasium, episodes ending and beginning."""
    env = gymnasium.make("reachlab:reachlab/Reach-v0")
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(STEPS)]
    env.reset(seed=0)
    begun = (0.0, 0, 0)
    for number in range(steps):
        if number == steps // 100:
            begun = _held()
        _, _, terminated, truncated, _ = env.step(actions[number % STEPS])
        if terminated or truncated:
            env.reset()
    env.close()
    return _growth("one environment", begun, steps=steps)


def _growth(what: str, begun: tuple[float, int, int], **config: Any) -> Row:
    """Growth of the process since it held what it did when it had `begun`."""
    memory, files, threads = (now - before for now, before in zip(_held(), begun, strict=True))
    return row(f"growth/{what}", memory, "MB", files=files, threads=threads, **config)


def _held() -> tuple[float, int, int]:
    """What the process holds: memory [MB], open files, threads."""
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines())
    return int(status["VmRSS"].split()[0]) / 1024, len(list(Path("/proc/self/fd").iterdir())), int(status["Threads"])
