"""Datasets of `reachlab record` as LeRobot itself reads them; needs Python 3.12 with lerobot."""

# pyright: reportMissingImports=false
from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset

EPISODES, SIZE, FPS = 5, 64, 50
STATE = {"so101": 6, "panda": 7, "iiwa14": 7}
"""Numbers in the state of each arm."""

TWO = ["front", "observation"]


@pytest.fixture(scope="module", params=[[], TWO], ids=["state", "pictures"])
def cameras(request: pytest.FixtureRequest) -> list[str]:
    return request.param


@pytest.fixture(scope="module", params=STATE)
def robot(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def dataset(robot: str, cameras: list[str], tmp_path_factory: pytest.TempPathFactory) -> LeRobotDataset:
    out = tmp_path_factory.mktemp(robot) / "dataset"
    words = ["--task", "precise", "--agent", "script", "--robot", robot, "--size", str(SIZE), "--cameras", *cameras]
    command = [sys.executable, "-m", "reachlab", "record", *words, "--episodes", str(EPISODES), "--out", str(out)]
    subprocess.run(command, check=True, capture_output=True)
    return LeRobotDataset("reachlab/recorded", root=out)


@pytest.fixture(scope="module")
def items(dataset: LeRobotDataset) -> list[dict[str, Any]]:
    return [dataset[index] for index in range(len(dataset))]


def test_lerobot_reads_every_step(
    dataset: LeRobotDataset, items: list[dict[str, Any]], robot: str, cameras: list[str]
) -> None:
    assert (dataset.num_episodes, dataset.fps, dataset.meta.robot_type) == (EPISODES, FPS, robot)
    assert len(items) == dataset.num_frames == sum(dataset.meta.episodes["length"])
    assert [int(item["index"]) for item in items] == list(range(len(items)))
    assert {item["task"] for item in items} == {"hold a point in the arm's box"}
    for item in items:
        assert item["observation.state"].shape == item["action"].shape == (STATE[robot],)
        for name in cameras:
            picture = item[f"observation.images.{name}"]
            assert picture.shape == (3, SIZE, SIZE)
            assert 0 <= picture.min() < picture.max() <= 1


def test_statistics_are_those_of_what_lerobot_reads(dataset: LeRobotDataset, items: list[dict[str, Any]]) -> None:
    for name, feature in dataset.meta.features.items():
        values = np.stack([np.atleast_1d(np.asarray(item[name])) for item in items]).astype(np.float64)
        known, film = dataset.meta.stats[name], feature["dtype"] == "video"
        axis = (0, 2, 3) if film else 0
        near: dict[str, Any] = {"abs": 0.02} if film else {"rel": 1e-5, "abs": 1e-6}  # a film is compressed
        for kind in ("mean", "std") if film else ("mean", "std", "min", "max"):
            assert np.ravel(known[kind]) == pytest.approx(getattr(values, kind)(axis=axis), **near), (name, kind)
        for share in () if film else (1, 10, 50, 90, 99):
            expected = np.quantile(values, share / 100, axis=0)
            assert known[f"q{share:02d}"] == pytest.approx(expected, rel=1e-5, abs=1e-6), (name, share)
        assert known["count"].tolist() == [len(items)]


def test_pictures_are_those_of_their_step(dataset: LeRobotDataset, items: list[dict[str, Any]]) -> None:
    """At the last steps the arm is at rest, at the first ones it moves; a film that is out of step shows another."""
    if not dataset.meta.video_keys:
        pytest.skip("has no pictures")
    key = dataset.meta.video_keys[0]
    for episode in dataset.meta.episodes:
        first, last = episode["dataset_from_index"], episode["dataset_to_index"] - 1
        apart, still = ((items[first + a][key] - items[first + b][key]).abs().mean() for a, b in ((0, 40), (80, 90)))
        assert still < apart
        begun = (items[first][key] - items[last][key]).abs().mean()
        assert begun > still


def test_lerobot_loads_batches_with_the_past_and_the_future(dataset: LeRobotDataset) -> None:
    ahead = {"action": [step / FPS for step in range(8)], "observation.state": [-1 / FPS, 0.0]}
    loaded = LeRobotDataset("reachlab/recorded", root=dataset.root, delta_timestamps=ahead)
    batch = next(iter(torch.utils.data.DataLoader(loaded, batch_size=4, shuffle=True)))
    assert batch["action"].shape[:2] == (4, 8)
    assert batch["observation.state"].shape[:2] == (4, 2)
