"""What comes with the package of the catalogue's arms, derived: `python -m benchmarks.derived`.

To be run where their files, or what is derived of them, have changed; a test says so.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path

from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.robots.catalogue import ROBOTS
from reachlab.settings import cache
from reachlab.tasks import TASKS

FOLDERS = ("capsules", "tables")
"""Folders of the cache that are shipped."""


def derive() -> dict[str, object]:
    """What every task derives of every arm, by folder and name."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CACHE_HOME"] = folder
        cache._shipped = dict  # nothing is read from what is shipped
        for robot in ROBOTS:
            for task in TASKS:
                Env(configure(task, robot=robot), 1).close()
            sys.stderr.write(f"{robot}\n")
        files = sorted(path for path in Path(folder).rglob("*.json") if path.parent.name in FOLDERS)
        return {f"{path.parent.name}/{path.stem}": json.loads(path.read_text()) for path in files}


if __name__ == "__main__":
    found = derive()
    lines = [f"{json.dumps(name)}: {json.dumps(fields)}" for name, fields in sorted(found.items())]
    cache.SHIPPED.write_text("{\n" + ",\n".join(lines) + "\n}\n")
