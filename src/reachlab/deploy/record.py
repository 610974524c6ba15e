"""Recording of episodes as a LeRobot dataset, to train policies of other libraries by imitation."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from reachlab.agents.acting import Function, name_of
from reachlab.agents.policy import Policy
from reachlab.control.bodies import Bodies
from reachlab.deploy.lerobot_units import Motors, motors_of
from reachlab.envs.core import Env
from reachlab.envs.random_streams import RECORD_STREAM
from reachlab.evaluation.episodes import Step, Watch, ignore, make_runner, run_episodes
from reachlab.render import CAMERAS
from reachlab.render.observation_camera import ObservationCamera
from reachlab.render.view_randomisation import Views, develop, make_views
from reachlab.settings.json_form import flatten, to_json
from reachlab.settings.validation import InputError, choose, installing

PART = 100
"""Episodes that are tried at a time, and whose steps are in one file. LeRobot tells pictures apart by times in single
precision, in which a longer film has too few digits."""

PATIENCE = 1000
"""Episodes without any success after which recording stops."""


class Rows(NamedTuple):
    """Steps: where the arm is and the command `[R, m]` [rad or m], the goal `[R, 3]` m, bodies, the reward `[R]`."""

    actuated: np.ndarray
    command: np.ndarray
    goal: np.ndarray
    bodies: Bodies
    reward: np.ndarray


@dataclass(frozen=True)
class Recorded:
    """A dataset: its folder, episodes and steps, how many episodes were tried, its size [bytes], time taken [s]."""

    out: str
    episodes: int
    steps: int
    tried: int
    bytes: int
    seconds: float


def record(
    env: Env,
    agent: str | Function,
    policy: Policy | None = None,
    *,
    out: str | Path,
    episodes: int = 100,
    seed: int = 0,
    cameras: Sequence[str] = ("front",),
    size: int = 96,
    failures: bool = False,
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
        episodes: how many are recorded.
        seed: seed of the targets.
        cameras: names in `CAMERAS`.
        size: height and width of pictures, an even number [pixels].
        failures: episodes without success are recorded too.
        checkpoint: what names the policy in the dataset, see `Manifest.identity`.
        watch: called with the number of episodes that are written.

    Raises:
        InputError: something else is in the folder, it cannot be written, there is no such agent or camera, or none of
            many episodes is a success.
    """
    angles = {f"observation.images.{name}": CAMERAS[choose("camera", name, CAMERAS)].angles for name in cameras}
    if size % 2:
        raise InputError(f"size must be even, for the colours of a film, got {size}.")
    try:
        dataset, _ = import_module("reachlab.deploy.lerobot_dataset"), import_module("imageio_ffmpeg")
    except ImportError:
        raise InputError(f"a LeRobot dataset needs pyarrow and imageio-ffmpeg: {installing('lerobot')}.") from None
    start, out, robot, steps = time.perf_counter(), Path(out), env.setup.robot, list[Step]()
    motors, rate = motors_of(env.config.robot, robot), 1 / env.setup.period
    task = env.setup.task.asks(env.setup.rules, env.setup.period).partition(":")[0]
    fps = int(rate) if rate.is_integer() else rate
    layout = dataset.Layout(robot.name, task, fps, motors.names, tuple(angles), size)
    settings = {"agent": name_of(agent), "checkpoint": checkpoint, "seed": seed, "episodes": episodes, "size": size}
    settings |= {"cameras": cameras, "failures": failures, "at_once": env.num_envs}
    runner = make_runner(env, agent, episodes, keep=lambda step: steps.append(_without_engine(step)))
    try:
        written = dataset.begin(out, flatten(to_json(env.config)) | settings)
        number = -(-written.number // env.num_envs) * env.num_envs
        with ExitStack() as stack:
            studio = {key: stack.enter_context(_camera(env, size, colour=bool(own))) for key, own in angles.items()}
            while written.episodes < episodes:
                steps.clear()
                played = run_episodes(runner, policy, seed, RECORD_STREAM, env.num_envs, number)
                chosen = np.flatnonzero(played.success | failures)[: episodes - written.episodes]
                if len(chosen):
                    rows, lengths = _rows(steps, chosen, played.steps[chosen]), played.steps[chosen]
                    samples = np.asarray(env.functions.view_samples(steps[0].state.key))[chosen]
                    drawn = partial(_draw, env, studio, angles, rows, lengths, samples)
                    features = _features(motors, rows, lengths, played.success[chosen])
                    part = dataset.Part(features, lengths, number + chosen, drawn)
                    written = dataset.write_part(out, layout, written, part)
                number += env.num_envs
                if number - written.number >= PATIENCE:
                    raise InputError(
                        f"none of {number - written.number:,} episodes in a row is a success of agent"
                        f" {name_of(agent)!r}: choose another, or record failures too with --failures."
                    )
                watch(written.episodes)
        dataset.finish(out, layout, written)
    except OSError as error:
        raise InputError(f"the dataset cannot be written to '{out}': {error.strerror or error}.") from None
    stored = sum(file.stat().st_size for file in out.rglob("*") if file.is_file())
    return Recorded(str(out), written.episodes, written.steps, written.number, stored, time.perf_counter() - start)


def _without_engine(step: Step) -> Step:
    return step._replace(state=replace(step.state, arm=replace(step.state.arm, engine=None)))


def _rows(steps: Sequence[Step], chosen: np.ndarray, lengths: np.ndarray) -> Rows:
    """Steps of those that are `chosen [E]` of a batch of episodes, up to their lengths `[E]`."""
    within = np.arange(len(steps)) < lengths[:, None]

    def of_batch(step: Step) -> Rows:
        arm = step.state.arm
        actuated = np.concatenate([arm.q, arm.opening], axis=1)
        return Rows(
            actuated,
            np.asarray(step.command),
            np.asarray(step.state.goal.position),
            arm.bodies,
            np.asarray(step.reward),
        )

    return jax.tree.map(lambda *parts: np.stack(parts, axis=1)[chosen][within], *map(of_batch, steps))


def _features(motors: Motors, rows: Rows, lengths: np.ndarray, success: np.ndarray) -> dict[str, np.ndarray]:
    """Features of the steps of episodes of such lengths `[E]`, that are a success or not `[E]`."""
    outcome = np.zeros((2, len(rows.reward)), bool)
    outcome[:, np.cumsum(lengths) - 1] = np.ones_like(success), success
    read = {"observation.state": motors.read(rows.actuated), "action": motors.read(rows.command)}
    return read | {"next.reward": rows.reward, "next.done": outcome[0], "next.success": outcome[1]}


def _camera(env: Env, size: int, *, colour: bool) -> closing[ObservationCamera]:
    objects = env.setup.task.scene(env.setup).objects > 0
    return closing(ObservationCamera(env.setup.robot, objects=objects, size=size, colour=colour))


def _draw(
    env: Env, studio: Mapping[str, ObservationCamera], angles: Any, rows: Rows, lengths: Any, samples: Any, key: str
) -> Iterator[np.ndarray]:
    """Pictures `[steps, size, size, 3]` uint8 of each episode, of the rows and view samples of all of them."""
    objects = env.setup.task.scene(env.setup).objects > 0
    views = make_views(samples, env.setup.robot, objects=objects, angles=angles[key])
    for episode, (end, length) in enumerate(zip(np.cumsum(lengths), lengths, strict=True)):
        now: Rows = jax.tree.map(lambda part, own=slice(end - length, end): part[own], rows)
        seen = Views(*(np.repeat(part[episode : episode + 1], length, axis=0) for part in views))
        pictures = develop(studio[key].pictures(now.actuated, now.goal, now.bodies, seen), seen)
        yield pictures if pictures.ndim > 3 else np.repeat(pictures[..., None], 3, axis=-1)
