"""A policy that `reachlab export` wrote, as one of LeRobot's."""

# pyright: reportMissingImports=false
from __future__ import annotations

import dataclasses
import logging
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import OBS_ENV_STATE, OBS_STATE
from torch import Tensor

from lerobot_policy_reachlab.configuration_reachlab import ReachlabConfig
from reachlab.deploy.check import read_facts, start_controller
from reachlab.deploy.lerobot_units import exported_motors
from reachlab.deploy.surroundings import step_arguments
from reachlab.settings.validation import InputError

EXPORT = "export"
"""Where a saved policy has the folder that `reachlab export` wrote."""

log = logging.getLogger(__name__)


class ReachlabPolicy(PreTrainedPolicy):
    """The controller of an exported folder, once for each environment of a batch.

    It observes what `reachlab.lerobot.make_env` gives; speeds follow from where the motors were a step before.
    """

    config_class, name = ReachlabConfig, "reachlab"

    def __init__(self, config: ReachlabConfig, **extras: Any) -> None:
        """Policy of the folder `config.export`; `extras` that LeRobot hands over have no effect.

        Raises:
            InputError: no folder is named, or none that `reachlab export` wrote.
        """
        del extras
        super().__init__(config)
        if not config.export:
            raise InputError("policy 'reachlab' needs a folder that `reachlab export` wrote: --policy.export=FOLDER.")
        self._folder = Path(config.export)
        self._facts, self._controllers = read_facts(self._folder), list[Any]()
        if self._facts["observation"]["pictured"]:
            raise InputError("a policy that observes pictures is not run in LeRobot: evaluate it by `reachlab eval`.")
        self._motors = exported_motors(self._facts)
        self.reset()

    @classmethod
    def from_pretrained(
        cls, pretrained_name_or_path: str | Path, *, config: ReachlabConfig | None = None, **kwargs: Any
    ) -> ReachlabPolicy:
        """Policy that LeRobot saved in a folder of this machine.

        Raises:
            InputError: there is no such folder. None is downloaded, for Python that is in it is run.
        """
        del kwargs
        folder = Path(pretrained_name_or_path)
        if not folder.is_dir():
            raise InputError(
                f"'{folder}' is no folder: download it first, and read its {EXPORT}/step.py, which is run."
            )
        config = config or PreTrainedConfig.from_pretrained(folder)
        return cls(dataclasses.replace(config, export=str(folder / EXPORT)))

    def _save_pretrained(self, save_directory: Path, state_dict: Any = None) -> None:
        del state_dict
        shutil.copytree(self._folder, save_directory / EXPORT, dirs_exist_ok=True)
        dataclasses.replace(self.config, export=None)._save_pretrained(save_directory)

    def reset(self) -> None:
        """Begin an episode: at the next action the arms are taken over where they are."""
        self._before: np.ndarray | None = None
        self._steps, self._problems = 0, {""}  # what was said once

    def select_action(self, batch: dict[str, Tensor], **kwargs: Any) -> Tensor:
        """Positions of the motors `[B, k]`, for those `[B, k]` where they are and for what is asked.

        Raises:
            InputError: the environment is not one of the policy's arm and task.
        """
        del kwargs
        shown, asked = (batch[key].numpy(force=True).astype(float) for key in (OBS_STATE, OBS_ENV_STATE))
        if shown.shape[1] != len(self._motors.names):
            raise InputError(f"policy and environment have {len(self._motors.names)} and {shown.shape[1]} motors.")
        q, period = self._motors.command(shown), self._facts["control_period"]
        if self._before is None:
            self._controllers += [start_controller(self._folder) for _ in range(len(q) - len(self._controllers))]
            for controller, joints in zip(self._controllers, q, strict=False):
                controller.reset(joints)
            self._before = q
        commands = []
        for i, controller in enumerate(self._controllers[: len(q)]):
            speeds, now = (q[i] - self._before[i]) / period, self._steps * period
            commands.append(controller.step(q[i], speeds, time=now, **step_arguments(self._facts, asked[i])))
            if controller.problem not in self._problems:
                log.warning("reachlab: %s.", controller.problem)
                self._problems.add(controller.problem)
        if any(getattr(controller, "waits", False) for controller in self._controllers[: len(q)]):
            time.sleep(period)  # their planners need real time
        self._before, self._steps = q, self._steps + 1
        return torch.from_numpy(self._motors.read(np.array(commands)).astype(np.float32)).to(self.config.device)

    def predict_action_chunk(self, batch: dict[str, Tensor], **kwargs: Any) -> Tensor:
        """A chunk of a single action, `[B, 1, k]`."""
        return self.select_action(batch, **kwargs)[:, None]

    def get_optim_params(self) -> dict[str, Any]:
        """Nothing to optimise."""
        return {}

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Any] | None]:
        """Refuse to be trained.

        Raises:
            InputError: always.
        """
        del batch
        raise InputError("a policy of reachlab is trained by `reachlab train`, not by LeRobot.")
