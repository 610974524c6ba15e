"""Settings of an exported policy, under the name `reachlab` among LeRobot's."""

# pyright: reportMissingImports=false
from __future__ import annotations

from dataclasses import dataclass, field

from lerobot.configs import NormalizationMode, PreTrainedConfig


@PreTrainedConfig.register_subclass("reachlab")
@dataclass
class ReachlabConfig(PreTrainedConfig):
    """Settings of an exported policy."""

    export: str | None = None
    """Folder that `reachlab export` wrote; of a policy that LeRobot saved, a folder inside of that one."""

    device: str | None = "cpu"
    """Where LeRobot's tensors are; the policy itself computes with NumPy."""

    normalization_mapping: dict[str, NormalizationMode] = field(default_factory=dict)
    """Nothing is normalised by LeRobot: the exported policy does that."""

    observation_delta_indices = action_delta_indices = reward_delta_indices = None

    def validate_features(self) -> None:
        """Accept what an environment has: whether it is all that is observed turns out at the first action."""

    def get_optimizer_preset(self) -> None:
        """No optimiser: LeRobot does not train it."""

    def get_scheduler_preset(self) -> None:
        """No schedule either."""
