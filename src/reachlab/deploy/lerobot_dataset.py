"""The files of a LeRobot dataset, version 3.0, written part by part.

A part is some episodes: a file of their rows, one of their pictures for each camera, and last one that lists them. A
part that is listed is complete. `meta/info.json`, by which LeRobot knows a dataset, is the last file of all. The format
is that of LeRobot 0.6.1 (`lerobot/datasets/utils.py`, `dataset_writer.py`, `compute_stats.py`).
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from reachlab.runs.files import read_json, remove, sync, write_json, write_whole
from reachlab.settings.validation import InputError
from reachlab.watch.video import encode_mp4

FILE, FILES = "chunk-{chunk_index:03d}/file-{file_index:03d}", 1000
"""Names of files, and how many are in a folder."""

DATA, VIDEO, EPISODES = f"data/{FILE}.parquet", f"videos/{{video_key}}/{FILE}.mp4", f"meta/episodes/{FILE}.parquet"
"""Names of a part's files."""

INFO, STATS, TASKS, SETTINGS = "meta/info.json", "meta/stats.json", "meta/tasks.parquet", "meta/reachlab.json"
"""Files of the whole dataset; the last one holds what it was recorded with."""

DATA_MB, VIDEO_MB = 100, 200
"""Sizes up to which LeRobot itself fills files [MB]; ours are smaller."""

X264 = "-preset veryfast -crf 23 -g 2 -bf 0"
"""Every other picture is whole, as in LeRobot's own videos: training reads single pictures. 23 is x264's default."""

QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
LEVELS = np.arange(256) / 255
"""Of a colour, from 0 to 1."""

Stats = dict[str, np.ndarray]
"""`min`, `max`, `mean`, `std`, quantiles `q01` to `q99` and `count` of a feature."""


@dataclass(frozen=True)
class Layout:
    """What a dataset holds.

    Attributes:
        robot: name of the arm.
        task: what is asked of it, in words.
        fps: steps a second.
        motors: names of what is observed and commanded.
        cameras: names of those that have pictures.
        size: height and width of pictures [pixels].
    """

    robot: str
    task: str
    fps: float
    motors: tuple[str, ...]
    cameras: tuple[str, ...]
    size: int

    @property
    def videos(self) -> dict[str, str]:
        """Features that are pictures, by camera."""
        return {name: f"observation.images.{name}" for name in self.cameras}

    @property
    def features(self) -> dict[str, dict[str, Any]]:
        """Type, shape and names of each feature."""
        vector = {"dtype": "float32", "shape": [len(self.motors)], "names": list(self.motors)}
        video = {"dtype": "video", "shape": [self.size, self.size, 3], "names": ["height", "width", "channels"]}
        stored = {"video.codec": "h264", "video.pix_fmt": "yuv420p", "video.fps": self.fps, "video.channels": 3}
        shape = {"video.height": self.size, "video.width": self.size, "has_audio": False, "is_depth_map": False}
        kinds = {
            "timestamp": "float32",
            **dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64"),
        }
        kinds |= {"next.reward": "float32", "next.done": "bool", "next.success": "bool"}
        return {
            "observation.state": vector,
            "action": vector,
            **{key: video | {"info": stored | shape} for key in self.videos.values()},
            **{name: {"dtype": kind, "shape": [1], "names": None} for name, kind in kinds.items()},
        }


@dataclass(frozen=True)
class Part:
    """Some episodes.

    Attributes:
        rows: features of all their steps, one after the other, but for those that only count.
        steps: length of each episode `[E]`.
        numbers: of each episode `[E]`, in the seed's stream.
        pictures: of a camera, the pictures of each episode in turn, `[steps, size, size, 3]` uint8.
    """

    rows: Mapping[str, np.ndarray]
    steps: np.ndarray
    numbers: np.ndarray
    pictures: Callable[[str], Iterator[np.ndarray]]


@dataclass(frozen=True)
class Written:
    """How far a dataset is: parts, episodes and rows that are written, and the number of the next episode to try."""

    parts: int = 0
    episodes: int = 0
    rows: int = 0
    number: int = 0


