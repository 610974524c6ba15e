"""The files of a LeRobot dataset, version 3.0, written part by part.

A part is some episodes: a file of their steps, one of their pictures for each camera, and last one that lists them. A
part that is listed is complete. `meta/info.json`, by which LeRobot knows a dataset, is the last file of all. The format
is that of LeRobot 0.6.1 (`lerobot/datasets/utils.py`, `dataset_writer.py`, `compute_stats.py`).
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from reachlab.runs.files import read_json, remove, sync, whole, write_json, write_whole
from reachlab.settings.validation import InputError
from reachlab.watch.video import encode_mp4

FILE, FILES = "chunk-{chunk_index:03d}/file-{file_index:03d}", 1000
"""Name of a file, and how many are in a folder."""

DATA, VIDEO, EPISODES = f"data/{FILE}.parquet", f"videos/{{video_key}}/{FILE}.mp4", f"meta/episodes/{FILE}.parquet"
"""Files of a part."""

INFO, STATS, TASKS, SETTINGS = "meta/info.json", "meta/stats.json", "meta/tasks.parquet", "meta/reachlab.json"
"""Files of the whole dataset; the last one holds what it is recorded with."""

SIZES = {"chunks_size": FILES, "data_files_size_in_mb": 100, "video_files_size_in_mb": 200}
"""Up to which LeRobot itself fills folders and files; our files are smaller."""

COUNTS = ("timestamp", "frame_index", "episode_index", "index", "task_index")
SCALARS = dict(zip(COUNTS, ("float32", *["int64"] * 4), strict=True))
SCALARS |= {"next.reward": "float32", "next.done": "bool", "next.success": "bool"}
"""Features that are one number, with their types."""

INDEX = {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object", "metadata": None}
PANDAS = json.dumps({"index_columns": ["task"], "column_indexes": [], "columns": [INDEX]})
"""What tells pandas that tasks are the index of their table."""

X264 = "-preset veryfast -crf 23 -g 2 -bf 0"
"""Every other picture is whole, as in LeRobot's own films: training reads single ones. 23 is x264's usual quality."""
CODED = {"video.codec": "h264", "video.pix_fmt": "yuv420p", "video.channels": 3, "is_depth_map": False}
"""How LeRobot describes that."""

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
LEVELS = np.arange(256) / 255
"""Of a colour, from 0 to 1."""

Stats = dict[str, np.ndarray]
"""`min`, `max`, `mean`, `std`, `QUANTILES` and `count` of a feature."""


class Layout(NamedTuple):
    """What a dataset holds.

    Attributes:
        motors: names of what is observed and commanded.
        beside: how many numbers are told of what is beside the arm.
        videos: names of features that are pictures.
        size: height and width of pictures [pixels].
        robot: name of the arm.
        task: what is asked of it, in words.
        fps: steps a second.
    """

    motors: tuple[str, ...]
    beside: int
    videos: tuple[str, ...]
    size: int
    robot: str
    task: str
    fps: float

    @property
    def features(self) -> dict[str, dict[str, Any]]:
        """Type, shape and names of each feature."""
        vector = {"dtype": "float32", "shape": [len(self.motors)], "names": list(self.motors)}
        beside = {"dtype": "float32", "shape": [self.beside], "names": None}
        info = {**CODED, "has_audio": False, "video.height": self.size, "video.width": self.size, "video.fps": self.fps}
        sides = {"shape": [self.size, self.size, 3], "names": ["height", "width", "channels"]}
        video = {"dtype": "video", **sides, "info": info}
        scalars = {name: {"dtype": kind, "shape": [1], "names": None} for name, kind in SCALARS.items()}
        vectors = {"observation.state": vector, "observation.environment_state": beside, "action": vector}
        return vectors | dict.fromkeys(self.videos, video) | scalars


class Part(NamedTuple):
    """Some episodes.

    Attributes:
        rows: features of all their steps, one after the other, but for those of `COUNTS`.
        lengths: steps of each episode `[E]`.
        pictures: of a feature, the pictures of each episode in turn, `[steps, size, size, 3]` uint8.
        numbers: of each episode `[E]` in its seed's stream.
    """

    rows: Mapping[str, np.ndarray]
    lengths: np.ndarray
    pictures: Callable[[str], Iterable[np.ndarray]]
    numbers: np.ndarray


class Written(NamedTuple):
    """Parts, episodes and steps that are written, and the number of the next episode to try in its seed's stream."""

    parts: int = 0
    episodes: int = 0
    steps: int = 0
    number: int = 0


