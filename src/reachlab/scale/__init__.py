"""More than one process: sweeps over settings, and rollouts by several workers."""

from __future__ import annotations

from reachlab.settings.tables import Lazy

ENGINES: dict[str, Lazy] = {
    "local": Lazy("processes on this machine", "reachlab.scale.local:LocalEngine"),
    "ray": Lazy("tasks on a Ray cluster, or on a Ray that is started here", "reachlab.scale.ray_engine:RayEngine"),
}
"""What carries the trainings of a sweep, by name, each an `engine.Engine`."""
