"""Task `tutorial`: touch a point on the table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

from reachlab.settings.preset_record import Preset, Rule
from reachlab.settings.rules import TaskSettings
from reachlab.settings.validation import BY_ARM, Fraction, InProportion, Point, Range

if TYPE_CHECKING:
    from reachlab.tasks.task import Task

AT_GOAL = {
    "end": "success ends the episode",
    "continue": "the policy acts until the time limit; success is judged on the last step",
    "hold": "as continue, but the joint command stays while the tool is within the success distance",
}
"""What may happen at the goal, by name."""

GUIDED = "target+tool", "dense"
"""Observation and reward of a policy that is shown the way."""

SMALL = {"hidden": (32, 32), "learning_rate": 1.5e-3}
"""Where the way to a place that is seen is told step by step, layers of 64, as the tutorial's, learn no surer: over six
arms and five seeds each a training took 45 iterations on average, and with them 42, each of twice the time."""

STUDENT = {"hidden": (64, 64)}
"""A student of pictures has to find the place in them."""

SPARSE = {"action_repeat": 8, "gamma": 0.9, "anneal_steps": 8_000_000}
"""Where success alone is rewarded, its credit has a long way back."""

PICTURED = {
    "num_envs": 256,
    "rollout_steps": 16,
    "action_repeat": 16,
    "gamma": 0.8,
    "epochs": 4,
    "minibatches": 8,
    "learning_rate": 7e-4,
    "anneal_steps": 8_000_000,
    "total_steps": 8_000_000,
    "stop_success": 0.98,
    "stop_streak": 1,
    "validation_episodes": 200,
    "validation_interval": 20,
    "report_episodes": 200,
}
"""A step with a picture costs a hundred times a step without one."""

TOUCHED = (
    Rule(lambda c: not c.rules.holds and (c.rules.observation, c.rules.reward) == GUIDED, SMALL),
    Rule(lambda c: not c.rules.holds and c.rules.reward == "sparse", SPARSE),
    Rule(lambda c: not c.rules.holds and c.rules.observation in ("image", "image+tool"), PICTURED),
)
"""What goes with other choices where touching the goal is enough."""


@dataclass(frozen=True)
class Tutorial(TaskSettings):
    """Settings of reaching a point."""

    preset: ClassVar[Preset] = Preset(rules=TOUCHED, student=STUDENT)
    evaluated: ClassVar[tuple[str, ...]] = (
        *("targets", "target_low", "target_high", "target_height", "goal_steps", "goal_lost"),
        *TaskSettings.evaluated,
    )

    at_goal: str = "end"
    """What happens at the target: continue, end or hold. `end`: success ends the episode. `continue`: the policy acts
    until the time limit, and success is judged on the last step. `hold`: as `continue`, but while the tool is within
    the success distance the joint command stays as it is, so that the arm rests there; it acts again when the tool is
    outside."""
    end_outside: bool = True
    """Leaving the workspace ends the episode, in failure. Where the target has to be held it does not in any case."""
    targets: str = "table"
    """Where targets are sampled: box or table, and of poses any; see `reachlab list`."""
    target_height: Annotated[float, Range(-10.0, 10.0), InProportion(-0.0083, from_floor=True)] = BY_ARM
    """Height of the targets on the table [m]; by default the tutorial's -0.0083 m, where its object settles, in
    proportion to the arm's workspace and from its floor."""
    target_low: Point | None = None
    """Lower corner of the box of targets [m]; by default the robot's own."""
    target_high: Point | None = None
    """Upper corner of the box of targets [m]; by default the robot's own."""
    gripper: str | None = None
    """Gripper at the flange, with the tool point between its fingers: own or parallel. Own is that of a file that has
    one, else it is parallel; by default there is none, and fingers stay closed."""
    goal_steps: Annotated[int, Range(1, 10**5)] | None = None
    """Steps at the start of an episode in which the target is seen; by default it always is."""
    goal_lost: Fraction = 0.0
    """Share of the steps in which the target is not seen. It is observed where the tool is then, and a picture is
    black."""

    @classmethod
    def task(cls) -> Task:
        """The last link's frame touches a point on the table."""
        from reachlab.tasks import reach
        from reachlab.tasks.task import Control, Task

        return Task(
            tool="wrist",
            # A residual action of 1 can turn the arm round.
            control=Control("resolved_rate", residual_gain=2.0),
            goal_box=reach.goal_box,
            sample_goal=reach.sample_goal,
            sample_start=reach.sample_start,
            begin=reach.begin,
            update=reach.update,
            counted=reach.counted,
            check=reach.check,
            asks=reach.asks,
            succeeds=reach.succeeds,
        )

    def contradiction(self) -> str | None:
        """What of these settings cannot be together."""
        from reachlab.tasks.actions import ACTIONS

        if self.hides_goal and (self.asks_orientation or "joints" in self.gives):
            return "goal_steps and goal_lost are of targets that are points alone, as in task precise: leave them out."
        if self.hides_goal and (alone := ACTIONS[self.action].whole):
            return (
                f"action {self.action!r} corrects a controller, which stays where it is while the target is not seen:"
                f" choose {alone}."
            )
        if self.targets == "any" and not self.asks_orientation:
            return "targets 'any' are poses: choose task 'pose', or targets 'box' or 'table'."
        if self.targets != "box" or self.target_low is None or self.target_high is None:
            return None
        for axis, low, high in zip("xyz", self.target_low, self.target_high, strict=True):
            if low > high:
                return f"target_low is above target_high in {axis}, {low:g} against {high:g} m: exchange them."
        return None

    @property
    def mounts(self) -> str:
        """Gripper that is mounted."""
        return self.gripper or ""

    @property
    def hides_goal(self) -> bool:
        """Whether the target is not seen at times."""
        return self.goal_steps is not None or self.goal_lost > 0

    @property
    def ends_outside(self) -> bool:
        """Whether leaving the workspace ends an episode."""
        return self.end_outside and not self.holds

    @property
    def ends_at_goal(self) -> bool:
        """Whether success ends an episode."""
        return self.at_goal == "end"

    @property
    def rests_at_goal(self) -> bool:
        """Whether the joint command stays while the tool is at the goal."""
        return self.at_goal == "hold"
