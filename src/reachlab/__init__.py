"""Robot arms that learn to reach, in seconds, with proof.

Importing this package registers its Gymnasium environments and loads neither JAX nor a simulator.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register

if TYPE_CHECKING:
    from reachlab.envs.core import Env
    from reachlab.envs.gymnasium_single import ReachEnv
    from reachlab.envs.gymnasium_vector import ReachVectorEnv
    from reachlab.evaluation.report import Report, evaluate
    from reachlab.learn.train import TrainResult, train
    from reachlab.robots.loading import load_robot
    from reachlab.robots.robot import Robot
    from reachlab.settings.config import RunConfig
    from reachlab.settings.presets import configure
    from reachlab.settings.validation import InputError

__version__ = "0.1.0"

_HOMES = {
    "Env": "envs.core",
    "InputError": "settings.validation",
    "ReachEnv": "envs.gymnasium_faces",
    "ReachVectorEnv": "envs.gymnasium_faces",
    "Report": "evaluation.report",
    "Robot": "robots.loading",
    "RunConfig": "settings.config",
    "TrainResult": "learn.train",
    "configure": "settings.config",
    "evaluate": "evaluation.report",
    "load_robot": "robots.loading",
    "train": "learn.train",
}

__all__ = [
    "Env",
    "InputError",
    "ReachEnv",
    "ReachVectorEnv",
    "Report",
    "Robot",
    "RunConfig",
    "TrainResult",
    "configure",
    "evaluate",
    "load_robot",
    "train",
]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return vars(import_module(f"reachlab.{_HOMES[name]}"))[name]
    raise AttributeError(f"module 'reachlab' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__


_FACE, _VECTOR_FACE = "reachlab.envs.gymnasium_faces:ReachEnv", "reachlab.envs.gymnasium_faces:ReachVectorEnv"
register("reachlab/Reach-v0", entry_point=_FACE, vector_entry_point=_VECTOR_FACE)
register(
    "reachlab/KukaReach-v0",
    entry_point=_FACE,
    vector_entry_point=_VECTOR_FACE,
    kwargs={"task": "tutorial", "observation": "target", "reward": "sparse"},
)
