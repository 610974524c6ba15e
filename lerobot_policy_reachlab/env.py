"""Environment for a repository on LeRobot's hub, which holds this file, with a task and cameras of your choice."""

from __future__ import annotations

from typing import Any

from reachlab.lerobot import make_env as make


def make_env(n_envs: int = 1, use_async_envs: bool = False, cfg: Any = None) -> Any:
    """The batch of environments that LeRobot asks a repository for."""
    return make(n_envs, use_async_envs, cfg, task="precise", robot="so101", cameras=["front"])
