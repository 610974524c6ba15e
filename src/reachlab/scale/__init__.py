"""More than one process: sweeps over settings, and rollouts by several workers."""

from __future__ import annotations

from reachlab.settings.tables import Lazy

ENGINES: dict[str, Lazy] = {
    "local": Lazy("processes on this machine", "reachlab.scale.engines:LocalEngine"),
    "ray": Lazy("tasks on a Ray cluster, or on a Ray that is started here", "reachlab.scale.engines:RayEngine"),
}
"""What carries the trainings of a sweep, by name, each an `engines.Engine`."""
