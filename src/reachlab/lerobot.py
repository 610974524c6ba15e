"""Environments for Hugging Face LeRobot: `make_env` is what the `env.py` of a repository on its hub gives.

`LeRobotPolicy` is the other way round: a policy that LeRobot has trained, for `reachlab.evaluate`.

Actions are positions of an arm's motors, in LeRobot's units, and observations the same with pictures: the form of the
datasets that `reachlab record` writes.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from reachlab.deploy.check import read_facts
from reachlab.deploy.lerobot_env import LeRobotVectorEnv
from reachlab.deploy.lerobot_policy import LeRobotPolicy
from reachlab.envs.earlier_configs import from_json
from reachlab.envs.setup import configure_env, in_evaluation
from reachlab.settings.config import PICTURE_SIDES
from reachlab.settings.json_form import override
from reachlab.settings.validation import InputError, whole_number
from reachlab.tasks import TASKS

__all__ = ["LeRobotPolicy", "make_env"]


def make_env(
    n_envs: int = 1,
    use_async_envs: bool = False,
    cfg: Any = None,
    *,
    task: str = "tutorial",
    cameras: Sequence[str] = (),
    size: int = 96,
    **settings: Any,
) -> LeRobotVectorEnv:
    """A batch of environments, which is one compiled program, whether or not `use_async_envs` is asked for.

    Args:
        n_envs: environments in the batch.
        use_async_envs: of LeRobot's interface, without effect.
        cfg: LeRobot's `EnvConfig`, whose `task`, if it has one, is taken in place of the other.
        task: a task preset, or a folder that `reachlab export` wrote: the environment in which its policy is evaluated.
        cameras: names of cameras, as `reachlab record` has them.
        size: height and width of their pictures [pixels].
        settings: any field of the configuration.

    Raises:
        InputError: a task, folder, camera or setting that does not exist, or a value that is not allowed.
    """
    del use_async_envs
    if settings.get("shaping"):
        raise InputError("an exported controller shapes its commands itself: leave shaping out.")
    whole_number("size", size, *PICTURE_SIDES)
    if settings.get("randomise", ()) is None:
        settings.pop("randomise")
    varied = tuple(settings.get("randomise", ()))
    if cameras and "view" in varied:  # what its pictures show, whatever a policy observes
        settings["randomise"] = tuple(one for one in varied if one != "view")
    name = getattr(cfg, "task", None) or task
    if not isinstance(name, str | os.PathLike):
        raise InputError(f"task must be the name of a task or a folder of an export, got {name!r}.")
    name = os.fspath(name)
    if name not in TASKS and Path(name).is_dir():
        trained = from_json(read_facts(Path(name))["settings"])
        config = in_evaluation(trained, settings.pop("sim", trained.sim), **settings)
    else:
        config = configure_env(name, **settings)
    if cameras and "view" in varied:
        config = override(config, randomise=varied)
    return LeRobotVectorEnv(config, n_envs, cameras, size)