def begin(folder: Path, settings: Mapping[str, Any]) -> Written:
    """How far a dataset of these settings is in a folder, which is made where nothing is there.

    Raises:
        InputError: something else is there, or a dataset that is finished or has other settings.
        OSError: the folder cannot be made.
    """
    settings = json.loads(json.dumps(settings))
    if not folder.exists():
        new = folder.with_name(f".{folder.name}.{secrets.token_hex(4)}.tmp")
        (new / SETTINGS).parent.mkdir(parents=True)
        write_json(new / SETTINGS, settings)
        new.rename(folder)
    if (folder / INFO).exists() and (folder / SETTINGS).is_file():
        raise InputError(f"'{folder}' is a dataset that is finished, and not extended: name another folder with --out.")
    if not (folder / SETTINGS).is_file():
        raise InputError(f"'{folder}' exists and is not overwritten: name another with --out.")
    if not (files := _files(folder, "meta/episodes")):  # nothing is lost with other settings
        write_json(folder / SETTINGS, settings)
    begun = read_json(folder / SETTINGS)
    for name in settings:
        if begun.get(name) != settings[name]:
            raise InputError(
                f"'{folder}' was begun with {name} {begun.get(name)!r} and cannot be resumed with {settings[name]!r}:"
                " leave the setting out, or name another folder with --out."
            )
    for left in folder.rglob(".*.tmp"):  # of a process that was killed
        remove(left)
    if not files:
        return Written()
    listed = _read(folder, "meta/episodes", ["dataset_to_index", "reachlab/number"])
    steps, number = (int(column[-1].as_py()) for column in listed.columns)
    return Written(len(files), len(listed), steps, number + 1)


def write_part(folder: Path, layout: Layout, before: Written, part: Part) -> Written:
    """How far a dataset is after a part is written to it.

    Raises:
        OSError: it cannot be written; what was there is as it was.
    """
    place = {"chunk_index": before.parts // FILES, "file_index": before.parts % FILES}
    rows, lengths, ends = part.rows, part.lengths, np.cumsum(part.lengths)
    starts, steps, episodes = ends - lengths, np.arange(ends[-1]), before.episodes + np.arange(len(ends))
    frame = steps - np.repeat(starts, lengths)
    counts = (frame / layout.fps, frame, np.repeat(episodes, lengths), before.steps + steps, np.zeros_like(steps))
    rows = {**rows, **dict(zip(COUNTS, counts, strict=True))}
    columns = {name: _column(rows[name], kind["dtype"]) for name, kind in layout.features.items() if name in rows}
    _write_table(folder / DATA.format(**place), pa.table(columns))
    stats = {name: [_stats(one) for one in np.split(values, starts[1:])] for name, values in rows.items()}
    listed = {"episode_index": episodes, "tasks": [[layout.task]] * len(ends), "length": lengths}
    listed |= {"dataset_from_index": before.steps + starts, "dataset_to_index": before.steps + ends}
    for key in layout.videos:
        stats[key] = _write_video(folder / VIDEO.format(video_key=key, **place), layout, part.pictures(key))
        listed |= {f"videos/{key}/from_timestamp": starts / layout.fps, f"videos/{key}/to_timestamp": ends / layout.fps}
    for what in ("data", "meta/episodes", *(f"videos/{key}" for key in layout.videos)):
        listed |= {f"{what}/{name}": [index] * len(ends) for name, index in place.items()}
    for name, own in stats.items():
        listed |= {f"stats/{name}/{kind}": [one[kind].tolist() for one in own] for kind in own[0]}
    _write_table(folder / EPISODES.format(**place), pa.table({**listed, "reachlab/number": part.numbers}))
    return Written(before.parts + 1, int(episodes[-1]) + 1, before.steps + int(ends[-1]), int(part.numbers[-1]) + 1)


def finish(folder: Path, layout: Layout, written: Written) -> None:
    """Write what describes all of a dataset.

    Raises:
        OSError: it cannot be written.
    """
    listed, stats = _read(folder, "meta/episodes"), {}
    for name in layout.features:
        own = _together(listed, name) if name in layout.videos else _stats(_values(folder, name))
        stats[name] = {kind: value.tolist() for kind, value in own.items()}
    write_json(folder / STATS, stats)
    tasks = pa.table({"task_index": [0], "task": [layout.task]}).replace_schema_metadata({"pandas": PANDAS})
    _write_table(folder / TASKS, tasks)
    totals = {"total_episodes": written.episodes, "total_frames": written.steps, "total_tasks": 1}
    info = {"codebase_version": "v3.0", "robot_type": layout.robot, "fps": layout.fps, **totals, **SIZES}
    info |= {"splits": {"train": f"0:{written.episodes}"}, "data_path": DATA, "features": layout.features}
    write_json(folder / INFO, info | {"video_path": VIDEO if layout.videos else None})


# --- files ----------------------------------------------------------------------------------------


def _files(folder: Path, what: str) -> list[Path]:
    return sorted(folder.glob(f"{what}/*/*.parquet"))


def _read(folder: Path, what: str, columns: list[str] | None = None) -> pa.Table:
    """Columns of all files of that kind."""
    return pa.concat_tables([pq.read_table(file, columns=columns) for file in _files(folder, what)])


def _values(folder: Path, name: str) -> np.ndarray:
    """A feature of all steps `[steps, k]` or `[steps]`."""
    return np.stack(_read(folder, "data", [name])[name].to_numpy())


def _column(values: np.ndarray, kind: str) -> pa.Array:
    flat = pa.array(np.ravel(values).astype(kind))
    return flat if values.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _write_table(path: Path, table: pa.Table) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, sink := pa.BufferOutputStream())
    write_whole(path, sink.getvalue().to_pybytes())


