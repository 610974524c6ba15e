"""Every setting of a run: frozen dataclasses, presets, and their JSON form.

A setting is one field with its unit and meaning below it. The command line, the keywords of
`gymnasium.make` and `config.json` are all read from these classes, so field names are unique among
them. This module imports nothing heavy.
"""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

from reachlab.settings.validation import (
    Checked,
    Count,
    Fraction,
    InputError,
    Length,
    NonNegative,
    NonNegativeInt,
    Point,
    Positive,
    Range,
    Seed,
    Steps,
    choose,
    hints,
)


@dataclass(frozen=True)
class TaskConfig(Checked):
    """The rules of the reach task."""

    tool: str | None = None
    """Tool frame: a site or body of the robot whose position has to reach the target; by default the robot's own."""
    observation: str = "target+tool"
    """What the policy observes; see `reachlab list`."""
    action: str = "tool_delta"
    """What the policy commands; see `reachlab list`."""
    reward: str = "dense"
    """Reward; see `reachlab list`."""
    clip_actions: bool = True
    """Clip actions to their box. The tutorial's own code does not."""
    tool_scale: Positive = 0.005
    """Displacement of the tool for an action of 1 with `tool_delta` [m]."""
    joint_scale: Positive = 0.02
    """Displacement of a joint for an action of 1 with `joint_delta` [rad or m]."""
    success_distance: Positive = 0.1
    """Tool to target within this distance is a success [m]."""
    at_goal: str = "end"
    """What happens at the target. `end`: success ends the episode. `continue`: the policy acts until the time limit,
    and success is judged on the last step. `hold`: as `continue`, but while the tool is within the success distance the
    joint command stays as it is, so that the arm rests there; it acts again when the tool is outside."""
    max_steps: Count = 1000
    """An episode is truncated on this step."""
    approach_weight: NonNegative = 5.0
    """Reward of the `dense` reward for each metre that the tool comes closer [1/m]."""
    targets: str = "table"
    """Where targets are drawn: `table`, or `box`."""
    target_height: Annotated[float, Range(-10.0, 10.0)] = -0.0083
    """Height of the targets on the table [m]; the tutorial's object settles there."""
    target_low: Point = (0.3, -0.4, 0.1)
    """Lower corner of the box of targets [m]."""
    target_high: Point = (0.7, 0.4, 0.6)
    """Upper corner of the box of targets [m]."""
    start_noise: NonNegative = 0.0
    """Episodes start with every joint within this of its home [rad or m]."""
    hold_steps: NonNegativeInt = 0
    """Success is that the tool was within the success distance, and the joints slow, for so many steps in a row; with
    0, touching the target is enough, and leaving the workspace ends the episode."""
    hold_speed: Positive = 0.05
    """Joint speed below which the tool counts as held [rad/s or m/s]."""
    closeness_weight: NonNegative = 0.2
    """Reward of the `precise` reward for a step at the target itself, and as much again for being still there."""
    closeness_scale: Positive = 0.01
    """Distance at which that reward has fallen to about a half [m]."""
    effort_weight: NonNegative = 0.01
    """Penalty of the `precise` reward for a step with actions of 1."""


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
    perturb: bool = False
    """Vary the arm from episode to episode, and measure joints with noise of 0.5 mrad and 0.01 rad/s: in MuJoCo, servo
    gains within 15 %, joint damping within 30 %, and a payload of 0 to 2 kg at the tool."""
    randomise_view: bool = False
    """Vary light, colours and the camera's pose (within 2 cm and 2 degrees) from episode to episode of training; the
    report is without that."""


@dataclass(frozen=True)
class PPOConfig(Checked):
    """Training by PPO (proximal policy optimisation)."""

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
    epochs: Count = 8
    """Passes over a rollout."""
    minibatches: Count = 2
    """Parts of a rollout, one gradient step each."""
    learning_rate: Positive = 1e-3
    """Learning rate of Adam at the start."""
    final_learning_rate: NonNegative = 1e-4
    """Learning rate after `anneal_steps`; it falls on a straight line."""
    anneal_steps: Steps = 2_000_000
    """Environment steps over which the learning rate falls."""
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
    max_grad_norm: Positive = 0.5
    """The gradient of all parameters together is shortened to this norm."""
    hidden: Annotated[tuple[Count, ...], Length(16)] = (64, 64)
    """Widths of the hidden layers of actor and critic."""
    initial_std: Positive = 0.4
    """Noise of the actions at the start: standard deviation, where 1 is half the range of an action."""
    final_std: Positive | None = None
    """The same after `anneal_steps`, with the logarithm falling on a straight line; without it the noise is learnt."""
    checkpoint_interval: NonNegative = 20.0
    """Time from one checkpoint to the next [s]; longer if saving took more than 2 % of it, and 0 saves always."""
    keep_checkpoints: Count = 3
    """Newest checkpoints that are kept; the best one is kept too."""
    randomise: bool = False
    """Train with `perturb`; the report is without it."""
    deterministic: bool = False
    """Compute on one thread: the same weights on any number of cores."""

    @property
    def iteration_steps(self) -> int:
        """Environment steps of an iteration."""
        return self.num_envs * self.rollout_steps * self.action_repeat


