"""Settings of the tasks that have an object on a table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from reachlab.settings.config import LearnerConfig, LoopConfig, PPOConfig, SimConfig
from reachlab.settings.preset_record import Preset
from reachlab.settings.rules import TaskSettings
from reachlab.settings.validation import InProportion, NonNegative, Positive, Range

SHAPES = {
    "box": "a cube",
    "cylinder": "a cylinder as high as it is wide, which stands",
    "ball": "a ball, which rolls",
    "puck": "a cylinder a third as high as it is wide",
}
"""Shapes of objects by name."""

HANDS = {"own": "that of the file, or else parallel", "parallel": "two fingers that are mounted at the tool frame"}
"""Grippers by name."""


@dataclass(frozen=True)
class Handling(TaskSettings):
    """Settings of moving an object."""

    preset: ClassVar[Preset] = Preset(
        sim="mujoco",
        randomise=("objects", "sight"),
        physics=SimConfig(control_period=0.02, gravity_compensation=True),
        loop=LoopConfig(total_steps=1_000_000, stop_early=False, report_episodes=2000, num_envs=256, rollout_steps=32),
        learner=LearnerConfig(
            hidden=(128, 128),
            learning_rate=1e-3,
            final_learning_rate=1e-5,
            anneal_steps=1_000_000,
            initial_std=0.3,
        ),
        ppo=PPOConfig(epochs=4, minibatches=4, gamma=0.97, final_std=0.1),
    )
    evaluated: ClassVar[tuple[str, ...]] = (
        *("object_shape", "object_size", "object_mass", "object_friction"),
        *TaskSettings.evaluated,
    )

    observation: str = "push"
    action: str = "joint_residual"
    reward: str = "precise"
    approach_weight: Annotated[NonNegative, InProportion(5.0, inverse=True)] = 10.0
    effort_weight: NonNegative = 0.003
    joint_scale: Positive | None = None
    success_distance: Annotated[Positive, InProportion(0.1)] = 0.02
    max_steps: Annotated[int, Range(1, 10**5)] = 150
    start_noise: NonNegative = 0.1
    hold_steps: Annotated[int, Range(1, 1000)] = 10
    """Success is that the object was within the success distance, and it and the joints slow, for so many steps in a
    row."""
    gripper: str = "own"
    """Gripper: parallel, which is mounted at the tool frame, or own, which is that of a file that has one and else
    parallel; of the catalogue's arms only so101 has one."""
    object_shape: str = "box"
    """Shape of the object: ball, box, cylinder or puck; see `SHAPES`."""
    object_size: Annotated[float, Range(0.015, 0.03)] = 0.02
    """Half the side of the object, or its radius [m]."""
    object_mass: Annotated[float, Range(0.01, 1.0)] = 0.1
    """Mass of the object [kg]."""
    object_friction: Annotated[float, Range(0.1, 2.0)] = 0.6
    """Friction of the object on the table and at the gripper."""

    def contradiction(self) -> str | None:
        """What of these settings cannot be together."""
        if self.hold_steps > self.max_steps:
            return (
                f"the object cannot rest for hold_steps {self.hold_steps} in an episode of max_steps {self.max_steps}:"
                " choose fewer --hold-steps or more --max-steps."
            )
        return None

    @property
    def gives(self) -> frozenset[str]:
        """What there is to observe and to control by."""
        return frozenset({"object", *["gripper"] * self.grips})

    @property
    def mounts(self) -> str:
        """Gripper that is mounted."""
        return self.gripper

    holds = True
    """The object has to rest at the goal."""
