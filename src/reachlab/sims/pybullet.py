"""PyBullet with the tutorial's scene: plane, table, arm and the object that falls."""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import sys
import time
from collections.abc import Iterator
from types import ModuleType
from typing import Any, NoReturn, cast

import jax
import numpy as np
from jax import Array

from reachlab.render.marks import Marks
from reachlab.render.view_randomisation import FAR, FIELD_OF_VIEW, NEAR, Views, greys
from reachlab.robots.catalogue import ROBOTS
from reachlab.robots.robot import PybulletModel, Robot
from reachlab.settings.config import SimConfig
from reachlab.settings.validation import InputError
from reachlab.sims import SIMULATORS, ArmState, BatchArray, Kind
from reachlab.tasks.observations import SIZE
from reachlab.tasks.task import Goal

GRAVITY = -10.0
"""The tutorial's gravity [m/s²]."""

GROUND, TABLE = (0.0, 0.0, -0.65), (0.5, 0.0, -0.65)
"""Where the tutorial puts plane and table [m]."""

DROP = 0.0183
"""Height above the target from which the object is let go [m]: at z = 0.01, to settle at z = -0.0083."""

SETTLED_SPEED, SETTLED_SPIN, SETTLED_STEPS = 0.01, 0.1, 10
"""An object slower than this [m/s, rad/s] for so many steps has settled; contact with it is most of a step's time."""

SLOW_STEP = 0.05
"""Time that a step takes to be followed by eye [s]; the tutorial's."""

CAMERA = {"cameraDistance": 1.5, "cameraYaw": 0.0, "cameraPitch": -40.0, "cameraTargetPosition": (0.55, -0.35, 0.2)}
"""The tutorial's viewer camera."""

WIDTH, HEIGHT = 640, 480
"""Size of the viewer camera's pictures [pixels]; its lens is the observation camera's."""

LAMP_DISTANCE = 2.0
"""How far the lamp is from the scene [m]."""