@dataclass(frozen=True)
class RunConfig(Checked):
    """Everything that decides a training run."""

    verb: ClassVar[str] = "train"
    """Command that makes such a run."""

    task: str = "tutorial"
    """Task preset; it sets the other defaults."""
    robot: str = "iiwa14"
    """Robot: a name of `reachlab list`, or the path of an MJCF or URDF file."""
    sim: str = "kinematic"
    """Simulator."""
    seed: Seed = 0
    """Seed of everything random."""
    rules: TaskConfig = field(default_factory=TaskConfig)
    physics: SimConfig = field(default_factory=SimConfig)
    ppo: PPOConfig = field(default_factory=PPOConfig)

    def __post_init__(self) -> None:
        """Check every field, and remember a robot's file so that it is found from any folder."""
        super().__post_init__()
        if is_robot_file(self.robot):
            object.__setattr__(self, "robot", str(Path(self.robot).absolute()))


def is_robot_file(robot: str) -> bool:
    """Whether a robot is named by the path of its model file, rather than by its name in the table."""
    return Path(robot).suffix in (".xml", ".urdf")


@dataclass(frozen=True)
class DistilConfig(Checked):
    """Learning from camera pictures, by a teacher that gets the positions themselves."""

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
    """Everything that decides a distillation; of `ppo` it uses the loop's settings and the networks'."""

    verb: ClassVar[str] = "distil"

    teacher: str = ""
    """Run directory of the teacher."""
    teacher_observation: str = "target+tool"
    """What the teacher sees."""
    distil: DistilConfig = field(default_factory=DistilConfig)


DISTIL_DEFAULTS: dict[str, Any] = {
    "total_steps": 40 * 4096,
    "stop_early": False,
    "num_envs": 128,
    "rollout_steps": 8,
    "action_repeat": 4,
    "report_episodes": 200,
    "learning_rate": 3e-3,
    "final_learning_rate": 1e-4,
    "max_grad_norm": 1.0,
}
"""Settings of the loop with which a distillation starts."""


def distillation(teacher: str, taught: RunConfig, **settings: Any) -> DistilRunConfig:
    """Configuration of a student of the teacher in the run directory `teacher`, which was trained as `taught`.

    Raises:
        InputError: a name that is no setting, or a value that is not allowed.
    """
    parts = {entry.name: getattr(taught, entry.name) for entry in dataclasses.fields(RunConfig)}
    settings = {"observation": "image", **DISTIL_DEFAULTS} | settings
    settings.setdefault("anneal_steps", settings["total_steps"])
    return override(DistilRunConfig(**parts, teacher=teacher, teacher_observation=taught.rules.observation), **settings)


TASKS: dict[str, RunConfig] = {
    "tutorial": RunConfig(),
    "precise": RunConfig(
        task="precise",
        sim="mujoco",
        rules=TaskConfig(
            tool="flange",
            observation="state",
            action="joint_residual",
            reward="precise",
            approach_weight=15.0,
            effort_weight=0.003,
            success_distance=0.01,
            at_goal="continue",
            max_steps=100,
            targets="box",
            start_noise=0.3,
            hold_steps=10,
        ),
        physics=SimConfig(control_period=0.02),
        ppo=PPOConfig(
            total_steps=4_000_000,
            stop_early=False,
            report_episodes=2000,
            num_envs=256,
            rollout_steps=100,
            epochs=4,
            minibatches=4,
            gamma=0.93,
            hidden=(128, 128),
            final_std=0.1,
            randomise=True,
            learning_rate=3e-3,
            final_learning_rate=1e-5,
            anneal_steps=4_000_000,
        ),
    ),
}
"""Presets by name: `--task` starts from one of them and flags change it."""


SIM_DEFAULTS: dict[str, dict[str, Any]] = {
    "mujoco": {"control_period": 0.02, "validation_episodes": 1000},
    "pybullet": {"num_envs": 16, "rollout_steps": 256, "validation_episodes": 200},
}
"""Settings that a simulator changes in every preset: where time is real a command takes longer to be followed, and
a PyBullet lane is a client of its own."""


Config = TypeVar("Config", bound=RunConfig)


