"""Videos of held-out episodes: animated WebP and GIF, and MP4 with the extra `video`."""

from __future__ import annotations

import contextlib
import itertools
import math
import subprocess
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from PIL import Image

from reachlab.agents import AGENTS
from reachlab.agents.acting import Function, name_of
from reachlab.agents.policy import Policy
from reachlab.envs.core import Env
from reachlab.runs.files import check_place, written
from reachlab.settings.arguments import typed
from reachlab.settings.validation import LAST_SEED, InputError, choose, needing, whole_number
from reachlab.watch.captions import Caption, captioned, inset
from reachlab.watch.player import Player, played

BEGIN_PAUSE, END_PAUSE = 0.8, 2.0
"""Times for which an episode's first and last picture stand [s]."""

MOST_EPISODES = 10_000
"""Episodes that a film may show."""

LONGEST_PICTURE = 60.0
"""Time for which a picture may stand [s]; the formats hold no more than some hours."""

SPEEDS, LONG_ENOUGH = (1.0, 0.5, 0.25, 0.1), 2.0
"""Speeds of which a film takes the fastest at which its longest episode moves for so long [s], or the slowest."""

WEBP_QUALITY = 82
"""Of 100: the lowest at which the workspace's thin edges stay clean."""

SHORTEST = {".webp": 0.02, ".gif": 0.02, ".mp4": 0.0}
"""Time for which a picture stands at least [s], by ending: browsers show one of 10 ms or less for 100 ms."""

MP4_QUALITY = 20
"""Constant rate factor of x264: 18 is visually lossless, 23 its default."""


@dataclass(frozen=True)
class Frame:
    """A picture and the time for which it is shown [s]."""

    image: Image.Image
    seconds: float


@dataclass(frozen=True)
class Clip:
    """A video that was written: its length [s], what it shows, and its size [bytes]."""

    out: str
    episodes: int
    successes: int
    frames: int
    seconds: float
    bytes: int


@typed
def write_video(
    env: Env,
    agent: str | Function,
    policy: Policy | None,
    out: str | Path,
    *,
    seed: int = 1,
    episodes: int = 4,
    fps: float = 30.0,
    speed: float = 0.0,
    watch: Callable[[int], None] = lambda _: None,
) -> Clip:
    """Film the first episodes of a seed's evaluation, one after the other; the clip says what was written.

    Args:
        env: the environment (`num_envs` 1).
        agent: name in `AGENTS`, or a function that gives actions `[1, a]` for observations.
        policy: the trained policy, for agent `trained`.
        out: file to write; its ending is one of `ENCODERS`.
        seed: seed of the targets.
        episodes: how many.
        fps: pictures a second, about: each shows a whole number of control steps; at most 50 in .webp and .gif.
        speed: 1 is real time, 0.5 half as fast; 0 chooses among `SPEEDS`.
        watch: called after every episode with how many have been filmed.

    Raises:
        InputError: an ending that is none of them, a file that cannot be written, or no OpenGL to draw with; no
            environment of reachlab, or a number that makes no sense.
    """
    _check_numbers(seed, episodes, fps, speed)
    out = Path(out)
    check_place("the video", out, ENCODERS)
    encode = ENCODERS[out.suffix.lower()]
    name = name_of(agent) if callable(agent) else choose("agent", agent, AGENTS)
    period, player = env.config.physics.control_period, Player(env, seed)
    speed = speed or _slow_enough(player, agent, policy, period, episodes)
    stride = max(1, round(speed / (fps * period)), math.ceil(SHORTEST[out.suffix.lower()] * speed / period - 1e-9))
    interval = stride * period / speed
    if interval > LONGEST_PICTURE:
        raise InputError(
            f"a picture would stand for {interval:.3g} s, and at most {LONGEST_PICTURE:g} are written: choose a higher"
            " --fps or --speed."
        )
    tally: Counter[str] = Counter()

    def film() -> Iterator[Frame]:
        for number in range(episodes):
            player.begin(number)
            for _ in played(player, agent, policy, stride):
                seconds = END_PAUSE if player.over else interval + BEGIN_PAUSE * (player.clock == 0)
                tally.update(frames=1, milliseconds=round(1000 * seconds))
                caption = _caption(env, name, player, f"Episode {number + 1} of {episodes}", speed)
                yield Frame(captioned(_picture(env, player), caption), seconds)
            tally.update(successes=player.success)
            watch(number + 1)

    with written("the video", out) as part:
        encode(part, film(), 1 / interval)
    seconds = tally["milliseconds"] / 1000
    return Clip(str(out), episodes, tally["successes"], tally["frames"], seconds, out.stat().st_size)


def _check_numbers(seed: int, episodes: int, fps: float, speed: float) -> None:
    whole_number("seed", seed, 0, LAST_SEED)
    whole_number("episodes", episodes, 1, MOST_EPISODES)
    for name, value in (("fps", fps), ("speed", speed or 1.0)):
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
            raise InputError(f"{name} must be a number above 0, got {value!r}.")


