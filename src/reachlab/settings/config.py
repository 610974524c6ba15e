"""Every setting of a run, as frozen dataclasses: flags, keywords of `gymnasium.make` and `config.json` follow them.

Field names are unique among them. This module imports nothing heavy.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

from reachlab.settings.rules import TaskSettings
from reachlab.settings.validation import (
    Checked,
    Count,
    Fraction,
    InputError,
    Length,
    NonNegative,
    NonNegativeInt,
    Positive,
    Range,
    Seed,
    Steps,
)

PICTURE_SIDES = 16, 512
"""Least and largest height and width of a recorded picture [pixels]."""

MOST_ENVS = 2**17
"""Environments of a batch."""


@dataclass(frozen=True)
class SimConfig(Checked):
    """The physics."""

    control_period: Annotated[float, Range(1e-5, 10.0)] = 1 / 240
    """Time from one command to the next [s]."""
    physics_steps: Annotated[int, Range(1, 1000)] = 5
    """MuJoCo: steps of the engine in a control period."""
    collisions: bool = False
    """MuJoCo: the arm meets the table. With the tutorial's targets its flange would enter it."""
    gravity_compensation: bool = False
    """MuJoCo: gravity does not pull at the arm."""
    servo_lag: Annotated[float, Range(0.02, 1.0)] | None = None
    """MuJoCo: time by which joints follow a moving command, as measured at your arm [s]. Without it they follow as the
    servos of the robot's file do, or by 0.1 s."""
    gui: bool = False
    """PyBullet: open its window, on the first environment."""
    slow: bool = False
    """PyBullet: slow down to be followed by eye."""
    shaping: bool = False
    """Joint commands are kept within the arm's limits of acceleration and jerk too, as the controller of an exported
    policy keeps them: they can be stopped within 0.18 s at any time."""


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
    validation_episodes: Annotated[int, Range(1, 10**5)] = 3000
    """Episodes of a validation; their targets are neither those of training nor those of the report."""
    validation_interval: Count = 2
    """Iterations between validations, once 90 % of the training episodes succeed, or `stop_success` if that is less.
    After one that fails by per cents up to three are left out."""
    report_episodes: Count = 1000
    """Held-out episodes of the report at the end of training."""
    num_envs: Annotated[int, Range(1, MOST_ENVS)] = 128
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

    hidden: Annotated[tuple[Annotated[int, Range(1, 4096)], ...], Length(16)] = (64, 64)
    """Widths of the hidden layers of actor and critic."""
    memory: Annotated[int, Range(0, 4096)] = 0
    """Numbers that the policy remembers from step to step; 0: it acts by what it observes now. A gated recurrent unit
    before the hidden layers has them."""
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
    initial_policy: str | None = None
    """Run whose policy training begins with. It is a run directory or a name of `reachlab list`; without it the first
    policy is an untrained one."""


@dataclass(frozen=True)
class PPOConfig(Checked):
    """Proximal policy optimisation."""

    epochs: Annotated[int, Range(1, 1000)] = 8
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
    """Weight of the value loss; 0: there is no critic, and an action is judged by what was paid after it, with a
    `gae_lambda` of 1 by all of it."""
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
    """Task preset, which sets the other defaults: clutter, clutter_pose, lift, place, pose, precise, push, slide, track
    or tutorial."""
    robot: str = "iiwa14"
    """Robot: gen3, iiwa14, panda, so101, ur5e, xarm7, or the path of an MJCF or URDF file; see `reachlab robot`."""
    base: str | None = None
    """Body of the robot's file that holds the arm; joints before it are locked. By default its first."""
    package: Annotated[tuple[str, ...], Length(64)] = ()
    """Folders of ROS packages that the robot's file names, as NAME=FOLDER."""
    sim: str = "kinematic"
    """Simulator: kinematic, mujoco or pybullet."""
    seed: Seed = 0
    """Seed of everything random."""
    randomise: Annotated[tuple[str, ...], Length(8)] = ()
    """What varies from episode to episode in training; the report is without it. `dynamics`: in MuJoCo servo gains
    within 15 %, joint damping within 30 % and a payload of 0 to 2 kg at the tool, and everywhere joints measured with
    noise of 0.5 mrad and 0.01 rad/s. `delay`: measurements are a control period old and up to 10 ms more, and 5 % of
    them do not come. `lag`: in MuJoCo joints follow a fifth to one and a half times as late as usual, which is by 0.1 s
    of most arms. `view`: light, colours and the camera's pose within 2 cm and 2 degrees. `objects`: their mass from 0.3
    to 3 times, friction from 0.3 to 1, size within 25 %; all an episode they are measured up to 5 mm and 5 degrees off.
    `sight`: they are seen one to three steps late, and a tenth of the sights do not come."""
    imports: Annotated[tuple[str, ...], Length(64)] = ()
    """Extensions that the run needs, modules or files; see `extensions.import_extension`."""
    rules: TaskSettings = field(default_factory=TaskSettings)
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
    return Path(robot).suffix.lower() in (".xml", ".urdf")


@dataclass(frozen=True)
class DaggerConfig(Checked):
    """Learning from camera pictures, by a teacher that gets the positions themselves (DAgger)."""

    guided: NonNegativeInt = 8
    """Iterations at the start in which the teacher acts, before the student does."""
    noise: NonNegative = 0.2
    """Noise of the actions, to learn to come back: standard deviation, where 1 is half the range of an action."""
    updates: Annotated[int, Range(1, 10**5)] = 48
    """Gradient steps of an iteration."""
    batch: Annotated[int, Range(1, 10**5)] = 256
    """Pictures of a gradient step."""
    capacity: Annotated[int, Range(1, 10**6)] = 60_000
    """Pictures that are kept to learn from, of 7 kB each."""
    place_weight: NonNegative = 4.0
    """Weight of predicting where target, tool and bodies are, beside that of predicting the action."""


@dataclass(frozen=True)
class RecordConfig(Checked):
    """Which episodes a dataset holds, and their pictures."""

    episodes: Count = 100
    """Episodes to record; none of them is one of an evaluation, whatever its seed."""
    cameras: tuple[str, ...] = ("front",)
    """Cameras whose pictures are recorded, see `reachlab list cameras`; `--cameras` alone for none."""
    size: Annotated[int, Range(*PICTURE_SIDES)] = 96
    """Height and width of pictures, an even number [pixels]."""
    seed: Seed = 0
    """Seed of the targets."""
    failures: bool = False
    """Record episodes without success too."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.size % 2:
            raise InputError(f"size must be even, for the colours of a film, got {self.size}.")


@dataclass(frozen=True)
class DistilRunConfig(RunConfig):
    """Everything that decides a distillation; it uses nothing of `ppo`."""

    verb: ClassVar[str] = "distil"
    method: ClassVar[str] = "dagger"

    teacher: str = ""
    """Run directory of the teacher."""
    teacher_observation: str = "target+tool"
    """What the teacher observes."""
    teacher_action: str = "tool_delta"
    """What the teacher's actions move."""
    teacher_hidden: tuple[int, ...] | None = None
    """Widths of the teacher's hidden layers; None where they are the student's, as in runs of earlier versions."""
    dagger: DaggerConfig = field(default_factory=DaggerConfig)
