"""PyBullet with the tutorial's scene: plane, table, arm and the object that falls."""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, cast

import numpy as np
from jax import Array

from reachlab.config import InputError, SimConfig
from reachlab.robots import Robot
from reachlab.sims import ArmState, Lanes

MAX_LANES = 16
"""Each lane is a client of its own, of about 29 MB."""

GRAVITY = -10.0
"""The tutorial's gravity [m/s²]."""

GROUND, TABLE = (0.0, 0.0, -0.65), (0.5, 0.0, -0.65)
"""Where the tutorial puts plane and table [m]."""

DROP = 0.0183
"""Height above the target from which the object is let go [m]: at z = 0.01, to settle at z = -0.0083."""

SLOW_STEP = 0.05
"""Time that a step takes to be followed by eye [s]; the tutorial's."""

CAMERA = {"cameraDistance": 1.5, "cameraYaw": 0.0, "cameraPitch": -40.0, "cameraTargetPosition": (0.55, -0.35, 0.2)}
"""The tutorial's viewer camera."""

WIDTH, HEIGHT, FIELD_OF_VIEW, NEAR, FAR = 640, 480, 60.0, 0.1, 100.0
"""Pictures: size [pixels], field of view [deg], near and far plane [m]."""


@dataclass(frozen=True)
class Urdf:
    """A robot in PyBullet's own data: its file, the link that holds the tools, and how far they lie along its z [m]."""

    file: str
    link: int
    tools: dict[str, float]


URDFS = {"iiwa14": Urdf("kuka_iiwa/model.urdf", 6, {"link_7": 0.0, "flange": 0.045})}
"""Robots that PyBullet ships, by our names."""


class PybulletSimulator:
    """The tutorial's simulator: joints are set, then the world moves on by a control period.

    Every lane has a client of its own, loaded once; a reset moves what is there.
    """

    pure = False

    def __init__(self, robot: Robot, config: SimConfig, batch_size: int) -> None:
        """Simulator of `batch_size` arms.

        Raises:
            InputError: PyBullet is not installed, has no such robot, or too many lanes or no display are there.
        """
        if batch_size > MAX_LANES:
            raise InputError(f"simulator 'pybullet' takes at most {MAX_LANES} lanes, got {batch_size}: use --lanes.")
        if robot.name not in URDFS or robot.tool not in URDFS[robot.name].tools:
            raise InputError(f"simulator 'pybullet' has no tool {robot.tool!r} of robot {robot.name!r}, only iiwa14's.")
        self._bullet = import_pybullet()
        self._period, self._pace = config.control_period, SLOW_STEP if config.slow else 0.0
        urdf = URDFS[robot.name]
        self._worlds = [
            _World(self._bullet, robot, urdf, config.control_period, gui=config.gui and lane == 0)
            for lane in range(batch_size)
        ]

    def reset(self, state: ArmState | None, q: Lanes, target: Lanes, mask: Lanes | None) -> ArmState:
        """See `Simulator.reset`."""
        wanted, points = np.asarray(q, np.float64), np.asarray(target, np.float64)
        arm = _rows(len(wanted), wanted.shape[1]) if state is None else _writable(state)
        lanes = range(len(wanted)) if state is None or mask is None else np.flatnonzero(mask)
        for lane in lanes:
            world = self._worlds[lane]
            world.drop(points[lane])
            arm[0][lane], arm[1][lane] = wanted[lane], 0.0
            arm[2][lane], arm[3][lane] = world.place(wanted[lane])
        return _arm_state(arm)

    def step(self, state: ArmState, target_q: Lanes) -> ArmState:
        """See `Simulator.step`."""
        start = time.perf_counter()
        wanted = np.asarray(target_q, np.float64)
        q, qd, position, quaternion = _rows(*wanted.shape)
        for lane, world in enumerate(self._worlds):
            world.set_joints(wanted[lane])
            self._bullet.stepSimulation(physicsClientId=world.client)
            q[lane] = world.joints()
            position[lane], quaternion[lane] = world.tool()
        qd[:] = (q - np.asarray(state.q)) / self._period
        if self._pace:
            time.sleep(max(0.0, self._pace - (time.perf_counter() - start)))
        return _arm_state((q, qd, position, quaternion))

    def render(self, state: ArmState, target: Array, lane: int) -> np.ndarray:
        """See `Simulator.render`."""
        del target
        world = self._worlds[lane]
        world.set_joints(np.asarray(state.q[lane], np.float64))
        return world.picture()

    def close(self) -> None:
        """See `Simulator.close`."""
        for world in self._worlds:
            world.close()
        self._worlds = []


