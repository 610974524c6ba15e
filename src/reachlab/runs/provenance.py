"""What a result depends on beside its settings: versions of packages, and the machine's kind."""

from __future__ import annotations

import platform
from importlib.metadata import version


def versions() -> dict[str, str]:
    """Versions of what a result depends on, and the machine's kind."""
    packages = ("reachlab", "jax", "jaxlib", "mujoco", "numpy", "gymnasium")
    return {
        "python": platform.python_version(),
        **{package: version(package) for package in packages},
        "machine": f"{platform.system()} {platform.machine()}",
    }
