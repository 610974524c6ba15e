"""Pictures of simulators that have none of their own: MuJoCo's off-screen renderer draws their joints."""

from __future__ import annotations

import contextlib
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Self

import numpy as np
from jax import Array

from reachlab.render.marks import Marks
from reachlab.render.observation_camera import Camera
from reachlab.render.scene import LazyCamera
from reachlab.render.view_randomisation import Views
from reachlab.robots.loading import Robot
from reachlab.sims import ArmState


class Drawn:
    """The part of a simulator that draws."""

    def __init__(self, robot: Robot, *settings: Any) -> None:
        """Nothing is loaded before the first picture; `settings` are what else the simulator was made with."""
        self._made_with = (robot, *settings)
        self._camera, self._eye = LazyCamera(robot), Camera(robot)
        # An OpenGL context belongs to one thread; pictures may be asked for from any.
        self._painter = ThreadPoolExecutor(1)
        self._drew = False

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Another simulator made with the same: all that moves is in the `ArmState`."""
        del memo
        return type(self)(*self._made_with)

    def render(self, state: ArmState, target: Array, lane: int, marks: Marks) -> np.ndarray:
        """See `Simulator.render`."""
        q, point = np.asarray(state.q[lane]), np.asarray(target[lane])
        self._drew = True
        return self._painter.submit(self._camera.picture, q, point, marks).result()

    def see(self, q: np.ndarray, target: np.ndarray, views: Views, lanes: np.ndarray) -> np.ndarray:
        """See `Simulator.see`."""
        del lanes
        return self._eye.pictures(q, target, views)

    def close(self) -> None:
        """See `Simulator.close`."""
        if self._drew:
            with contextlib.suppress(RuntimeError):  # when Python ends, threads take no more work
                self._painter.submit(self._camera.close).result()
            self._drew = False
        self._eye.close()