class _World:
    """One client with the tutorial's scene."""

    def __init__(self, bullet: ModuleType, robot: Robot, urdf: Urdf, period: float, *, gui: bool) -> None:
        import pybullet_data

        self._bullet, self._urdf = bullet, urdf
        self._offset = np.array([0.0, 0.0, urdf.tools[robot.tool]])
        self._joints = list(range(robot.chain.n))
        self.client = _connect(bullet, gui=gui)
        here: dict[str, Any] = {"physicsClientId": self.client}
        bullet.setAdditionalSearchPath(pybullet_data.getDataPath(), **here)
        bullet.setGravity(0, 0, GRAVITY, **here)
        bullet.setTimeStep(period, **here)
        bullet.loadURDF("plane.urdf", basePosition=GROUND, **here)
        bullet.loadURDF("table/table.urdf", basePosition=TABLE, **here)
        self._arm = bullet.loadURDF(urdf.file, useFixedBase=True, **here)
        self._object = bullet.loadURDF("random_urdfs/000/000.urdf", **here)
        if gui:
            bullet.configureDebugVisualizer(bullet.COV_ENABLE_GUI, 0, **here)
            bullet.resetDebugVisualizerCamera(**CAMERA, **here)
            for start, end in robot.workspace_edges():
                bullet.addUserDebugLine(start, end, (1, 1, 1), **here)

    def drop(self, target: np.ndarray) -> None:
        """Let the object go above the target, at rest."""
        position = target + np.array([0.0, 0.0, DROP])
        self._bullet.resetBasePositionAndOrientation(self._object, position, (0, 0, 0, 1), physicsClientId=self.client)
        self._bullet.resetBaseVelocity(self._object, (0, 0, 0), (0, 0, 0), physicsClientId=self.client)

    def set_joints(self, q: np.ndarray) -> None:
        """Set the joints, at rest."""
        self._bullet.resetJointStatesMultiDof(
            self._arm, self._joints, [[value] for value in q.tolist()], physicsClientId=self.client
        )

    def joints(self) -> list[float]:
        """Joint positions as they are after the step."""
        states = self._bullet.getJointStates(self._arm, self._joints, physicsClientId=self.client)
        return [state[0] for state in states]

    def place(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Set the joints; the tool's pose."""
        self.set_joints(q)
        return self.tool()

    def tool(self) -> tuple[np.ndarray, np.ndarray]:
        """Tool position `[3]` m and quaternion `[4]` wxyz, read from PyBullet."""
        link = self._bullet.getLinkState(
            self._arm, self._urdf.link, computeForwardKinematics=True, physicsClientId=self.client
        )
        # [4] and [5] are the link's frame; [0] is its centre of mass, 2 cm away.
        position, (x, y, z, w) = np.array(link[4]), link[5]
        if self._offset.any():
            matrix = np.array(self._bullet.getMatrixFromQuaternion(link[5])).reshape(3, 3)
            position = position + matrix @ self._offset
        return position, np.array((w, x, y, z))

    def picture(self) -> np.ndarray:
        """Picture of the tutorial's viewer camera, `[HEIGHT, WIDTH, 3]` uint8."""
        bullet = self._bullet
        view = bullet.computeViewMatrixFromYawPitchRoll(
            CAMERA["cameraTargetPosition"],
            CAMERA["cameraDistance"],
            CAMERA["cameraYaw"],
            CAMERA["cameraPitch"],
            roll=0,
            upAxisIndex=2,
        )
        projection = bullet.computeProjectionMatrixFOV(FIELD_OF_VIEW, WIDTH / HEIGHT, NEAR, FAR)
        pixels = bullet.getCameraImage(
            WIDTH, HEIGHT, view, projection, renderer=bullet.ER_TINY_RENDERER, physicsClientId=self.client
        )[2]
        return np.array(pixels, np.uint8).reshape(HEIGHT, WIDTH, 4)[..., :3].copy()

    def close(self) -> None:
        """Disconnect."""
        if self._bullet.isConnected(physicsClientId=self.client):
            self._bullet.disconnect(physicsClientId=self.client)


def _rows(lanes: int, joints: int) -> list[np.ndarray]:
    """Arrays of an `ArmState`."""
    return [np.zeros((lanes, width), np.float32) for width in (joints, joints, 3, 4)]


def _arm_state(rows: Sequence[np.ndarray]) -> ArmState:
    """State of NumPy rows: what is compiled takes them in faster than JAX would convert them here."""
    return ArmState(*(cast("Array", part) for part in rows))


def _writable(state: ArmState) -> list[np.ndarray]:
    return [np.array(x) for x in (state.q, state.qd, state.tool_position, state.tool_quaternion)]


def _connect(bullet: ModuleType, *, gui: bool) -> int:
    if gui and platform.system() == "Linux" and not os.environ.get("DISPLAY"):
        raise InputError("--gui needs a display, and there is none here: run without it, or on a desktop.")
    client = bullet.connect(bullet.GUI if gui else bullet.DIRECT)
    if client < 0:
        raise InputError("PyBullet gave no connection: its window could not be opened, or too many clients are open.")
    return client


def import_pybullet() -> ModuleType:
    """The module; it prints its build time on standard output when imported, which is kept from there."""
    try:
        with _quiet_stdout():
            import pybullet
    except ImportError:
        raise InputError(
            "simulator 'pybullet' needs PyBullet: pip install 'reachlab[pybullet]' (its wheels end at Python 3.11,"
            f" this is {platform.python_version()}; with a newer one use a 3.11 environment)."
        ) from None
    return pybullet


@contextlib.contextmanager
def _quiet_stdout() -> Iterator[None]:
    sys.stdout.flush()
    kept = os.dup(1)
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 1)
        yield
    finally:
        ctypes.CDLL(None).fflush(None)  # what C has printed so far waits in its own buffer
        os.dup2(kept, 1)
        os.close(kept)
        os.close(null)
