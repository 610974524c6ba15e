"""Recording of episodes as a LeRobot dataset, to train policies of other libraries by imitation."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
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
from reachlab.evaluation.episodes import Episodes, Step, Watch, ignore, make_runner, run_episodes
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
    """Steps one after the other: where the arm is and the command `[R, m]` [rad or m], reward, goal and bodies."""

    actuated: np.ndarray
    command: np.ndarray
    reward: np.ndarray
    goal: np.ndarray
    bodies: Bodies


@dataclass(frozen=True)
class Recorded:
    """A dataset: its folder, its episodes and frames, how many episodes were tried, frames a second, size [bytes]."""

    out: str
    episodes: int
    frames: int
    tried: int
    fps: float
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
    `env.config.randomise` names; `num_envs` of them are tried at a time.

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
    for name in cameras:
        choose("camera", name, CAMERAS)
    if size % 2:
        raise InputError(f"size must be even, for the video's colours, got {size}.")
    try:
        dataset, _ = import_module("reachlab.deploy.lerobot_dataset"), import_module("imageio_ffmpeg")
    except ImportError:
        raise InputError(f"a LeRobot dataset needs pyarrow and imageio-ffmpeg: {installing('lerobot')}.") from None
    start, out, setup = time.perf_counter(), Path(out), env.setup
    motors = motors_of(env.config.robot, setup.robot)
    task, _, _ = setup.task.asks(setup.rules, setup.period).partition(":")
    fps = int(rate) if (rate := 1 / setup.period).is_integer() else rate
    layout = dataset.Layout(setup.robot.name, task, fps, motors.names, tuple(cameras), size)
    own = {"agent": name_of(agent), "checkpoint": checkpoint, "seed": seed, "episodes": episodes, "cameras": cameras}
    settings = flatten(to_json(env.config)) | own | {"size": size, "failures": failures, "at_once": env.num_envs}
    steps: list[Step] = []
    runner = make_runner(env, agent, episodes, keep=lambda step: steps.append(_without_engine(step)))
    try:
        with _studio(env, cameras, size) as studio:
            written = dataset.begin(out, settings)
            number = -(-written.number // env.num_envs) * env.num_envs
            while written.episodes < episodes:
                steps.clear()
                played = run_episodes(runner, policy, seed, RECORD_STREAM, env.num_envs, number)
                chosen = np.flatnonzero(played.success | failures)[: episodes - written.episodes]
                if len(chosen):
                    taken = jax.tree.map(lambda x, chosen=chosen: np.asarray(x)[chosen], played)
                    rows, samples = _rows(steps, chosen, taken.steps), _view_samples(env, steps[0], chosen)
                    drawn = partial(_draw, env, studio, rows, samples, taken.steps)
                    part = dataset.Part(_features(motors, rows, taken), taken.steps, number + chosen, drawn)
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
    size_bytes = sum(file.stat().st_size for file in out.rglob("*") if file.is_file())
    seconds = time.perf_counter() - start
    return Recorded(str(out), written.episodes, written.rows, written.number, layout.fps, size_bytes, seconds)


def _without_engine(step: Step) -> Step:
    return step._replace(state=replace(step.state, arm=replace(step.state.arm, engine=None)))


@contextmanager
def _studio(env: Env, cameras: Sequence[str], size: int) -> Iterator[dict[str, ObservationCamera]]:
    """Cameras by name, open until the context ends."""
    robot, objects = env.setup.robot, env.setup.task.scene(env.setup).objects > 0
    made = {name: ObservationCamera(robot, objects=objects, size=size, colour=CAMERAS[name].colour) for name in cameras}
    try:
        yield made
    finally:
        for camera in made.values():
            camera.close()


def _rows(steps: Sequence[Step], chosen: np.ndarray, lengths: np.ndarray) -> Rows:
    """Steps of those that are `chosen [E]` of a batch of episodes, up to their lengths `[E]`."""
    within = np.arange(len(steps)) < lengths[:, None]

    def of_batch(step: Step) -> Rows:
        arm = step.state.arm
        actuated = np.concatenate([arm.q, arm.opening], axis=1)
        return Rows(actuated, *map(np.asarray, (step.command, step.reward, step.state.goal.position)), arm.bodies)

    return jax.tree.map(lambda *parts: np.stack(parts, axis=1)[chosen][within], *map(of_batch, steps))


def _features(motors: Motors, rows: Rows, played: Episodes) -> dict[str, np.ndarray]:
    """Features of rows; a last step is done, and is a success or not."""
    done, success = np.zeros((2, len(rows.reward)), bool)
    ends = np.cumsum(played.steps) - 1
    done[ends], success[ends] = True, played.success
    read = {"observation.state": motors.read(rows.actuated), "action": motors.read(rows.command)}
    return read | {"next.reward": rows.reward, "next.done": done, "next.success": success}


def _view_samples(env: Env, first: Step, chosen: np.ndarray) -> np.ndarray:
    """Random numbers `[E, SAMPLES]` of the views of those that are `chosen [E]` of a batch of episodes."""
    return np.asarray(env.functions.view_samples(first.state.key))[chosen]


def _draw(
    env: Env,
    studio: Mapping[str, ObservationCamera],
    rows: Rows,
    samples: np.ndarray,
    lengths: np.ndarray,
    name: str,
) -> Iterator[np.ndarray]:
    """Pictures `[steps, size, size, 3]` uint8 of each episode, by the camera of that name."""
    robot, objects = env.setup.robot, env.setup.task.scene(env.setup).objects > 0
    views = make_views(samples, robot, objects=objects, pose=CAMERAS[name].load())
    for episode, (end, length) in enumerate(zip(np.cumsum(lengths), lengths, strict=True)):
        own = Views(*(np.repeat(part[episode : episode + 1], length, axis=0) for part in views))
        now: Rows = jax.tree.map(lambda x, here=slice(end - length, end): x[here], rows)
        pictures = develop(studio[name].pictures(now.actuated, now.goal, now.bodies, own), own)
        yield pictures if pictures.ndim > 3 else np.repeat(pictures[..., None], 3, axis=-1)
