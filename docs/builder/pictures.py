"""Pictures of the docs, made anew by the commands that they show: `make pictures NAMES='arms video push'`."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import jax
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from benchmarks.critic import train
from reachlab import load_robot
from reachlab.agents.acting import make_act
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import REPORT_STREAM, episode_keys
from reachlab.render.offscreen import portrait
from reachlab.robots.catalogue import ROBOTS
from reachlab.tasks.scenes.kinds import KINDS
from reachlab.watch.results import band, pooled, read_rows
from reachlab.watch.style import LINES, PALETTE, STYLE

IMAGES = Path(__file__).parents[1] / "images"

WIDTH, HEIGHT = 400, 320
"""Size of the picture of one arm [pixels]."""

FINER = 2
"""Pictures are drawn so many times as large, for smooth edges."""

COLUMNS = 3

SHOWN, OBSERVED, LARGER = 6002, (20, 15, 15, 15, 15), 2
"""Seed of the episode that a camera sees, steps between its pictures, and how many times as large they are shown."""

HALFWAY = 0.5
"""Share of the way to the goal that is left where a scene is shown."""

SEEDS = range(3)

SPACE = """
[space]
learning_rate = { low = 1e-5, high = 3e-2, log = true }
gamma = { low = 0.8, high = 0.999 }
initial_std = { low = 0.05, high = 5.0, log = true }
"""
"""Of the sweep in docs/scale.md."""


def _arms(_folder: Path) -> None:
    """All arms at home."""
    pictures = [portrait(load_robot(name), FINER * WIDTH, FINER * HEIGHT) for name in ROBOTS]
    rows = [np.hstack(pictures[first : first + COLUMNS]) for first in range(0, len(pictures), COLUMNS)]
    whole = Image.fromarray(np.vstack(rows))
    whole.resize((whole.width // FINER, whole.height // FINER)).save(IMAGES / "arms.png", optimize=True)


def _video(folder: Path) -> None:
    """Four held-out episodes of the first training."""
    _run(folder, "train --out first")
    _run(folder, f"video first --out {IMAGES / 'video.webp'}")


def _scenes(_folder: Path) -> None:
    """A scene of each kind with the way that the planner has found, at the middle of it."""
    pictures = []
    for kind in KINDS:
        env = Env(configure("clutter", robot="panda", scene=(kind,), randomise=()), 1)
        begun, act = env.init_held_out(episode_keys(SHOWN, REPORT_STREAM, 0, 1)), make_act(env, "planner")
        state, states, key = begun, [begun], jax.random.key(0)
        for _ in range(env.config.rules.max_steps):
            state, _, key = act(None, state, key)
            states.append(state)
        way = np.array([np.asarray(one.arm.tool_position)[0] for one in states])
        there = int(np.argmax(np.linalg.norm(way - way[-1], axis=1) < HALFWAY * np.linalg.norm(way[0] - way[-1])))
        pictures.append(env.render(states[there], path=way))
        env.close()
    whole = Image.fromarray(np.hstack(pictures))
    whole.resize((whole.width // FINER, whole.height // FINER)).save(IMAGES / "scenes.png", optimize=True)


def _push(folder: Path) -> None:
    """Three held-out cubes of the policy that comes with reachlab."""
    _run(folder, f"video panda/push --episodes 3 --out {IMAGES / 'push.webp'}")


def _lift(folder: Path) -> None:
    """Three held-out cubes that are lifted."""
    _run(folder, f"video panda/lift --episodes 3 --out {IMAGES / 'lift.webp'}")


def _objects(_folder: Path) -> None:
    """What a policy of pictures would see of a cube that is pushed by the script, in two simulators."""
    rows = []
    for sim in ("mujoco", "pybullet"):
        env = Env(configure("push", robot="panda", observation="image", sim=sim, randomise=()), 1)
        state, act, pictures = env.init(episode_keys(SHOWN, REPORT_STREAM, 0, 1)), make_act(env, "script"), []
        for _ in range(len(OBSERVED)):
            pictures.append(cast("np.ndarray", env.render_observation(state))[0])
            for _ in range(OBSERVED[len(pictures) - 1]):
                state, _, _ = act(None, state, jax.random.key(0))
        env.close()
        rows.append(np.hstack(pictures))
    whole = Image.fromarray(np.vstack(rows))
    size = LARGER * whole.width, LARGER * whole.height
    whole.resize(size, Image.Resampling.NEAREST).save(IMAGES / "camera-push.png", optimize=True)


def _plots(folder: Path) -> None:
    """Two rewards, three seeds each, 400,000 steps; nothing helps but the reward: an action is not held."""
    runs = []
    for reward in ("dense", "sparse"):
        for seed in SEEDS:
            runs.append(f"{reward}-{seed}")
            settings = f"--reward {reward} --observation target+tool --total-steps 400000 --no-stop-early"
            _run(folder, f"train {settings} --action-repeat 1 --seed {seed} --out {runs[-1]}")
            _run(folder, f"eval {runs[-1]}")
    _run(folder, f"plot {' '.join(runs)} --out {IMAGES / 'plots.png'}")


def _sweep(folder: Path) -> None:
    """From a bad start; ten minutes."""
    (folder / "space.toml").write_text(SPACE, encoding="utf-8")
    start = "--learning-rate 1e-2 --initial-std 4 --gamma 0.998 --total-steps 300000"
    _run(folder, f"sweep space.toml {start} --trials 50 --workers 2 --out sweep")
    shutil.copy(folder / "sweep" / "parallel.png", IMAGES / "sweep.png")


def _critic(folder: Path) -> None:
    """With and without a critic, by the tutorial's first two observations; five minutes."""
    runs: dict[tuple[str, bool], list[Any]] = {}
    for observation, critic, _, run in train(folder):
        runs.setdefault((observation, critic), []).append(read_rows(run))
    with mpl.rc_context(cast("Any", STYLE)):
        figure = Figure(figsize=(9.0, 3.0), layout="constrained")
        success, explained = figure.subplots(1, 2)
        for (observation, critic), curves in runs.items():
            colour, line = PALETTE[observation != "target"], LINES[not critic]
            shown = band([pooled(rows) for rows in curves], "steps", "success_rate", 1.0)
            name = f"{observation}, {'with' if critic else 'without'} a critic"
            success.plot(shown.x / 1e6, 100 * shown.mean, line, color=colour, label=name)
            if critic:
                shown = band(curves, "steps", "explained_variance", 1.0)
                explained.plot(shown.x / 1e6, 100 * shown.mean, line, color=colour, label=observation)
        for axes, title in ((success, "Success in training [%]"), (explained, "Variance that the critic explains [%]")):
            axes.set(title=title, xlabel="million steps")
            axes.set_ylim(-5, 103)
            axes.legend()
        figure.savefig(IMAGES / "critic.png", dpi=130)


def _run(folder: Path, words: str) -> None:
    subprocess.run([sys.executable, "-m", "reachlab", *words.split()], cwd=folder, check=True)  # noqa: S603


PICTURES: dict[str, Callable[[Path], None]] = {
    "arms": _arms,
    "scenes": _scenes,
    "video": _video,
    "push": _push,
    "critic": _critic,
    "lift": _lift,
    "objects": _objects,
    "plots": _plots,
    "sweep": _sweep,
}
"""What draws each, in a folder of its own."""


if __name__ == "__main__":
    for name in sys.argv[1:] or PICTURES:
        with tempfile.TemporaryDirectory() as place:
            PICTURES[name](Path(place))
