"""Recording of episodes as a LeRobot dataset, to train policies of other libraries by imitation."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from reachlab.agents.acting import Function, name_of
from reachlab.agents.policy import Policy
from reachlab.control.bodies import Bodies
from reachlab.deploy.lerobot_pictures import Studio
from reachlab.deploy.lerobot_units import Motors, motors_of
from reachlab.deploy.surroundings import surroundings
from reachlab.emit.behaviour import as_measured, example_state
from reachlab.envs.core import Env
from reachlab.envs.random_streams import RECORD_STREAM
from reachlab.evaluation.episodes import Episodes, Step, Watch, ignore, make_runner, run_episodes
from reachlab.render import CAMERAS
from reachlab.settings.arguments import typed
from reachlab.settings.config import RecordConfig
from reachlab.settings.json_form import flatten, to_json
from reachlab.settings.validation import InputError, choose, needing

PART = 100
"""Episodes that are tried at a time, and whose steps are in one file. LeRobot tells pictures apart by times in single
precision, in which a longer film has too few digits."""

PATIENCE = 1000
"""Episodes without any success after which recording stops."""


class Rows(NamedTuple):
    """Steps: where the arm is and the command `[R, m]` [rad or m], the reward `[R]`, and what is beside the arm.

    That is the goal `[R, 3]` m and the bodies, and both as numbers `[R, l]`, see `surroundings`.
    """

    actuated: np.ndarray
    command: np.ndarray
    reward: np.ndarray
    goal: np.ndarray
    bodies: Bodies
    beside: np.ndarray


@dataclass(frozen=True)
class Recorded:
    """A dataset: its folder, episodes and steps, how many episodes were tried, its size [bytes], time taken [s]."""

    out: str
    episodes: int
    steps: int
    tried: int
    bytes: int
    seconds: float


@typed
def record(
    env: Env,
    agent: str | Function,
    policy: Policy | None,
    out: str | Path,
    config: RecordConfig,
    *,
    checkpoint: Mapping[str, Any] | None = None,
    watch: Watch = ignore,
) -> Recorded:
    """Record episodes as a LeRobot dataset, version 3.0. One that was interrupted is resumed by the same call.

    None of its episodes is one of an evaluation, whatever its seed. What varies from one to the next is what
    `env.config.randomise` names; `env.num_envs` of them are tried at a time.

    Args:
        env: the environment.
        agent: name in `AGENTS`, or a function that gives actions `[B, a]` for observations with the batch in front.
        policy: the trained policy, for agent `trained`.
        out: folder to make.
        config: how many episodes, which, and their pictures.
        checkpoint: what names the policy in the dataset, see `Manifest.identity`.
        watch: called with the number of episodes that are written.

    Raises:
        InputError: something else is in the folder, it cannot be written, there is no such agent or camera, or none of
            many episodes is a success.
    """
    start, out, most, steps = time.perf_counter(), Path(out), config.episodes, list[Step]()
    cameras = {f"observation.images.{choose('camera', name, CAMERAS)}": name for name in config.cameras}
    dataset, motors = _lerobot_dataset(), motors_of(env.config.robot, env.setup.robot)
    like = example_state(as_measured(env.functions))
    beside = surroundings(like.goal, like.arm.bodies).shape[1]
    layout = dataset.Layout(motors.names, beside, tuple(cameras), config.size, *_named(env))
    settings = flatten(to_json(env.config)) | vars(config)
    settings |= {"agent": name_of(agent), "checkpoint": checkpoint, "at_once": env.num_envs}
    try:
        with ExitStack() as stack:
            studio = {
                key: stack.enter_context(closing(Studio(env, name, config.size))) for key, name in cameras.items()
            }
            runner = make_runner(env, agent, keep=lambda step: steps.append(step._replace(state=step.state.apart)))
            written = dataset.begin(out, settings)
            number = -(-written.number // env.num_envs) * env.num_envs
            while written.episodes < most:
                steps.clear()
                played = run_episodes(runner, policy, config.seed, RECORD_STREAM, env.num_envs, number)
                chosen = np.flatnonzero(played.success | config.failures)[: most - written.episodes]
                if len(chosen):
                    part = dataset.Part(*_part(env, motors, studio, steps, played, chosen), number + chosen)
                    written = dataset.write_part(out, layout, written, part)
                number += env.num_envs
                _check_patience(number - written.number, agent)
                watch(written.episodes)
            dataset.finish(out, layout, written)
    except OSError as error:
        raise InputError(f"the dataset cannot be written to '{out}': {error.strerror or error}.") from None
    stored = sum(file.stat().st_size for file in out.rglob("*") if file.is_file())
    return Recorded(str(out), written.episodes, written.steps, written.number, stored, time.perf_counter() - start)


def _lerobot_dataset() -> Any:
    with needing("a LeRobot dataset needs pyarrow and imageio-ffmpeg: {}.", "lerobot", ImportError):
        import_module("imageio_ffmpeg")
        return import_module("reachlab.deploy.lerobot_dataset")


def _named(env: Env) -> tuple[str, str, float]:
    """The arm, what is asked of it, and how many steps a second has."""
    setup, rate = env.setup, 1 / env.setup.period
    task, _, _ = setup.task.asks(setup.rules, setup.period).partition(":")
    return setup.robot.name, task, int(rate) if rate.is_integer() else rate


def _check_patience(tried: int, agent: str | Function) -> None:
    if tried >= PATIENCE:
        raise InputError(
            f"none of {tried:,} episodes in a row is a success of agent {name_of(agent)!r}: choose another, or record"
            " failures too with --failures."
        )


def _part(
    env: Env,
    motors: Motors,
    studio: Mapping[str, Studio],
    steps: Sequence[Step],
    played: Episodes,
    chosen: np.ndarray,
) -> tuple[dict[str, np.ndarray], np.ndarray, Callable[[str], Iterator[np.ndarray]]]:
    """See `lerobot_dataset.Part`, of those episodes that are `chosen [E]` of those played together."""
    played = jax.tree.map(lambda part: np.asarray(part)[chosen], played)
    lengths, within = np.asarray(played.steps), np.arange(len(steps)) < np.asarray(played.steps)[:, None]
    rows: Rows = jax.tree.map(lambda *parts: np.stack(parts, axis=1)[chosen][within], *map(_rows, steps))
    ends = np.cumsum(lengths) - 1
    done, success = np.zeros((2, len(rows.reward)), bool)
    done[ends], success[ends] = True, played.success
    features = {"observation.state": motors.read(rows.actuated), "action": motors.read(rows.command)}
    features |= {
        "observation.environment_state": rows.beside,
        "next.reward": rows.reward,
        "next.done": done,
        "next.success": success,
    }
    samples = np.asarray(env.functions.view_samples(steps[0].state.key))[chosen]
    return features, lengths, lambda key: _draw(studio[key], samples, lengths, rows)


def _rows(step: Step) -> Rows:
    arm, state = step.state.arm, step.state
    actuated = np.concatenate([arm.q, arm.opening], axis=1)
    known = map(np.asarray, (step.command, step.reward, state.goal.position))
    return Rows(actuated, *known, bodies=arm.bodies, beside=surroundings(state.goal, arm.bodies))


def _draw(studio: Studio, samples: np.ndarray, lengths: np.ndarray, rows: Rows) -> Iterator[np.ndarray]:
    """Pictures `[steps, size, size, 3]` uint8 of each episode, of their view samples, lengths and all their rows."""
    for sample, length, end in zip(samples, lengths, np.cumsum(lengths), strict=True):
        now: Rows = jax.tree.map(lambda part, own=slice(end - length, end): part[own], rows)
        yield studio.pictures(np.repeat(sample[None], length, axis=0), now.actuated, now.goal, now.bodies)
