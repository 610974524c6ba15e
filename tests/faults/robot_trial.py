"""Tries hostile robot files: none may hang, flood the memory, or open a file that is not the robot's."""

from __future__ import annotations

import json
import resource
import sys
import time
from pathlib import Path

from faults.robot_files import HOSTILE, Content
from faults.robot_parts import SECRET, stl
from reachlab.robots.files.model_file import read_model_file
from reachlab.settings.validation import InputError


def write(root: Path, files: dict[str, Content]) -> Path:
    """Write the files in a folder two levels below the root; the first one's path."""
    folder = root / "robot" / "urdf"
    folder.mkdir(parents=True)
    (root / SECRET).write_bytes(stl())
    (root / "secret.xml").write_text("<m><body/></m>")
    for name, content in files.items():
        if callable(content):
            content(folder / name)
        else:
            data = content if isinstance(content, bytes) else content.encode()
            (folder / name).write_bytes(data.replace(b"{root}", bytes(root)))
    return folder / next(name for name in files if name.startswith(("arm", "other")))


def try_out(file: Path) -> str:
    """What reading a robot file says."""
    if file.name == "other.urdf":
        file = file.with_name("arm.urdf")
    try:
        model = read_model_file(file)
        model.spec(pictures=False).compile()
        model.spec().compile()
    except InputError as error:
        return str(error)
    left = ["Some files are not drawn."] if model._broken else []
    return f"read: {' '.join([*model.notices, *left])}"


def main() -> None:
    """Try each hostile file in a folder of its own; one line of JSON for each."""
    opened: list[str] = []
    sys.addaudithook(
        lambda event, args: opened.append(str(args[0])) if event == "open" and not isinstance(args[0], int) else None
    )
    for number, (name, (files, _)) in enumerate(HOSTILE.items()):
        root = Path(sys.argv[1]) / str(number)
        file = write(root, files)
        opened.clear()
        start = time.process_time()
        said = try_out(file)
        took = time.process_time() - start
        outside = [path for path in map(Path, opened) if not path.is_relative_to(root / "robot")]
        outside = [str(path) for path in outside if path.name != "package.xml"]
        line = {"name": name, "said": said, "took": took, "peak": peak_memory(), "outside": outside}
        sys.stdout.write(json.dumps(line) + "\n")
        sys.stdout.flush()


def peak_memory() -> int:
    """The most memory that this process has held [B]; what `getrusage` tells includes that of its parent."""
    if (status := Path("/proc/self/status")).is_file():
        return 1024 * int(status.read_text().partition("VmHWM:")[2].split()[0])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


if __name__ == "__main__":
    main()
