"""The rules of a task: what is asked for, observed, commanded and rewarded, and when an episode ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from reachlab.settings.validation import Checked, Length, NonNegative, NonNegativeInt, Point, Positive, Range

Few = Annotated[int, Range(0, 16)]
"""A number of obstacles."""


@dataclass(frozen=True)
class TaskConfig(Checked):
    """The rules of the reach task."""

    tool: str | None = None
    """Tool frame, a site or body of the robot, that has to reach the target; by default its own for this task."""
    observation: str = "target+tool"
    """What the policy observes: clutter, goal, goal+state, image, image+tool, pose, state, target, target+tool or
    track; see `reachlab list`."""
    action: str = "tool_delta"
    """What the policy commands: joint_delta, joint_residual, tool_delta or tool_step; see `reachlab list`."""
    reward: str = "dense"
    """Reward: closeness, dense, goal, goal_distance, precise or sparse; see `reachlab list`."""
    clip_actions: bool = True
    """Clip actions to their box. The tutorial's own code does not."""
    tool_scale: Positive | None = None
    """Displacement of the tool for an action of 1 with `tool_delta` or `tool_step` [m]; by default the tutorial's
    0.005 m, in proportion to the arm's workspace."""
    joint_scale: Positive | None = 0.02
    """Displacement of a joint for an action of 1 with `joint_delta` [rad or m]; None: what its full speed takes it in a
    control period."""
    success_distance: Positive | None = None
    """Tool to target within this distance is a success [m]; by default the tutorial's 0.1 m, in proportion to the arm's
    workspace."""
    at_goal: str = "end"
    """What happens at the target. `end`: success ends the episode. `continue`: the policy acts until the time limit,
    and success is judged on the last step. `hold`: as `continue`, but while the tool is within the success distance the
    joint command stays as it is, so that the arm rests there; it acts again when the tool is outside."""
    end_outside: bool = True
    """Leaving the workspace ends the episode, in failure. Where the target has to be held it does not in any case."""
    max_steps: Annotated[int, Range(1, 10**5)] = 1000
    """An episode is truncated on this step."""
    approach_weight: NonNegative | None = None
    """Reward of the `dense` reward for each metre that the tool comes closer [1/m]; by default 5/m, in inverse
    proportion to the arm's workspace."""
    success_angle: Positive = 0.05
    """Where an orientation is asked for: tool to target within this angle too is a success [rad]."""
    angle_weight: NonNegative = 0.1
    """Distance that a radian of the angle to the target counts as in rewards and corrections [m/rad]."""
    targets: str = "table"
    """Where targets are sampled: any, box or table; see `reachlab list`."""
    target_turn: tuple[NonNegative, NonNegative, NonNegative] | None = None
    """Ask for an orientation: the held one turned by up to this roll, pitch and yaw about the world's axes [rad]."""
    target_height: Annotated[float, Range(-10.0, 10.0)] | None = None
    """Height of the targets on the table [m]; by default the tutorial's -0.0083 m, where its object settles, in
    proportion to the arm's workspace and from its floor."""
    target_low: Point | None = None
    """Lower corner of the box of targets [m]; by default the robot's own."""
    target_high: Point | None = None
    """Upper corner of the box of targets [m]; by default the robot's own."""
    obstacles: tuple[Few, Few] = (0, 0)
    """Fewest and most obstacles of an episode."""
    end_on_contact: bool = False
    """Touching anything ends the episode, in failure."""
    goal_paths: Annotated[tuple[str, ...], Length(16)] = ("line", "circle", "smooth")
    """Where the goal moves: the paths of which an episode has one, of circle, jumps, line and smooth."""
    goal_speed: tuple[NonNegative, NonNegative] = (0.0, 0.2)
    """Where the goal moves: least and largest speed, of which an episode has one in between [m/s]."""
    goal_jump: Positive | None = None
    """Where the goal jumps: how far [m]; by default 0.3 m, in proportion to the arm's workspace."""
    goal_velocity: bool = True
    """Where the goal moves: the policy and inverse kinematics know its velocity."""
    settle_steps: NonNegativeInt = 50
    """Where the goal moves: steps at the beginning of an episode that do not count."""
    start_noise: NonNegative = 0.0
    """Episodes start with every joint within this of its home [rad or m]."""
    hold_steps: NonNegativeInt = 0
    """Success is that the tool was within the success distance, and the joints slow, for so many steps in a row; with
    0, touching the target is enough."""
    hold_speed: Positive = 0.05
    """Joint speed below which the tool counts as held [rad/s or m/s]."""
    closeness_weight: NonNegative = 0.2
    """Reward of the `precise` reward for a step at the target itself, and as much again for being still there."""
    closeness_scale: Positive = 0.01
    """Distance at which that reward has fallen to about a half [m]."""
    effort_weight: NonNegative = 0.01
    """Penalty of the `precise` reward for a step with actions of 1."""

    @property
    def ends_outside(self) -> bool:
        """Whether leaving the workspace ends an episode."""
        return self.end_outside and not self.hold_steps

    @property
    def asks_orientation(self) -> bool:
        """Whether the tool's orientation is asked for."""
        return self.target_turn is not None or self.targets == "any"


@dataclass(frozen=True)
class Rules(TaskConfig):
    """The rules on an arm: with the lengths that follow from its workspace."""

    tool_scale: Positive = 0.005
    success_distance: Positive = 0.1
    approach_weight: NonNegative = 5.0
    goal_jump: Positive = 0.3
    target_height: Annotated[float, Range(-10.0, 10.0)] = -0.0083
