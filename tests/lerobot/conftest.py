"""Shared by the tests in LeRobot's environment, which `make lerobot` runs; nothing is downloaded."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

os.environ["HF_HUB_OFFLINE"] = "1"

import reachlab

RUN = "so101/precise"
"""Policy that comes with reachlab, of the arm that LeRobot knows."""


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that `reachlab export` wrote."""
    folder = tmp_path_factory.mktemp("exported") / "policy"
    reachlab.export(RUN, folder)
    return folder
