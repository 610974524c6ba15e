"""The settings that every task has; each task's own are in its file, see `reachlab.tasks`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from reachlab.settings.validation import BY_ARM, Checked, InProportion, NonNegative, Positive, Range


@dataclass(frozen=True)
class TaskSettings(Checked):
    """Settings of a task; a task's class adds its own, and its defaults are the task's preset.

    Lengths that are left out follow from the arm's workspace, see `InProportion`.
    """

    preset: ClassVar[Any]
    """Settings of the training that go with the task, see `presets.Preset`."""
    evaluated: ClassVar[tuple[str, ...]] = ("start_noise", "max_steps", "wrench")
    """Settings that an evaluation may change: what is asked for, for how long, and what is measured."""

    tool: str | None = None
    """Tool frame, a site or body of the robot, that has to reach the target; by default its own for this task."""
    observation: str = "target+tool"
    """What the policy observes: clutter, clutter_pose, glimpse, goal, goal+state, image, image+tool, lift, pose, push,
    slide, state, target, target+tool, track or ways; see `reachlab list`."""
    action: str = "tool_delta"
    """What the policy commands: heading, joint_delta, joint_residual, picture_points, tool_delta or tool_step; see
    `reachlab list`."""
    reward: str = "dense"
    """Reward: closeness, dense, goal, goal_distance, precise or sparse; see `reachlab list`."""
    clip_actions: bool = True
    """Clip actions to their box. The tutorial's own code does not."""
    tool_scale: Annotated[Positive, InProportion(0.005)] = BY_ARM
    """Displacement of the tool for an action of 1 [m]; by default the tutorial's 0.005 m, in proportion to the arm's
    workspace."""
    joint_scale: Positive | None = 0.02
    """Displacement of a joint for an action of 1 [rad or m]; None: what its full speed takes it in a control period."""
    success_distance: Annotated[Positive, InProportion(0.1)] = BY_ARM
    """Tool to target within this distance is a success [m]; by default the tutorial's 0.1 m, in proportion to the arm's
    workspace."""
    max_steps: Annotated[int, Range(1, 10**5)] = 1000
    """An episode is truncated on this step."""
    start_noise: NonNegative = 0.0
    """Episodes start with every joint within this of its home [rad or m], a slide within a tenth of its way."""
    approach_weight: Annotated[NonNegative, InProportion(5.0, inverse=True)] = BY_ARM
    """Reward for each metre that the tool comes closer [1/m]; by default 5/m, in inverse proportion to the arm's
    workspace."""
    closeness_weight: NonNegative = 0.2
    """Reward for a step at the target itself, and with `precise` as much again for being still there."""
    closeness_scale: Positive = 0.01
    """Distance at which that reward has fallen to about a half [m]."""
    effort_weight: NonNegative = 0.01
    """Penalty for a step with actions of 1."""
    hold_speed: Positive = 0.05
    """Joint speed below which the tool counts as held [rad/s or m/s]."""
    wrench: bool = False
    """Measure the force and the torque at the wrist, and observe them; with a simulator that has dynamics."""

    settle_steps = 0
    """Steps until a goal that moves counts, for a task whose goals do."""
    goal_speed = (0.0, 0.2)
    """Least and largest speed of such a goal [m/s]."""

    # Tasks have others in their place: attributes, or properties where they follow from settings.
    gives = frozenset[str]()
    """Words for all there is to observe and to control by beside a point that stays: see `reachlab.tasks.WORDS`."""
    mounts = ""
    """Gripper that is mounted at the tool frame; none by default."""
    grips = False
    """Whether the gripper's fingers are driven."""
    holds = False
    """Whether the goal has to be held for a while, rather than touched."""
    hides_goal = False
    """Whether the goal is not seen at times."""
    ends_outside = False
    """Whether leaving the workspace ends an episode."""
    ends_on_contact = False
    """Whether touching anything ends an episode."""
    ends_at_goal = False
    """Whether success ends an episode."""
    rests_at_goal = False
    """Whether the joint command stays while the tool is at the goal."""

    @classmethod
    def task(cls) -> Any:
        """The task itself, a `reachlab.tasks.task.Task`; what it is made of is imported here."""
        raise NotImplementedError

    def contradiction(self) -> str | None:
        """Sentence on settings that cannot be together; None where all can."""
        return None

    @property
    def asks_orientation(self) -> bool:
        """Whether the tool's orientation is asked for."""
        return "orientation" in self.gives

    @property
    def moves(self) -> bool:
        """Whether the goal moves."""
        return "velocity" in self.gives
