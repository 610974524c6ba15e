"""Every setting of a run, as frozen dataclasses: flags, keywords of `gymnasium.make` and `config.json` follow them.

Field names are unique among them. This module imports nothing heavy.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

from reachlab.settings.validation import (
    Checked,
    Count,
    Fraction,
    Length,
    NonNegative,
    NonNegativeInt,
    Point,
    Positive,
    Range,
    Seed,
    Steps,
)

Few = Annotated[int, Range(0, 16)]
"""A number of obstacles."""


@dataclass(frozen=True)
class TaskConfig(Checked):
    """The rules of the reach task."""

    tool: str | None = None
    """Tool frame, a site or body of the robot, that has to reach the target; by default its own for this task."""
    observation: str = "target+tool"
    """What the policy observes; see `reachlab list`."""
    action: str = "tool_delta"
    """What the policy commands; see `reachlab list`."""
    reward: str = "dense"
    """Reward; see `reachlab list`."""
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
    max_steps: Count = 1000
    """An episode is truncated on this step."""
    approach_weight: NonNegative | None = None
    """Reward of the `dense` reward for each metre that the tool comes closer [1/m]; by default 5/m, in inverse
    proportion to the arm's workspace."""
    success_angle: Positive = 0.05
    """Where an orientation is asked for: tool to target within this angle too is a success [rad]."""
    angle_weight: NonNegative = 0.1
    """Distance that a radian of the angle to the target counts as in rewards and corrections [m/rad]."""
    targets: str = "table"
    """Where targets are sampled; see `reachlab list`."""
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
    """Where the goal moves: the paths of which an episode has one; see `reachlab list`."""
    goal_speed: tuple[NonNegative, NonNegative] = (0.0, 0.2)
    """Where the goal moves: least and largest speed, of which an episode has one in between [m/s]."""
    goal_jump: Positive | None = None
    """Where the goal jumps: how far [m]; by default 0.3 m, in proportion to the arm's workspace."""
    goal_velocity: bool = True
    """Where the goal moves: the policy and inverse kinematics know its velocity."""
    settle_steps: NonNegativeInt = 50
    """Where the goal moves: steps at the begin of an episode that do not count."""
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


@dataclass(frozen=True)
class SimConfig(Checked):
    """The physics."""

    control_period: Positive = 1 / 240
    """Time from one command to the next [s]."""
    physics_steps: Count = 5
    """MuJoCo: steps of the engine in a control period."""
    collisions: bool = False
    """MuJoCo: the arm meets the table. With the tutorial's targets its flange would enter it."""
    gravity_compensation: bool = False
    """MuJoCo: gravity does not pull at the arm."""
    gui: bool = False
    """PyBullet: open its window, on the first environment."""
    slow: bool = False
    """PyBullet: slow down to be followed by eye."""


@dataclass(frozen=True)
class LoopConfig(Checked):
    """The loop of training, whatever the method: steps, validations and checkpoints."""

    total_steps: Steps = 20_000_000
    """Environment steps after which training ends in any case. With `action_repeat` all repeats of an action count,
    also those after an episode's end, which are not stepped: about 2 % of all at 8, 5 % at 16."""
    stop_early: bool = True
    """End training once `stop_streak` validations in a row reach `stop_success`."""
    stop_streak: Count = 3
    """Validations in a row that have to reach it: a policy that only just does often fails in other simulators."""
    stop_success: Fraction = 1.0
    """Success rate that a validation has to reach, of the policy without noise."""
    validation_episodes: Count = 3000
    """Episodes of a validation; their targets are neither those of training nor those of the report."""
    validation_interval: Count = 2
    """Iterations between validations, once 90 % of the training episodes succeed, or `stop_success` if that is less."""
    report_episodes: Count = 1000
    """Held-out episodes of the report at the end of training."""
    num_envs: Annotated[int, Range(1, 2**17)] = 128
    """Environments stepped together."""
    rollout_steps: Count = 64
    """Actions in each environment between two updates."""
    chained_starts: Fraction = 0.0
    """Share of training episodes that begin where the arm's last one ended, with a new target: what a policy has to
    see to follow a target that is moved. Evaluations begin at home in any case."""
    action_repeat: Count = 1
    """In training, steps for which each action is repeated; the trained policy acts at every step."""
    checkpoint_interval: NonNegative = 20.0
    """Time from one checkpoint to the next [s]; longer if saving took more than 2 % of it, and 0 saves always."""
    keep_checkpoints: Count = 3
    """Newest checkpoints that are kept; the best one is kept too."""
    deterministic: bool = False
    """Compute on one thread: the same weights on any number of cores."""

    @property
    def iteration_steps(self) -> int:
        """Environment steps of an iteration."""
        return self.num_envs * self.rollout_steps * self.action_repeat