class PybulletSimulator:
    """The tutorial's simulator: joints are set, then the world moves on by a control period.

    Every environment has a client of its own, loaded once; a reset moves what is there.
    """

    kind: Kind = "host"

    def __init__(self, robot: Robot, config: SimConfig, num_envs: int, *, randomise_dynamics: bool = False) -> None:
        """Simulator of `num_envs` arms.

        Raises:
            InputError: PyBullet is not installed, has no such robot or no display, or there are too many environments.
        """
        del randomise_dynamics
        most = SIMULATORS["pybullet"].most_envs or num_envs  # each is a client of its own, of about 29 MB
        if num_envs > most:
            raise InputError(f"simulator 'pybullet' holds at most {most} environments, got {num_envs}: use --num-envs.")
        urdf = robot.pybullet
        if urdf is None or robot.tool not in urdf.tools:
            known = ", ".join(name for name, one in ROBOTS.items() if one.pybullet)
            raise InputError(
                f"simulator 'pybullet' has no tool {robot.tool!r} of robot {robot.name!r}: it knows {known}."
            )
        self._bullet = import_pybullet()
        self._period, self._pace = config.control_period, SLOW_STEP if config.slow else 0.0
        self._offset = urdf.tools[robot.tool]
        self.lag = (0.0,) * robot.chain.n
        self._worlds = [
            _World(self._bullet, robot, urdf, config.control_period, gui=config.gui and index == 0)
            for index in range(num_envs)
        ]

    def __deepcopy__(self, memo: dict[int, Any]) -> NoReturn:
        """Refuse to be copied: the falling objects are in PyBullet alone."""
        del memo
        raise InputError("an environment in 'pybullet' cannot be copied: make another, or choose another simulator.")

    @property
    def _open_worlds(self) -> list[_World]:
        """The clients of all environments.

        Raises:
            InputError: they are closed.
        """
        if not self._worlds:
            raise InputError("the environment is closed: make another.")
        return self._worlds

    def reset(
        self,
        state: ArmState | None,
        q: BatchArray,
        goal: Goal,
        mask: BatchArray | None,
        dynamics: BatchArray | None = None,
    ) -> ArmState:
        """See `Simulator.reset`."""
        del dynamics
        wanted, points = np.asarray(q, np.float32), np.asarray(goal.position, np.float64)
        chosen = np.ones(len(wanted), bool) if state is None or mask is None else np.asarray(mask)
        for index in np.flatnonzero(chosen):
            self._open_worlds[index].drop(points[index])
            self._open_worlds[index].set_joints(wanted[index])
        now = self._arm(wanted, np.zeros_like(wanted))
        if state is None:
            return now
        return jax.tree.map(lambda new, old: np.where(chosen[:, None], new, old), now, state)

    def step(self, state: ArmState, target_q: BatchArray) -> ArmState:
        """See `Simulator.step`."""
        start = time.perf_counter()
        for world in self._open_worlds:
            world.step()
        # Only now are the commands waited for: they may have been under way beside the falling objects.
        q = np.asarray(target_q, np.float32)
        for world, joints in zip(self._open_worlds, q, strict=True):
            world.set_joints(joints)
        if self._pace:
            time.sleep(max(0.0, self._pace - (time.perf_counter() - start)))
        return self._arm(q, (q - np.asarray(state.q)) / self._period)

    def _arm(self, q: np.ndarray, qd: np.ndarray) -> ArmState:
        """State of NumPy rows: what is compiled takes them in faster than JAX would convert them here."""
        positions, quaternions = zip(*(world.link() for world in self._open_worlds), strict=True)
        position, quaternion = np.array(positions, np.float32), np.array(quaternions, np.float32)[:, [3, 0, 1, 2]]
        if self._offset:
            w, x, y, z = quaternion.T
            position += self._offset * np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], 1)
        return ArmState(*(cast("Array", rows) for rows in (q, qd, position, quaternion)))

    def render(self, state: ArmState, goal: Goal, index: int, marks: Marks) -> np.ndarray:
        """See `Simulator.render`."""
        del goal, marks
        world = self._open_worlds[index]
        world.set_joints(np.asarray(state.q[index]))
        return world.picture()

    def render_observations(self, q: np.ndarray, goal: Goal, views: Views, indices: np.ndarray) -> np.ndarray:
        """See `Simulator.render_observations`; the object is drawn where it lies, and colours are PyBullet's own."""
        del goal
        out = np.empty((len(q), SIZE, SIZE), np.uint8)
        for i, index in enumerate(indices):
            self._open_worlds[index].set_joints(q[i])
            out[i] = self._open_worlds[index].observation(Views(*(x[i] for x in views)))
        return out

    def close(self) -> None:
        """See `Simulator.close`."""
        for world in self._worlds:
            world.close()
        self._worlds = []


