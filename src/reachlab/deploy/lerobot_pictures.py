"""Pictures as LeRobot has them: those of a camera, in three colours."""

from __future__ import annotations

from functools import partial

import numpy as np

from reachlab.control.bodies import Bodies
from reachlab.envs.core import Env
from reachlab.render import CAMERAS
from reachlab.render.observation_camera import ObservationCamera
from reachlab.render.view_randomisation import develop, make_views
from reachlab.settings.validation import choose


class Studio:
    """A camera of an environment's arms."""

    def __init__(self, env: Env, name: str, size: int) -> None:
        """One of `CAMERAS`, with pictures of a height and width [pixels].

        Raises:
            InputError: there is none of that name.
        """
        entry = CAMERAS[choose("camera", name, CAMERAS)]
        robot, objects = env.setup.robot, env.setup.task.scene(env.setup).objects > 0
        self._camera = ObservationCamera(robot, objects=objects, size=size, colour=bool(entry.angles))
        self._views = partial(make_views, robot=robot, objects=objects, angles=entry.angles)

    def pictures(self, samples: np.ndarray, actuated: np.ndarray, goal: np.ndarray, bodies: Bodies) -> np.ndarray:
        """Pictures `[B, size, size, 3]` uint8, of view samples `[B, SAMPLES]`, arms `[B, m]`, goals `[B, 3]`.

        The bodies are `[B, K]`.
        """
        views = self._views(samples)
        drawn = develop(self._camera.pictures(actuated, goal, bodies, views), views)
        return drawn if drawn.ndim > 3 else np.repeat(drawn[..., None], 3, axis=-1)

    def close(self) -> None:
        """Free what it draws with."""
        self._camera.close()