PICTURE_DEFAULTS: dict[str, Any] = {
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
"""Settings that pictures change where touching the target is enough: each costs a hundred times a step without one."""

REWARD_DEFAULTS: dict[str, dict[str, Any]] = {
    "sparse": {"action_repeat": 8, "gamma": 0.9, "anneal_steps": 8_000_000},
}
"""Settings that a reward changes there: where success alone pays, its credit has a long way back."""

UNAIDED_DEFAULTS: dict[str, Any] = {
    "effort_weight": 0.1,
    "gamma": 0.97,
    "learning_rate": 1e-3,
    "total_steps": 4_500_000,
    "anneal_steps": 4_500_000,
}
"""Settings of a policy that has to hold the tool and is not helped by inverse kinematics: it learns more slowly."""

PICTURED = ("image", "image+tool")
"""Observations with a picture in them."""


def in_simulator(config: Config, sim: str) -> Config:
    """A configuration in another simulator, with that one's defaults; a control period of one's own is kept."""
    if sim == config.sim:
        return config
    usual = {"control_period": TASKS[config.task].physics.control_period}
    here, there = (usual | SIM_DEFAULTS.get(name, {}) for name in (config.sim, sim))
    if config.physics.control_period != here["control_period"]:
        there["control_period"] = config.physics.control_period
    return override(config, sim=sim, **there)


CHOICES = ("sim", "observation", "action", "reward")
"""Settings that change the defaults of others."""


def preset(
    task: str = "tutorial",
    sim: str | None = None,
    observation: str | None = None,
    action: str | None = None,
    reward: str | None = None,
) -> RunConfig:
    """The preset of that name, with the defaults that follow from other choices than its own; see `CHOICES`."""
    config = TASKS[choose("task", task, TASKS)]
    config = config if sim is None else in_simulator(config, sim)
    if config.rules.hold_steps:  # an action that is held goes past what has to be held
        return config if action in (None, config.rules.action) else override(config, **UNAIDED_DEFAULTS)
    pictures = PICTURE_DEFAULTS if observation in PICTURED else {}
    return override(config, **(REWARD_DEFAULTS.get(reward or "", {}) | pictures))


def configure(task: str = "tutorial", **settings: Any) -> RunConfig:
    """Preset with the named settings changed, e.g. `configure("tutorial", reward="sparse", seed=3)`.

    Raises:
        InputError: a name that is no setting, or a value that is not allowed.
    """
    return override(preset(task, *(settings.get(name) for name in CHOICES)), **settings)


def override(config: Config, **settings: Any) -> Config:
    """A configuration with the named settings changed.

    Raises:
        InputError: a name that is no setting, or a value that is not allowed.
    """
    sections = _sections(config)
    for name in settings:
        choose("setting", name, sections)
    changed: dict[str | None, dict[str, Any]] = {}
    for name, value in settings.items():
        changed.setdefault(sections[name], {})[name] = value
    top = changed.pop(None, {})
    nested = {part: dataclasses.replace(getattr(config, part), **values) for part, values in changed.items() if part}
    return dataclasses.replace(config, **top, **nested)


def _sections(config: RunConfig) -> dict[str, str | None]:
    """For every setting but the preset's name, the part of `RunConfig` that holds it; None for itself."""
    sections: dict[str, str | None] = {}
    for outer in dataclasses.fields(config):
        value = getattr(config, outer.name)
        if dataclasses.is_dataclass(value):
            sections |= dict.fromkeys((inner.name for inner in dataclasses.fields(value)), outer.name)
        elif outer.name != "task":
            sections[outer.name] = None
    return sections


def difference(one: object, other: object) -> tuple[str, Any, Any] | None:
    """Name of the first setting in which two configurations differ, and both values; None if they are the same."""
    for entry in dataclasses.fields(typing.cast("Any", one)):
        a, b = getattr(one, entry.name), getattr(other, entry.name, None)
        if dataclasses.is_dataclass(a):
            if found := difference(a, b):
                return found
        elif a != b:
            return entry.name, a, b
    return None


def to_json(config: RunConfig) -> dict[str, Any]:
    """Plain form of the config, for `json.dump`."""
    return dataclasses.asdict(config)


def flatten(plain: Mapping[str, Any]) -> dict[str, Any]:
    """Every setting of a config's plain form by name, whatever part holds it."""
    flat: dict[str, Any] = {}
    for name, value in plain.items():
        flat |= value if isinstance(value, dict) else {name: value}
    return flat


def from_json(data: Any) -> RunConfig:
    """Config from its plain form; every field must be there, and no other.

    Raises:
        InputError: a field is missing, unknown, of the wrong type or out of range.
    """
    kind = DistilRunConfig if isinstance(data, Mapping) and "distil" in data else RunConfig
    return _build(kind, data, "the configuration")


def _build(cls: type, data: Any, where: str) -> Any:
    if not isinstance(data, Mapping):
        raise InputError(f"{where} must be an object of settings, got {type(data).__name__}.")
    fields = hints(cls)
    if unknown := sorted(set(data) - set(fields)):
        raise InputError(f"{where} holds an unknown setting {unknown[0]!r}.")
    if missing := sorted(set(fields) - set(data)):
        raise InputError(f"{where} lacks the setting {missing[0]!r}.")
    values = {}
    for name, value in data.items():
        if dataclasses.is_dataclass(fields[name]):
            values[name] = _build(typing.cast("type", fields[name]), value, f"{where}, {name},")
        else:
            values[name] = tuple(value) if isinstance(value, list) else value
    return cls(**values)