class _World:
    """One client with the tutorial's scene."""

    def __init__(self, bullet: ModuleType, robot: Robot, urdf: PybulletModel, period: float, *, gui: bool) -> None:
        import pybullet_data

        self._bullet, self._urdf = bullet, urdf
        self._joints = list(range(robot.chain.n))
        self._still = 0
        self.client = _connect(bullet, gui=gui)
        here: dict[str, Any] = {"physicsClientId": self.client}
        bullet.setAdditionalSearchPath(pybullet_data.getDataPath(), **here)
        bullet.setGravity(0, 0, GRAVITY, **here)
        bullet.setTimeStep(period, **here)
        bullet.loadURDF("plane.urdf", basePosition=GROUND, **here)
        bullet.loadURDF("table/table.urdf", basePosition=TABLE, **here)
        self._arm = bullet.loadURDF(urdf.file, useFixedBase=True, **here)
        self._object = bullet.loadURDF("random_urdfs/000/000.urdf", **here)
        # Nothing but set joints moves the arm: awake, its default motors would only cost time and blur them by 1e-6.
        self._sleep(self._arm)
        if gui:
            bullet.configureDebugVisualizer(bullet.COV_ENABLE_GUI, 0, **here)
            bullet.resetDebugVisualizerCamera(**CAMERA, **here)
            for start, end in robot.workspace_edges():
                bullet.addUserDebugLine(start, end, (1, 1, 1), **here)

    def _sleep(self, body: int) -> None:
        """Take a body out of the dynamics until it is woken."""
        state = self._bullet.ACTIVATION_STATE_ENABLE_SLEEPING | self._bullet.ACTIVATION_STATE_SLEEP
        self._bullet.changeDynamics(body, -1, activationState=state, physicsClientId=self.client)

    def drop(self, target: np.ndarray) -> None:
        """Let the object go above the target, at rest."""
        wake = self._bullet.ACTIVATION_STATE_WAKE_UP
        self._bullet.changeDynamics(self._object, -1, activationState=wake, physicsClientId=self.client)
        self._still = 0
        position = target + np.array([0.0, 0.0, DROP])
        self._bullet.resetBasePositionAndOrientation(self._object, position, (0, 0, 0, 1), physicsClientId=self.client)
        self._bullet.resetBaseVelocity(self._object, (0, 0, 0), (0, 0, 0), physicsClientId=self.client)

    def step(self) -> None:
        """Move on by a control period; an object that has settled stays where it lies from then on."""
        self._bullet.stepSimulation(physicsClientId=self.client)
        if self._still < SETTLED_STEPS:
            linear, angular = self._bullet.getBaseVelocity(self._object, physicsClientId=self.client)
            slow = max(map(abs, linear)) < SETTLED_SPEED and max(map(abs, angular)) < SETTLED_SPIN
            self._still = self._still + 1 if slow else 0
            if self._still == SETTLED_STEPS:
                self._sleep(self._object)

    def set_joints(self, q: np.ndarray) -> None:
        """Set the joints, at rest."""
        self._bullet.resetJointStatesMultiDof(
            self._arm, self._joints, [[value] for value in q.tolist()], physicsClientId=self.client
        )

    def link(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Position `[3]` m and quaternion `[4]` xyzw of the link that holds the tools, by PyBullet's kinematics."""
        state = self._bullet.getLinkState(
            self._arm, self._urdf.link, computeForwardKinematics=True, physicsClientId=self.client
        )
        # [4] and [5] are the link's frame; [0] is its centre of mass, 2 cm away.
        return state[4], state[5]

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

    def observation(self, view: Views) -> np.ndarray:
        """Picture of the observation camera in a view, `[SIZE, SIZE]` uint8."""
        bullet = self._bullet
        up, back = view.rotation[:, 1], view.rotation[:, 2]
        looks_at = view.position - back
        pixels = bullet.getCameraImage(
            SIZE,
            SIZE,
            bullet.computeViewMatrix(view.position.tolist(), looks_at.tolist(), up.tolist()),
            bullet.computeProjectionMatrixFOV(FIELD_OF_VIEW, 1.0, NEAR, FAR),
            lightDirection=(-view.lamp_direction).tolist(),
            lightDistance=LAMP_DISTANCE,
            lightAmbientCoeff=float(view.ambient),
            lightDiffuseCoeff=float(view.lamp),
            lightSpecularCoeff=0.0,
            shadow=0,
            renderer=bullet.ER_TINY_RENDERER,
            flags=bullet.ER_NO_SEGMENTATION_MASK,
            physicsClientId=self.client,
        )[2]
        return greys(np.asarray(pixels, np.uint8).reshape(SIZE, SIZE, 4)[..., :3])

    def close(self) -> None:
        """Disconnect."""
        if self._bullet.isConnected(physicsClientId=self.client):
            self._bullet.disconnect(physicsClientId=self.client)


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
