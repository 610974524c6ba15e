"""reachlab's environments, under the name `reachlab` among LeRobot's."""

# pyright: reportMissingImports=false
from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE

from reachlab.deploy.lerobot_env import LeRobotVectorEnv
from reachlab.lerobot import make_env


@EnvConfig.register_subclass("reachlab")
@dataclass
class ReachlabEnv(EnvConfig):
    """Environment of a task."""

    task: str | None = "tutorial"
    """A task preset, or a folder that `reachlab export` wrote: the environment in which its policy is evaluated."""

    cameras: list[str] = field(default_factory=list)
    """Names of cameras, as `reachlab record` has them."""

    size: int = 96
    """Height and width of their pictures [pixels]."""

    settings: dict[str, Any] = field(default_factory=dict)
    """What is changed in the configuration, by name."""

    def __post_init__(self) -> None:
        """Fill in what LeRobot has to know of the environment.

        Raises:
            InputError: a task, camera or setting that does not exist, or a value that is not allowed.
        """
        env = make_env(1, **self.gym_kwargs)
        spaces, pixels = env.single_observation_space, [f"pixels/{name}" for name in self.cameras]
        self.fps = env.metadata["render_fps"]
        self.features_map = {"action": ACTION, "agent_pos": OBS_STATE, "environment_state": OBS_ENV_STATE}
        kinds = zip(self.features_map, (FeatureType.ACTION, FeatureType.STATE, FeatureType.ENV), strict=True)
        shapes = {"action": env.single_action_space.shape, **{name: space.shape for name, space in spaces.items()}}
        self.features = {name: PolicyFeature(kind, shapes[name]) for name, kind in kinds}
        self.features |= dict.fromkeys(pixels, PolicyFeature(FeatureType.VISUAL, (self.size, self.size, 3)))
        self.features_map |= {name: name.replace("pixels/", f"{OBS_IMAGES}.") for name in pixels}
        env.close()

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """What `make_env` is given."""
        return {"task": self.task, "cameras": self.cameras, "size": self.size, **self.settings}

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, LeRobotVectorEnv]]:
        """The batch of environments, where LeRobot looks for it."""
        return {"reachlab": {0: make_env(n_envs, use_async_envs, **self.gym_kwargs)}}
