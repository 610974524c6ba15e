"""Loading of robots: from the catalogue, or from a model file of one's own."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import mujoco

from reachlab.robots.catalogue import ROBOTS, KnownRobot
from reachlab.robots.chain import Chain, chain_from_model
from reachlab.robots.joint_limits import speed_limits, torque_limits
from reachlab.robots.robot import CATALOGUE, DEFAULT, DERIVED, FILE, Robot
from reachlab.robots.workspace import held_quaternion, reachable_box
from reachlab.settings.config import is_robot_file
from reachlab.settings.validation import InputError, choose

DEFAULT_SPEED = 1.5
"""Joint speed limit where none is known [rad/s or m/s]; slow for an industrial arm."""

T = TypeVar("T")


def load_robot(name: str, tool: str | None = None, *, kind: str | None = None) -> Robot:
    """Robot of the catalogue, or of an MJCF (.xml) or URDF (.urdf) file, with a tool frame.

    A file of one's own states what MuJoCo has no place for as `<numeric name="speed_limit">`, and its home
    joints as keyframe `home`; without them, home is the middle of the joint limits. Its workspace is the box
    around the middle 80 % of the points that the tool reaches, above the floor.

    Args:
        name: name in `ROBOTS` or path of a file.
        tool: site or body; by default the catalogue's, or of a file its only site, else its last body.
        kind: which of the catalogue's tool frames it is by default, see `KnownRobot.tools`; the first one without.

    Raises:
        InputError: unknown name or tool, missing or broken file, or an arm without hinge and slide joints.
    """
    known = ROBOTS.get(name)
    if known is None and not is_robot_file(name):
        choose("robot", name, [*ROBOTS, "a path to an .xml or .urdf file"])
    if known and not tool:
        tool = known.tools.get(kind or "") or next(iter(known.tools.values()))
    return _load(name, tool)


@functools.cache
def _load(name: str, tool: str | None) -> Robot:
    known = ROBOTS.get(name)
    file = known.file if known else Path(name)
    model = _compile(file)
    tool = tool or _own_tool(model)
    if not tool:
        raise InputError(f"robot file {str(file)!r} does not name its last body: say which site or body is the --tool.")
    try:
        chain = chain_from_model(model, tool)
    except ValueError as error:
        raise InputError(f"robot {name!r}: {error}.") from None
    listed = known or KnownRobot(file, "", {})
    sources: dict[str, str] = {}

    def figure(what: str, listed: T | None, read: Callable[[], T | None], otherwise: tuple[str, Callable[[], T]]) -> T:
        """What the catalogue lists, else what can be read in the file, else what is derived; the source is noted."""
        if listed is not None:
            sources[what] = CATALOGUE
            return listed
        found = read()
        sources[what] = otherwise[0] if found is None else FILE
        return otherwise[1]() if found is None else found

    n = chain.n
    home = figure("home", listed.home, lambda: _keyframe(model, chain), (DERIVED, lambda: _middle(chain)))
    workspace = figure("workspace", listed.workspace, _not_in_files, (DERIVED, lambda: reachable_box(chain)))
    return Robot(
        name=name if known else file.stem,
        file=file,
        tool=tool,
        chain=chain,
        home=home,
        speed=figure("speed", listed.speed, lambda: speed_limits(model, n), (DEFAULT, lambda: (DEFAULT_SPEED,) * n)),
        torque=figure(
            "torque", listed.torque, lambda: torque_limits(model, chain.joints), (DEFAULT, lambda: (float("inf"),) * n)
        ),
        workspace=workspace,
        goal_box=figure("goal_box", listed.goal_box, _not_in_files, (DERIVED, lambda: workspace)),
        held_quaternion=figure(
            "held_quaternion", listed.held_quaternion, _not_in_files, (DERIVED, lambda: held_quaternion(chain, home))
        ),
        sources=sources,
        pybullet=listed.pybullet,
    )


def _not_in_files() -> None:
    """What no model file has a place for."""


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


def _keyframe(model: mujoco.MjModel, chain: Chain) -> tuple[float, ...] | None:
    """Joints of the keyframe `home`, if there is one."""
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
    return tuple(float(model.key_qpos[key, model.jnt_qposadr[i]]) for i in chain.joints) if key >= 0 else None


def _middle(chain: Chain) -> tuple[float, ...]:
    lower, upper = chain.finite_limits()
    return tuple(((lower + upper) / 2).tolist())
