"""The robots that come with reachlab, and where the model file of any robot is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from reachlab.robots.files.model_file import ModelFile, read_model_file
from reachlab.robots.robot import TUTORIAL_WORKSPACE, Box, PybulletModel
from reachlab.settings.config import is_robot_file
from reachlab.settings.tables import Table
from reachlab.settings.validation import InputError, choose

ASSETS = Path(__file__).parent / "assets"
"""Model files, each beside a `SOURCES.md` that says where the figures are from."""


@dataclass(frozen=True)
class KnownRobot:
    """What the catalogue knows of a robot beside its model file; what is None comes from the file or is derived.

    Attributes:
        file: MJCF or URDF file.
        title: maker and type.
        tools: tool frames, sites or bodies, by what they are; the first one unless a task asks for another.
        home: joints `[n]` in which episodes start [rad or m].
        speed: joint speed limits `[n]` [rad/s or m/s].
        torque: joint torque limits `[n]` [Nm or N].
        acceleration: limits of joint acceleration `[n]` [rad/s² or m/s²].
        jerk: limits of joint jerk `[n]` [rad/s³ or m/s³].
        workspace: box in which the tool works [m].
        goal_box: box of goals that are not on the table [m].
        held_quaternion: orientation in which the tool is held, wxyz.
        pybullet: the same robot in PyBullet's data.
        gripper: name of the one that it is given where a task needs one and nothing else is asked for.
    """

    file: Path
    title: str
    tools: Mapping[str, str]
    home: tuple[float, ...] | None = None
    speed: tuple[float, ...] | None = None
    torque: tuple[float, ...] | None = None
    acceleration: tuple[float, ...] | None = None
    jerk: tuple[float, ...] | None = None
    workspace: Box | None = None
    goal_box: Box | None = None
    held_quaternion: tuple[float, ...] | None = None
    pybullet: PybulletModel | None = None
    gripper: str = "parallel"


ROBOTS: dict[str, KnownRobot] = Table(
    {
        "iiwa14": KnownRobot(
            file=ASSETS / "iiwa14" / "iiwa14.xml",
            title="KUKA LBR iiwa 14 R820",
            tools={"wrist": "link_7", "flange": "flange"},
            workspace=TUTORIAL_WORKSPACE,
            goal_box=((0.3, -0.4, 0.1), (0.7, 0.4, 0.6)),
            # Euler angles (0, -π, π/2) of the tutorial: the tool points down, turned a quarter about the vertical.
            held_quaternion=(0.0, 0.5**0.5, -(0.5**0.5), 0.0),
            pybullet=PybulletModel("kuka_iiwa/model.urdf", 6, {"link_7": 0.0, "flange": 0.045}),
        ),
        "panda": KnownRobot(
            file=ASSETS / "panda" / "panda.xml",
            title="Franka Emika Panda",
            tools={"flange": "flange"},
            acceleration=(15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
            jerk=(7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0),
            workspace=((0.27, -0.29, 0.0), (0.67, 0.29, 0.54)),
            goal_box=((0.25, -0.4, 0.1), (0.6, 0.4, 0.6)),
        ),
        "ur5e": KnownRobot(
            file=ASSETS / "ur5e" / "ur5e.xml",
            title="Universal Robots UR5e",
            tools={"flange": "flange"},
            workspace=((0.18, -0.3, 0.0), (0.68, 0.3, 0.55)),
            goal_box=((0.25, -0.4, 0.1), (0.65, 0.4, 0.6)),
        ),
        "xarm7": KnownRobot(
            file=ASSETS / "xarm7" / "xarm7.xml",
            title="UFACTORY xArm 7",
            tools={"flange": "flange"},
            workspace=((0.17, -0.29, 0.0), (0.59, 0.29, 0.5)),
            goal_box=((0.15, -0.3, 0.05), (0.55, 0.3, 0.5)),
        ),
        "gen3": KnownRobot(
            file=ASSETS / "gen3" / "gen3.xml",
            title="Kinova Gen3 with seven joints",
            tools={"flange": "end_effector"},
            acceleration=(5.2, 5.2, 5.2, 5.2, 10.0, 10.0, 10.0),
            workspace=((0.22, -0.29, 0.0), (0.64, 0.29, 0.42)),
            goal_box=((0.25, -0.4, 0.1), (0.65, 0.4, 0.6)),
        ),
        "so101": KnownRobot(
            file=ASSETS / "so101" / "so101.xml",
            title="SO-101 of The Robot Studio, with five joints",
            tools={"flange": "gripper_frame"},
            gripper="own",
            workspace=((0.16, -0.08, 0.0), (0.35, 0.08, 0.15)),
            goal_box=((0.15, -0.16, 0.05), (0.32, 0.16, 0.25)),
        ),
    }
)
"""Robots by name. Adding one takes its record here and its assets."""


def find_model_file(name: str, packages: Sequence[str] = ()) -> ModelFile:
    """Model file of a robot, as it is now.

    Args:
        name: name in `ROBOTS` or path of a file.
        packages: where ROS packages are that the file names, each as `NAME=FOLDER`.

    Raises:
        InputError: unknown name, or missing or broken file.
    """
    if name not in ROBOTS and not is_robot_file(name):
        _refuse_other_file(Path(name))
        titles = {known: robot.title for known, robot in ROBOTS.items()}
        choose("robot", name, [*ROBOTS, "a path to an .xml or .urdf file"], titles)
    return read_model_file(ROBOTS[name].file if name in ROBOTS else Path(name).absolute(), _folders(packages))


def _refuse_other_file(file: Path) -> None:
    """Refuse a file that is there, and is of another kind than those that are read."""
    if file.is_file():
        stem = file.name.removesuffix(".xacro").removesuffix(".urdf")
        how = f"expand it with `xacro {file.name} > {stem}.urdf`" if file.suffix == ".xacro" else "convert it to URDF"
        raise InputError(f"robot '{file}' is no .urdf or .xml file, URDF or MJCF, which are read: {how}.")


def _folders(packages: Sequence[str]) -> dict[str, Path]:
    """Folders of packages by name, of `NAME=FOLDER`."""
    pairs = [package.partition("=") for package in packages]
    for name, _, folder in pairs:
        if not name or not folder or not Path(folder).is_dir():
            raise InputError(f"a package is NAME=FOLDER with a folder that exists, got {name}={folder}.")
    return {name: Path(folder) for name, _, folder in pairs}
