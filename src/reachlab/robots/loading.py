"""Robots: a record read from a compiled model, and the table of those that come with reachlab."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import mujoco
import numpy as np

from reachlab.robots.chain import Chain, chain_from_model
from reachlab.robots.kinematics import forward_kinematics
from reachlab.settings.config import is_robot_file
from reachlab.settings.validation import InputError, choose

ASSETS = Path(__file__).parent / "assets"

DEFAULT_SPEED = 1.5
"""Joint speed limit where a model states none [rad/s or m/s]; slow for an industrial arm."""

WORKSPACE_SAMPLES = 4096
"""Random joint vectors from which the workspace of an unknown arm is estimated."""

Box = tuple[tuple[float, ...], tuple[float, ...]]


@dataclass(frozen=True)
class Robot:
    """A serial arm and one of its tool frames.

    Attributes:
        name: name in `ROBOTS`, or the file's stem.
        file: MJCF or URDF file.
        tool: the tool frame, a site or a body.
        chain: joints from the world to the tool, with their position limits [rad or m].
        home: joint vector `[n]` in which episodes start [rad or m].
        speed: joint speed limits `[n]` [rad/s or m/s].
        torque: joint torque limits `[n]` [Nm or N]; infinite where the model states none.
        workspace: lower and upper corner of the box in which the tool works [m].
        held_quaternion: orientation in which the tool is held, wxyz.
    """

    name: str
    file: Path
    tool: str
    chain: Chain
    home: tuple[float, ...]
    speed: tuple[float, ...]
    torque: tuple[float, ...]
    workspace: Box
    held_quaternion: tuple[float, ...]

    def workspace_edges(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The twelve edges of the workspace box, each from one corner to another [m]."""
        corners = np.array(list(itertools.product(*zip(*self.workspace, strict=True))))
        return [(a, b) for a, b in itertools.combinations(corners, 2) if np.count_nonzero(a != b) == 1]


@dataclass(frozen=True)
class KnownRobot:
    """What the table knows of a robot beyond its model file."""

    file: Path
    tools: tuple[str, ...]
    workspace: Box
    held_quaternion: tuple[float, ...]
    sources: str


ROBOTS: dict[str, KnownRobot] = {
    "iiwa14": KnownRobot(
        file=ASSETS / "iiwa14" / "iiwa14.xml",
        tools=("link_7", "flange"),
        workspace=((0.2, -0.3, 0.0), (0.7, 0.3, 0.55)),
        # Euler angles (0, -π, π/2) of the tutorial: the tool points down, turned a quarter about the vertical.
        held_quaternion=(0.0, 0.5**0.5, -(0.5**0.5), 0.0),
        sources="assets/iiwa14/SOURCES.md",
    )
}
"""Robots that come with reachlab. Adding one takes its record here and its assets."""


def load_robot(name: str, tool: str | None = None) -> Robot:
    """Robot of the table, or of an MJCF (.xml) or URDF (.urdf) file, with a tool frame.

    A file of one's own states what MuJoCo has no place for as `<numeric name="speed_limit">`, and its home
    joints as keyframe `home`; without them, home is the middle of the joint limits. Its workspace is the box
    around the middle 80 % of the points that the tool reaches, above the floor.

    Args:
        name: name in `ROBOTS` or path of a file.
        tool: site or body; by default the robot's first tool frame, or of a file its only site, else its last body.

    Raises:
        InputError: unknown name or tool, missing or broken file, or an arm without hinge and slide joints.
    """
    return _load(name, tool)


@functools.cache
def _load(name: str, tool: str | None) -> Robot:
    known = ROBOTS.get(name)
    if known is None and not is_robot_file(name):
        choose("robot", name, [*ROBOTS, "a path to an .xml or .urdf file"])
    file = known.file if known else Path(name)
    model = _compile(file)
    tool = tool or (known.tools[0] if known else _own_tool(model))
    if not tool:
        raise InputError(f"robot file {str(file)!r} does not name its last body: say which site or body is the --tool.")
    try:
        chain = chain_from_model(model, tool)
    except ValueError as error:
        raise InputError(f"robot {name!r}: {error}.") from None
    home = _home(model, chain)
    return Robot(
        name=name if known else file.stem,
        file=file,
        tool=tool,
        chain=chain,
        home=home,
        speed=_speeds(model, chain.n),
        torque=_torques(model, chain.joints),
        workspace=known.workspace if known else _workspace(chain),
        held_quaternion=known.held_quaternion if known else _tool_quaternion(chain, home),
    )


def _own_tool(model: mujoco.MjModel) -> str:
    """The only site of a model, else its last body; empty where that has no name."""
    return str(model.site(0).name if model.nsite == 1 else "") or str(model.body(model.nbody - 1).name)


def _compile(file: Path) -> mujoco.MjModel:
    if not file.is_file():
        raise InputError(f"robot file {str(file)!r} does not exist: put it there, or train with another --robot.")
    try:
        return mujoco.MjSpec.from_file(str(file)).compile()
    except ValueError as error:
        why = " ".join(str(error).split())
        if "package:" in why:
            why += ": meshes named as package:// are not found yet; name them relative to the file"
        raise InputError(f"robot file {str(file)!r} does not compile: {why.rstrip('.')}.") from None


def _home(model: mujoco.MjModel, chain: Chain) -> tuple[float, ...]:
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
    if key >= 0:
        return tuple(float(model.key_qpos[key, model.jnt_qposadr[i]]) for i in chain.joints)
    lower, upper = chain.finite_limits()
    return tuple(((lower + upper) / 2).tolist())


def _speeds(model: mujoco.MjModel, n: int) -> tuple[float, ...]:
    numeric = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, "speed_limit")
    if numeric < 0:
        return (DEFAULT_SPEED,) * n
    speeds = model.numeric("speed_limit").data
    if len(speeds) != n:
        raise InputError(f"numeric 'speed_limit' has {len(speeds)} entries, the arm {n} joints; give one for each.")
    return tuple(float(speed) for speed in speeds)


def _torques(model: mujoco.MjModel, ids: Sequence[int]) -> tuple[float, ...]:
    torques = dict.fromkeys(ids, float("inf"))
    for actuator in range(model.nu):
        joint = int(model.actuator_trnid[actuator, 0])
        if joint in torques and model.actuator_forcelimited[actuator]:
            torques[joint] = float(model.actuator_forcerange[actuator, 1])
    return tuple(torques.values())


def _workspace(chain: Chain) -> Box:
    lower, upper = chain.finite_limits()
    q = jnp.asarray(np.random.default_rng(0).uniform(lower, upper, (WORKSPACE_SAMPLES, chain.n)), jnp.float32)
    points = np.asarray(forward_kinematics(chain, q).position)
    low, high = np.quantile(points, (0.1, 0.9), axis=0)
    low[2] = min(max(low[2], 0.0), high[2])
    return tuple(low.tolist()), tuple(high.tolist())


def _tool_quaternion(chain: Chain, home: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(np.asarray(forward_kinematics(chain, jnp.asarray(home, jnp.float32)).quaternion).tolist())
