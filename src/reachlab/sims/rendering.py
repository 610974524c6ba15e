"""Pictures of simulators that have none of their own: MuJoCo's off-screen renderer draws their joints."""

from __future__ import annotations

import contextlib
import functools
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Self

import numpy as np

from reachlab.control.situation import Goal
from reachlab.render.marks import Marks
from reachlab.render.observation_camera import ObservationCamera
from reachlab.render.offscreen import Camera
from reachlab.render.view_randomisation import Views
from reachlab.robots.robot import Robot
from reachlab.sims.simulator import SimState
from reachlab.tasks.task import EMPTY, Scene


@functools.cache
def _painter() -> ThreadPoolExecutor:
    """The thread that draws: an OpenGL context belongs to one, and pictures may be asked for from any.

    It is one for all simulators: what a thread of its own had taken would not be given back when it ends.
    """
    return ThreadPoolExecutor(1)


class Drawn:
    """The part of a simulator that draws."""

    def __init__(self, robot: Robot, *settings: Any, scene: Scene = EMPTY, **named: Any) -> None:
        """Nothing is loaded before the first picture; the settings are what else the simulator was made with."""
        self._made_with = (robot, *settings), {"scene": scene, **named}
        self._robot = robot
        self._observation_camera = ObservationCamera(robot, objects=scene.objects > 0)
        self._painter = _painter()
        self._camera: Camera | None = None

    def __deepcopy__(self, _memo: dict[int, Any]) -> Self:
        """Another simulator made with the same: all that moves is in the `SimState`."""
        settings, named = self._made_with
        return type(self)(*settings, **named)

    def render(self, state: SimState, goal: Goal, index: int, marks: Marks) -> np.ndarray:
        """See `Simulator.render`."""
        self._camera = self._camera or self._painter.submit(Camera, self._robot).result()
        actuated = np.concatenate([np.asarray(part)[index] for part in (state.q, state.opening)])
        q, point = self._robot.posture(actuated), np.asarray(goal.position[index])
        return self._painter.submit(self._camera.picture, q, point, marks).result()

    def render_observations(self, state: SimState, goal: Goal, views: Views, _indices: np.ndarray) -> np.ndarray:
        """See `Simulator.render_observations`."""
        actuated = np.concatenate([state.q, state.opening], axis=1)
        return self._observation_camera.pictures(actuated, np.asarray(goal.position), state.bodies, views)

    def close(self) -> None:
        """See `Simulator.close`."""
        if self._camera:
            with contextlib.suppress(RuntimeError):  # when Python ends, threads take no more work
                self._painter.submit(self._camera.close).result()
            self._camera = None
        self._observation_camera.close()
