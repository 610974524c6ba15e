"""Robot arms that learn to reach, in seconds, with proof.

Importing this package registers its Gymnasium environments and loads neither JAX nor a simulator.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register

if TYPE_CHECKING:
    from reachlab.checks import InputError
    from reachlab.config import RunConfig, configure
    from reachlab.env import Env
    from reachlab.evaluation import Report, evaluate
    from reachlab.gym_env import ReachEnv, ReachVectorEnv
    from reachlab.robots import Robot, load_robot
    from reachlab.training import TrainResult, train

__version__ = "0.1.0"

_HOMES = {
    "Env": "env",
    "InputError": "config",
    "ReachEnv": "gym_env",
    "ReachVectorEnv": "gym_env",
    "Report": "evaluation",
    "Robot": "robots",
    "RunConfig": "config",
    "TrainResult": "training",
    "configure": "config",
    "evaluate": "evaluation",
    "load_robot": "robots",
    "train": "training",
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


_FACE, _VECTOR_FACE = "reachlab.gym_env:ReachEnv", "reachlab.gym_env:ReachVectorEnv"
register("reachlab/Reach-v0", entry_point=_FACE, vector_entry_point=_VECTOR_FACE)
register(
    "reachlab/KukaReach-v0",
    entry_point=_FACE,
    vector_entry_point=_VECTOR_FACE,
    kwargs={"task": "tutorial", "observation": "target", "reward": "sparse"},
)