def _write_video(path: Path, layout: Layout, episodes: Iterable[np.ndarray]) -> list[Stats]:
    """Statistics of the pictures of each episode, which are written to a file, complete or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    stats = list[Stats]()

    def passing() -> Iterator[bytes]:
        for pictures in episodes:
            stats.append(_picture_stats(pictures))
            yield pictures.tobytes()

    with whole(path) as temporary:
        encode_mp4(temporary, passing(), (layout.size, layout.size), layout.fps, X264)
        sync(temporary)
    sync(path.parent)
    return stats


# --- statistics -----------------------------------------------------------------------------------


def _stats(values: np.ndarray) -> Stats:
    """Statistics of steps `[steps, k]` or `[steps]`."""
    values = values.reshape(len(values), -1).astype(np.float64)
    found = {kind: getattr(values, kind)(axis=0) for kind in ("min", "max", "mean", "std")}
    quantiles = np.quantile(values, list(QUANTILES.values()), axis=0)
    return found | dict(zip(QUANTILES, quantiles, strict=True)) | {"count": np.array([len(values)])}


def _picture_stats(pictures: np.ndarray) -> Stats:
    """Statistics of pictures `[steps, size, size, 3]` uint8: of each colour, from 0 to 1, `[3, 1, 1]`."""
    counts = np.array(Image.fromarray(pictures.reshape(-1, *pictures.shape[2:])).histogram()).reshape(3, -1)
    pixels = pictures.size // 3
    reached, mean = np.cumsum(counts, axis=1), counts @ LEVELS / pixels
    ranks = {"min": 0, "max": pixels - 1} | {kind: share * pixels for kind, share in QUANTILES.items()}
    found = {kind: LEVELS[(reached > rank).argmax(axis=1)] for kind, rank in ranks.items()}
    found |= {"mean": mean, "std": np.sqrt(np.maximum(counts @ LEVELS**2 / pixels - mean**2, 0.0))}
    return {kind: value.reshape(3, 1, 1) for kind, value in found.items()} | {"count": np.array([len(pictures)])}


def _together(listed: pa.Table, key: str) -> Stats:
    """Statistics of the pictures of all episodes, of those of each; quantiles are their means, as LeRobot's are."""
    kinds = ("count", "min", "max", "mean", "std", *QUANTILES)
    one = {kind: np.array(listed[f"stats/{key}/{kind}"].to_pylist()) for kind in kinds}
    share = (one["count"] / one["count"].sum())[..., None, None]
    found = {kind: (share * one[kind]).sum(axis=0) for kind in ("mean", *QUANTILES)}
    spread = one["std"] ** 2 + (one["mean"] - found["mean"]) ** 2
    found |= {"min": one["min"].min(axis=0), "max": one["max"].max(axis=0), "count": one["count"].sum(axis=0)}
    return found | {"std": np.sqrt((share * spread).sum(axis=0))}
