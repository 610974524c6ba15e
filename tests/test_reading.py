"""Files that a user names: none is a hang or a flood."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from reachlab.agents.sb3_policy import load_model
from reachlab.deploy.check import read_facts
from reachlab.deploy.onnx_network import OnnxNetwork
from reachlab.robots.loading import load_robot
from reachlab.runs.directory import read_config
from reachlab.scale.space import read_space
from reachlab.settings.config import RunConfig
from reachlab.settings.reading import cache_folder
from reachlab.settings.validation import InputError

READERS: dict[str, Callable[[Path], object]] = {
    "space.toml": lambda file: read_space(file, RunConfig()),
    "model.zip": load_model,
    "policy.onnx": OnnxNetwork,
    "policy.json": lambda file: read_facts(file.parent),
    "arm.urdf": lambda file: load_robot(str(file)),
    "config.json": read_config,
}
"""What reads a file of that name."""


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_what_is_no_plain_file_is_refused_at_once(name: str, kind: str, tmp_path: Path) -> None:
    file = tmp_path / name
    makers: dict[str, Callable[[], object]] = {
        "pipe": lambda: os.mkfifo(file),
        "device": lambda: file.symlink_to("/dev/zero"),
        "folder": file.mkdir,
    }
    makers[kind]()
    with pytest.raises(InputError, match=re.escape(str(file))):
        READERS[name](file)


def test_a_relative_cache_folder_counts_as_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    default = cache_folder()
    for given in ("", "here/cache"):
        monkeypatch.setenv("XDG_CACHE_HOME", given)
        assert cache_folder() == default