def _slow_enough(player: Player, agent: str | Function, policy: Policy | None, period: float, episodes: int) -> float:
    """The speed at which a person can follow the longest of the episodes, without waiting for it."""
    longest = 0
    for number in range(episodes):
        player.begin(number)
        for _ in played(player, agent, policy, 1):
            pass
        longest = max(longest, player.clock)
    return next((speed for speed in SPEEDS if longest * period / speed >= LONG_ENOUGH), SPEEDS[-1])


def _picture(env: Env, player: Player) -> np.ndarray:
    """Picture of the arm now, and in a corner the one that the policy observes, if it observes one."""
    moment, observation = player.moment, player.observed_picture()
    picture = env.render(player.state, path=moment.path, trail=moment.trail)
    return picture if observation is None else inset(picture, observation)


def _caption(env: Env, agent: str, player: Player, title: str, speed: float) -> Caption:
    config = env.config
    parts = [f"{config.task} task", env.setup.robot.name, config.sim, agent]
    return Caption(
        title=title,
        detail=" · ".join(parts if speed == 1 else [*parts, f"{speed:g}× speed"]),
        distance=player.moment.distance,
        time=player.clock * config.physics.control_period,
        verdict=("success" if player.success else "failed") if player.over else "",
        angle=player.moment.angle,
        error=player.moment.error,
    )


# --- files ----------------------------------------------------------------------------------------


def _webp(out: Path, frames: Iterator[Frame], _rate: float) -> None:
    """Animated WebP, which browsers show like a GIF; the smallest."""
    _animate(out, frames, 1, quality=WEBP_QUALITY, method=4)


def _gif(out: Path, frames: Iterator[Frame], _rate: float) -> None:
    """Animated GIF, which everything shows; 256 colours a picture."""
    _animate(out, (Frame(one.image.quantize(dither=Image.Dither.NONE), one.seconds) for one in frames), 10)


def _animate(out: Path, frames: Iterator[Frame], tick: int, **settings: Any) -> None:
    """Write images that change at whole ticks [ms], the times rounded so that no error adds up."""
    images, seconds = zip(*((frame.image, frame.seconds) for frame in frames), strict=True)
    ends = np.rint(1000 // tick * np.cumsum([0.0, *seconds])).astype(int)
    durations = (tick * np.diff(ends)).tolist()
    images[0].save(out, save_all=True, append_images=images[1:], duration=durations, loop=0, **settings)


def _mp4(out: Path, frames: Iterator[Frame], rate: float) -> None:
    """H.264 in MP4, by the ffmpeg that imageio-ffmpeg brings; frames are handed over one by one."""
    first = next(frames)
    shown = (frame.image.tobytes() * max(1, round(frame.seconds * rate)) for frame in itertools.chain([first], frames))
    encode_mp4(out, shown, first.image.size, rate, f"-crf {MP4_QUALITY} -movflags +faststart")


def encode_mp4(out: Path, pictures: Iterable[bytes], size: tuple[int, int], rate: float, settings: str) -> None:
    """Write pictures of `size` (width and height), red, green and blue bytes in rows, as H.264.

    Args:
        out: file to write.
        pictures: one or several pictures at a time.
        size: width and height [pixels].
        rate: pictures a second.
        settings: further settings of x264 and of the file, as ffmpeg takes them.

    Raises:
        InputError: there is no ffmpeg.
        OSError: the file cannot be written.
    """
    source = f"-f rawvideo -pix_fmt rgb24 -s {size[0]}x{size[1]} -r {rate} -i -".split()
    codec = f"-c:v libx264 -pix_fmt yuv420p {settings} -f mp4".split()
    command = [_ffmpeg(), "-loglevel", "error", "-y", *source, *codec, f"file:{out}"]
    # A bare pipe: imageio-ffmpeg's own writer forks, which can hang beside JAX's threads.
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:  # noqa: S603
        pipe = cast("IO[bytes]", process.stdin)
        with contextlib.suppress(BrokenPipeError):
            for picture in pictures:
                pipe.write(picture)
        _, said = process.communicate()
    if process.returncode:
        first = said.decode(errors="replace").strip().partition("\n")[0]
        raise OSError(first.rpartition("] ")[2] or f"ffmpeg was ended with {process.returncode}")


def _ffmpeg() -> str:
    with needing("MP4 needs ffmpeg: {}, or name a file that ends in .webp or .gif.", "video", ImportError):
        from imageio_ffmpeg import get_ffmpeg_exe
    return get_ffmpeg_exe()


ENCODERS: dict[str, Callable[[Path, Iterator[Frame], float], None]] = {".webp": _webp, ".gif": _gif, ".mp4": _mp4}
"""Writers of video files by ending: from a file, frames and their number in a second."""