@dataclass(frozen=True)
class LearnerConfig(Checked):
    """The networks and their optimiser, whatever the method."""

    hidden: Annotated[tuple[Count, ...], Length(16)] = (64, 64)
    """Widths of the hidden layers of actor and critic."""
    learning_rate: Positive = 1e-3
    """Learning rate of Adam at the start."""
    final_learning_rate: NonNegative = 1e-4
    """Learning rate after `anneal_steps`; it falls on a straight line."""
    anneal_steps: Steps = 2_000_000
    """Environment steps over which the learning rate falls."""
    max_grad_norm: Positive = 0.5
    """The gradient of all parameters together is shortened to this norm."""
    initial_std: Positive = 0.4
    """Noise of the actions at the start: standard deviation, where 1 is half the range of an action."""


@dataclass(frozen=True)
class PPOConfig(Checked):
    """Proximal policy optimisation."""

    epochs: Count = 8
    """Passes over a rollout."""
    minibatches: Count = 2
    """Parts of a rollout, one gradient step each."""
    gamma: Fraction = 0.98
    """Discount of the reward from one action to the next."""
    gae_lambda: Fraction = 0.95
    """Decay of generalised advantage estimation."""
    clip_ratio: Positive = 0.2
    """PPO's bound on the change of an action's probability."""
    value_weight: NonNegative = 0.5
    """Weight of the value loss."""
    entropy_weight: NonNegative = 0.0
    """Weight of the entropy bonus."""
    final_std: Positive | None = None
    """`initial_std` after `anneal_steps`, its logarithm falling on a straight line; without it the noise is learnt."""


@dataclass(frozen=True)
class RunConfig(Checked):
    """Everything that decides a training run."""

    verb: ClassVar[str] = "train"
    """Command that makes such a run."""
    method: ClassVar[str] = "ppo"
    """How its policy is learnt; see `reachlab.learn.METHODS`."""

    task: str = "tutorial"
    """Task preset; it sets the other defaults."""
    robot: str = "iiwa14"
    """Robot: a name of `reachlab list`, or the path of an MJCF or URDF file; see `reachlab robot`."""
    base: str | None = None
    """Body of the robot's file that holds the arm; joints before it are locked. By default its first."""
    package: Annotated[tuple[str, ...], Length(64)] = ()
    """Folders of the ROS packages that the robot's file names, each as NAME=FOLDER."""
    sim: str = "kinematic"
    """Simulator."""
    seed: Seed = 0
    """Seed of everything random."""
    randomise: Annotated[tuple[str, ...], Length(8)] = ()
    """What varies from episode to episode in training; the report is without it. `dynamics`: in MuJoCo servo gains
    within 15 %, joint damping within 30 % and a payload of 0 to 2 kg at the tool, and everywhere joints measured with
    noise of 0.5 mrad and 0.01 rad/s. `view`: light, colours and the camera's pose within 2 cm and 2 degrees."""
    rules: TaskConfig = field(default_factory=TaskConfig)
    physics: SimConfig = field(default_factory=SimConfig)
    loop: LoopConfig = field(default_factory=LoopConfig)
    learner: LearnerConfig = field(default_factory=LearnerConfig)
    ppo: PPOConfig = field(default_factory=PPOConfig)

    def __post_init__(self) -> None:
        """Check every field, and remember a robot's file and packages so that they are found from any folder."""
        super().__post_init__()
        if is_robot_file(self.robot):
            object.__setattr__(self, "robot", str(Path(self.robot).absolute()))
        object.__setattr__(self, "package", tuple(map(_absolute, self.package)))


def _absolute(package: str) -> str:
    """A package NAME=FOLDER with the folder's absolute path."""
    name, equals, folder = package.partition("=")
    return f"{name}={Path(folder).absolute()}" if equals and folder else package


def is_robot_file(robot: str) -> bool:
    """Whether a robot is named by the path of its model file, rather than by its name in the table."""
    return Path(robot).suffix in (".xml", ".urdf")


@dataclass(frozen=True)
class DaggerConfig(Checked):
    """Learning from camera pictures, by a teacher that gets the positions themselves (DAgger)."""

    guided: NonNegativeInt = 8
    """Iterations at the start in which the teacher acts, before the student does."""
    noise: NonNegative = 0.2
    """Noise of the actions, to learn to come back: standard deviation, where 1 is half the range of an action."""
    updates: Count = 48
    """Gradient steps of an iteration."""
    batch: Count = 256
    """Pictures of a gradient step."""
    capacity: Annotated[int, Range(1, 10**6)] = 60_000
    """Pictures that are kept to learn from, of 7 kB each."""
    place_weight: NonNegative = 4.0
    """Weight of predicting where target and tool are, beside that of predicting the action."""


@dataclass(frozen=True)
class DistilRunConfig(RunConfig):
    """Everything that decides a distillation; it uses nothing of `ppo`."""

    verb: ClassVar[str] = "distil"
    method: ClassVar[str] = "dagger"

    teacher: str = ""
    """Run directory of the teacher."""
    teacher_observation: str = "target+tool"
    """What the teacher observes."""
    dagger: DaggerConfig = field(default_factory=DaggerConfig)