def begin(folder: Path, settings: Mapping[str, Any]) -> Written:
    """How far a dataset of these settings is in a folder, which is made where nothing is there.

    Raises:
        InputError: something else is there, or a dataset that is finished or has other settings.
        OSError: the folder cannot be made.
    """
    settings = json.loads(json.dumps(settings))
    if not folder.exists():
        temporary = folder.with_name(f".{folder.name}.{secrets.token_hex(4)}.tmp")
        (temporary / SETTINGS).parent.mkdir(parents=True)
        write_json(temporary / SETTINGS, settings)
        temporary.rename(folder)
        return Written()
    if not (folder / SETTINGS).is_file() or (folder / INFO).exists():
        raise InputError(f"'{folder}' exists and is not overwritten: name another with --out.")
    begun = read_json(folder / SETTINGS)
    for name in settings:
        if begun.get(name) != settings[name]:
            raise InputError(
                f"'{folder}' was begun with {name} {begun.get(name)!r} and cannot be resumed with {settings[name]!r}:"
                " leave the setting out, or name another folder with --out."
            )
    for left in folder.rglob(".*.tmp"):  # of a process that was killed
        remove(left)
    listed = _read(folder, "meta/episodes", ["dataset_to_index", "reachlab/number"])
    if not len(listed):
        return Written()
    last = listed.slice(len(listed) - 1).to_pylist()[0]
    parts = len(list(folder.glob("meta/episodes/*/*.parquet")))
    return Written(parts, len(listed), last["dataset_to_index"], last["reachlab/number"] + 1)


def write_part(folder: Path, layout: Layout, before: Written, part: Part) -> Written:
    """How far a dataset is after a part is written to it.

    Raises:
        OSError: it cannot be written; what was there is as it was.
    """
    place = dict(zip(("chunk_index", "file_index"), divmod(before.parts, FILES), strict=True))
    ends = np.cumsum(part.steps)
    frames, episodes = np.arange(ends[-1]), before.episodes + np.arange(len(ends))
    frame = frames - np.repeat(ends - part.steps, part.steps)
    counted = {"timestamp": frame / layout.fps, "frame_index": frame, "index": before.rows + frames}
    counted |= {"episode_index": np.repeat(episodes, part.steps), "task_index": np.zeros_like(frames)}
    rows = {name: (dict(part.rows) | counted)[name] for name in layout.features if name not in layout.videos.values()}
    table = pa.table({name: _column(rows[name], layout.features[name]["dtype"]) for name in rows})
    _write_table(folder / DATA.format(**place), table)
    stats = {name: [_stats(one) for one in np.split(values, ends[:-1])] for name, values in rows.items()}
    listed: dict[str, Any] = {
        "episode_index": episodes,
        "tasks": [[layout.task]] * len(ends),
        "length": part.steps,
        "dataset_from_index": before.rows + ends - part.steps,
        "dataset_to_index": before.rows + ends,
        "reachlab/number": part.numbers,
        **_placed("data", place, len(ends)),
        **_placed("meta/episodes", place, len(ends)),
    }
    for camera, key in layout.videos.items():
        stats[key] = _write_video(folder / VIDEO.format(video_key=key, **place), layout, part.pictures(camera))
        listed |= _placed(f"videos/{key}", place, len(ends))
        listed |= {f"videos/{key}/from_timestamp": (ends - part.steps) / layout.fps}
        listed |= {f"videos/{key}/to_timestamp": ends / layout.fps}
    for name, of_episodes in stats.items():
        for kind in of_episodes[0]:
            listed[f"stats/{name}/{kind}"] = [one[kind].tolist() for one in of_episodes]
    _write_table(folder / EPISODES.format(**place), pa.table(listed))
    return Written(before.parts + 1, int(episodes[-1]) + 1, before.rows + int(ends[-1]), int(part.numbers[-1]) + 1)


def finish(folder: Path, layout: Layout, written: Written) -> None:
    """Write what describes all of a dataset.

    Raises:
        OSError: it cannot be written.
    """
    listed = _read(folder, "meta/episodes")
    stats = {
        name: _together(listed, f"stats/{name}/") if name in layout.videos.values() else _stats(_values(folder, name))
        for name in layout.features
    }
    write_json(folder / STATS, {name: {kind: x.tolist() for kind, x in of.items()} for name, of in stats.items()})
    # The table's index, as pandas keeps it.
    tasks = pa.table({"task_index": pa.array([0], pa.int64()), "task": [layout.task]})
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": stored, "metadata": None}
        for name, kind, stored in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    index = {"index_columns": ["task"], "column_indexes": [], "columns": columns}
    _write_table(folder / TASKS, tasks.replace_schema_metadata({"pandas": json.dumps(index)}))
    info = {
        "codebase_version": "v3.0",
        "robot_type": layout.robot,
        "total_episodes": written.episodes,
        "total_frames": written.rows,
        "total_tasks": 1,
        "chunks_size": FILES,
        "data_files_size_in_mb": DATA_MB,
        "video_files_size_in_mb": VIDEO_MB,
        "fps": layout.fps,
        "splits": {"train": f"0:{written.episodes}"},
        "data_path": DATA,
        "video_path": VIDEO if layout.cameras else None,
        "features": layout.features,
    }
    write_json(folder / INFO, info)


