"""Robot arms that learn to reach, in seconds, with proof.

Importing this package registers its Gymnasium environments and loads neither JAX nor a simulator: every name below is
loaded when it is asked for.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from reachlab.agents.policy import Policy
    from reachlab.deploy.export import Export, export
    from reachlab.deploy.onboard.controller import Controller
    from reachlab.deploy.record import record
    from reachlab.envs.core import Env
    from reachlab.envs.gymnasium_single import ReachEnv
    from reachlab.envs.gymnasium_vector import ReachVectorEnv
    from reachlab.envs.presets import configure, distillation
    from reachlab.evaluation.report import Report, evaluate
    from reachlab.learn.load import LoadedRun, load
    from reachlab.learn.train import TrainResult, distil, train
    from reachlab.robots.kinematics.forward import forward_kinematics
    from reachlab.robots.kinematics.inverse import inverse_kinematics
    from reachlab.robots.loading import load_robot
    from reachlab.robots.robot import Robot
    from reachlab.scale.sweep import sweep
    from reachlab.scale.trials import SweepConfig
    from reachlab.settings.config import RecordConfig, RunConfig
    from reachlab.settings.validation import InputError
    from reachlab.watch.page.view import view
    from reachlab.watch.plots import plot
    from reachlab.watch.video import write_video

__version__ = "0.1.0"

# XLA's log has pages of CPU features where the compilation cache is read. It is looked at when JAX is imported.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

_HOMES = {
    "Controller": "deploy.onboard.controller",
    "Env": "envs.core",
    "Export": "deploy.export",
    "InputError": "settings.validation",
    "LoadedRun": "learn.load",
    "Policy": "agents.policy",
    "ReachEnv": "envs.gymnasium_single",
    "ReachVectorEnv": "envs.gymnasium_vector",
    "RecordConfig": "settings.config",
    "Report": "evaluation.report",
    "Robot": "robots.robot",
    "RunConfig": "settings.config",
    "SweepConfig": "scale.trials",
    "TrainResult": "learn.train",
    "configure": "envs.presets",
    "distil": "learn.train",
    "distillation": "envs.presets",
    "evaluate": "evaluation.report",
    "export": "deploy.export",
    "forward_kinematics": "robots.kinematics.forward",
    "inverse_kinematics": "robots.kinematics.inverse",
    "load": "learn.load",
    "load_robot": "robots.loading",
    "plot": "watch.plots",
    "record": "deploy.record",
    "sweep": "scale.sweep",
    "train": "learn.train",
    "view": "watch.page.view",
    "write_video": "watch.video",
}

__all__ = [
    "Controller",
    "Env",
    "Export",
    "InputError",
    "LoadedRun",
    "Policy",
    "ReachEnv",
    "ReachVectorEnv",
    "RecordConfig",
    "Report",
    "Robot",
    "RunConfig",
    "SweepConfig",
    "TrainResult",
    "configure",
    "distil",
    "distillation",
    "evaluate",
    "export",
    "forward_kinematics",
    "inverse_kinematics",
    "load",
    "load_robot",
    "plot",
    "record",
    "sweep",
    "train",
    "view",
    "write_video",
]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return vars(import_module(f"reachlab.{_HOMES[name]}"))[name]
    raise AttributeError(f"module 'reachlab' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__


def _is_command() -> bool:
    """Whether this process is the command line's own, which Gymnasium and its ids would only keep waiting."""
    called = sys.orig_argv[1:3]
    return called == ["-m", "reachlab"] or Path(*called[:1]).name == "reachlab"


if not _is_command():
    import_module("reachlab.envs.gymnasium_ids")
