"""One client of PyBullet with the tutorial's scene: plane, table and arm, and in it the object that falls."""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np

from reachlab.render.view_randomisation import FAR, NEAR, Views, greys
from reachlab.robots.robot import PybulletModel, Robot
from reachlab.settings.validation import InputError, needing
from reachlab.tasks.camera import FIELD_OF_VIEW
from reachlab.tasks.schema import SIZE

GRAVITY = -10.0
"""The tutorial's gravity [m/s²]."""

GROUND, TABLE = (0.0, 0.0, -0.65), (0.5, 0.0, -0.65)
"""Where the tutorial puts plane and table [m]; for an arm of another size the scene is scaled, see `Robot.placed`."""

DROP = 0.0183
"""Height above the target from which the object is let go [m]: at z = 0.01, to settle at z = -0.0083."""

SETTLED_SPEED, SETTLED_SPIN, SETTLED_STEPS = 0.01, 0.1, 10
"""An object slower than this [m/s, rad/s] for so many steps has settled; contact with it is most of a step's time."""

CAMERA: dict[str, Any] = {
    "cameraTargetPosition": (0.55, -0.35, 0.2),
    "cameraDistance": 1.5,
    "cameraYaw": 0.0,
    "cameraPitch": -40.0,
}
"""The tutorial's viewer camera."""

WIDTH, HEIGHT = 640, 480
"""Size of the viewer camera's pictures [pixels]; its lens is the observation camera's."""

LAMP_DISTANCE = 2.0
"""How far the lamp is from the scene [m]."""


class World:
    """One client with plane, table and arm of the tutorial's scene, in the arm's size."""

    def __init__(self, bullet: ModuleType, robot: Robot, urdf: PybulletModel, period: float, *, gui: bool) -> None:
        import pybullet_data

        self._urdf = urdf
        self._joints = list(range(robot.chain.n))
        self._scale = robot.scale
        place, distance = robot.placed(CAMERA["cameraTargetPosition"]), CAMERA["cameraDistance"] * robot.scale
        self._camera = CAMERA | {"cameraTargetPosition": place, "cameraDistance": distance}
        self.bullet = bullet = _connect(bullet, gui=gui)
        bullet.setAdditionalSearchPath(pybullet_data.getDataPath())
        bullet.setTimeStep(period)
        self._furniture = [
            bullet.loadURDF(file, basePosition=robot.placed(place), globalScaling=robot.scale)
            for file, place in (("plane.urdf", GROUND), ("table/table.urdf", TABLE))
        ]
        self._arm = bullet.loadURDF(urdf.file, useFixedBase=True, flags=bullet.URDF_USE_INERTIA_FROM_FILE)
        if gui:
            bullet.configureDebugVisualizer(bullet.COV_ENABLE_GUI, 0)
            bullet.resetDebugVisualizerCamera(**self._camera)
            for start, end in robot.workspace_edges():
                bullet.addUserDebugLine(start, end, (1, 1, 1))

    def set_joints(self, q: np.ndarray) -> None:
        """Set the joints, at rest."""
        self.bullet.resetJointStatesMultiDof(self._arm, self._joints, [[value] for value in q.tolist()])

    def link(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Position `[3]` m and quaternion `[4]` xyzw of the link that holds the tools, by PyBullet's kinematics."""
        state = self.bullet.getLinkState(self._arm, self._urdf.link, computeForwardKinematics=True)
        # [4] and [5] are the link's frame; [0] is its centre of mass, 2 cm away.
        return state[4], state[5]

    def picture(self) -> np.ndarray:
        """Picture of the tutorial's viewer camera, `[HEIGHT, WIDTH, 3]` uint8."""
        bullet = self.bullet
        point, distance, yaw, pitch = (self._camera[name] for name in CAMERA)
        view = bullet.computeViewMatrixFromYawPitchRoll(point, distance, yaw, pitch, roll=0, upAxisIndex=2)
        projection = bullet.computeProjectionMatrixFOV(FIELD_OF_VIEW, WIDTH / HEIGHT, NEAR, FAR)
        pixels = bullet.getCameraImage(WIDTH, HEIGHT, view, projection, renderer=bullet.ER_TINY_RENDERER)[2]
        return np.array(pixels, np.uint8).reshape(HEIGHT, WIDTH, 4)[..., :3].copy()

    def observation(self, view: Views) -> np.ndarray:
        """Picture of the observation camera in a view, `[SIZE, SIZE]` uint8."""
        bullet = self.bullet
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
        )[2]
        return greys(np.asarray(pixels, np.uint8).reshape(SIZE, SIZE, 4)[..., :3])

    def close(self) -> None:
        """Disconnect."""
        if self.bullet.isConnected():
            self.bullet.disconnect()


class TutorialWorld(World):
    """A world in which joints are set, and an object falls."""

    def __init__(self, bullet: ModuleType, robot: Robot, urdf: PybulletModel, period: float, *, gui: bool) -> None:
        super().__init__(bullet, robot, urdf, period, gui=gui)
        self._still = 0
        self.bullet.setGravity(0, 0, GRAVITY)
        self._object = self.bullet.loadURDF("random_urdfs/000/000.urdf", globalScaling=robot.scale)
        # Nothing but set joints moves the arm: awake, its default motors would only cost time and blur them by 1e-6.
        self._sleep(self._arm)

    def _sleep(self, body: int) -> None:
        """Take a body out of the dynamics until it is woken."""
        state = self.bullet.ACTIVATION_STATE_ENABLE_SLEEPING | self.bullet.ACTIVATION_STATE_SLEEP
        self.bullet.changeDynamics(body, -1, activationState=state)

    def drop(self, target: np.ndarray) -> None:
        """Let the object go above the target, at rest."""
        wake = self.bullet.ACTIVATION_STATE_WAKE_UP
        self.bullet.changeDynamics(self._object, -1, activationState=wake)
        self._still = 0
        position = target + np.array([0.0, 0.0, DROP * self._scale])
        self.bullet.resetBasePositionAndOrientation(self._object, position, (0, 0, 0, 1))
        self.bullet.resetBaseVelocity(self._object, (0, 0, 0), (0, 0, 0))

    def step(self) -> None:
        """Move on by a control period; an object that has settled stays where it lies from then on."""
        self.bullet.stepSimulation()
        if self._still < SETTLED_STEPS:
            linear, angular = self.bullet.getBaseVelocity(self._object)
            slow = max(map(abs, linear)) < SETTLED_SPEED and max(map(abs, angular)) < SETTLED_SPIN
            self._still = self._still + 1 if slow else 0
            if self._still == SETTLED_STEPS:
                self._sleep(self._object)


def _connect(bullet: ModuleType, *, gui: bool) -> Any:
    if gui and platform.system() == "Linux" and not os.environ.get("DISPLAY"):
        raise InputError("--gui needs a display, and there is none here: run without it, or on a desktop.")
    from pybullet_utils.bullet_client import BulletClient

    with _quiet_stdout():  # it prints a line of its own for each
        client = BulletClient(bullet.GUI if gui else bullet.DIRECT)
    if not client.isConnected():
        raise InputError("PyBullet gave no connection: its window could not be opened, or too many clients are open.")
    return client


def import_pybullet() -> ModuleType:
    """The module; it prints its build time on standard output when imported, which is kept from there."""
    newer = f"this is {platform.python_version()}; with a newer one use a 3.11 environment"
    sentence = f"simulator 'pybullet' needs PyBullet: {{}} (its wheels end at Python 3.11, {newer})."
    with needing(sentence, "pybullet", ImportError), _quiet_stdout():
        import pybullet
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