def _placed(what: str, place: Mapping[str, int], count: int) -> dict[str, list[int]]:
    """Columns that say in which file something of so many episodes is."""
    return {f"{what}/{name}": [number] * count for name, number in place.items()}


def _column(values: np.ndarray, kind: str) -> pa.Array:
    values = np.ascontiguousarray(values, kind)
    flat = pa.array(values.reshape(-1))
    return flat if values.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _write_table(path: Path, table: pa.Table) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink)
    write_whole(path, sink.getvalue().to_pybytes())


def _read(folder: Path, what: str, columns: list[str] | None = None) -> pa.Table:
    """Columns of all files of that kind."""
    files = sorted(folder.glob(f"{what}/*/*.parquet"))
    return pa.concat_tables([pq.read_table(file, columns=columns) for file in files]) if files else pa.table({})


def _values(folder: Path, name: str) -> np.ndarray:
    """A feature of all steps `[steps, k]`."""
    column = _read(folder, "data", [name])[name].combine_chunks()
    flat = column.flatten() if pa.types.is_fixed_size_list(column.type) else column
    return flat.to_numpy(zero_copy_only=False).reshape(len(column), -1)


def _write_video(path: Path, layout: Layout, episodes: Iterator[np.ndarray]) -> list[Stats]:
    """Statistics of each episode's pictures, which are written to a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary, stats = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp"), []

    def passed() -> Iterator[bytes]:
        for pictures in episodes:
            stats.append(_picture_stats(pictures))
            yield pictures.tobytes()

    encode_mp4(temporary, passed(), (layout.size, layout.size), layout.fps, X264)
    sync(temporary)
    temporary.replace(path)
    sync(path.parent)
    return stats


def _stats(values: np.ndarray) -> Stats:
    """Statistics of steps `[steps, k]` or `[steps]`."""
    values = np.asarray(values, np.float64).reshape(len(values), -1)
    found = {name: getattr(values, name)(axis=0) for name in ("min", "max", "mean", "std")}
    quantiles = dict(zip(map(_name, QUANTILES), np.quantile(values, QUANTILES, axis=0), strict=True))
    return found | quantiles | {"count": np.array([len(values)])}


def _picture_stats(pictures: np.ndarray) -> Stats:
    """Statistics of pictures `[steps, size, size, 3]` uint8: of each colour, from 0 to 1, `[3, 1, 1]`."""
    counts = np.array(Image.fromarray(pictures.reshape(-1, *pictures.shape[2:])).histogram()).reshape(3, -1)
    reached = np.cumsum(counts, axis=1) / counts.sum(axis=1, keepdims=True)
    mean, square = counts @ LEVELS / counts.sum(axis=1), counts @ LEVELS**2 / counts.sum(axis=1)
    found = {
        "min": LEVELS[(counts > 0).argmax(axis=1)],
        "max": LEVELS[::-1][(counts[:, ::-1] > 0).argmax(axis=1)],
        "mean": mean,
        "std": np.sqrt(np.maximum(square - mean**2, 0.0)),
        **{_name(share): LEVELS[(reached >= share).argmax(axis=1)] for share in QUANTILES},
    }
    return {name: value.reshape(3, 1, 1) for name, value in found.items()} | {"count": np.array([len(pictures)])}


def _name(share: float) -> str:
    return f"q{round(100 * share):02d}"


def _together(listed: pa.Table, prefix: str) -> Stats:
    """Statistics of the pictures of all episodes, of those of each; quantiles are means of theirs, as LeRobot's are."""
    kinds = [name.removeprefix(prefix) for name in listed.column_names if name.startswith(prefix)]
    one = {kind: np.array(listed[prefix + kind].to_pylist(), np.float64) for kind in kinds}
    counts = one.pop("count")
    weights = (counts / counts.sum()).reshape(-1, *[1] * (one["mean"].ndim - 1))
    found = {kind: (weights * values).sum(axis=0) for kind, values in one.items()}
    square = (weights * (one["std"] ** 2 + (one["mean"] - found["mean"]) ** 2)).sum(axis=0)
    found |= {"min": one["min"].min(axis=0), "max": one["max"].max(axis=0), "std": np.sqrt(square)}
    return found | {"count": counts.sum(axis=0).astype(int)}
