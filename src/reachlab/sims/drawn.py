"""Pictures of simulators that have none of their own: MuJoCo's off-screen renderer draws their joints."""

from __future__ import annotations

import numpy as np
from jax import Array

from reachlab.camera import Camera
from reachlab.marks import Marks
from reachlab.robots import Robot
from reachlab.scene import LazyCamera
from reachlab.sims import ArmState
from reachlab.views import Views


class Drawn:
    """The part of a simulator that draws."""

    def __init__(self, robot: Robot) -> None:
        """Nothing is loaded before the first picture."""
        self._camera, self._eye = LazyCamera(robot), Camera(robot)

    def render(self, state: ArmState, target: Array, lane: int, marks: Marks) -> np.ndarray:
        """See `Simulator.render`."""
        return self._camera.picture(np.asarray(state.q[lane]), np.asarray(target[lane]), marks)

    def see(self, q: np.ndarray, target: np.ndarray, views: Views, lanes: np.ndarray) -> np.ndarray:
        """See `Simulator.see`."""
        del lanes
        return self._eye.pictures(q, target, views)

    def close(self) -> None:
        """See `Simulator.close`."""
        self._camera.close()
        self._eye.close()
