"""Builds sdist and wheel into `dist/`, and tries both as a user gets them: in an environment and a folder of their own.

`make dist` runs it. Nothing but pip needs a network.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from collections.abc import Sequence
from pathlib import Path

from packaging.metadata import Metadata

from reachlab.cli.console import say

ROOT = Path(__file__).parents[1]
DIST, CONSTRAINTS = ROOT / "dist", ROOT / "constraints.txt"

TRIED = (
    "reachlab --version",
    "reachlab list",
    "reachlab train --total-steps 20000 --num-envs 64 --out runs/tiny",
    "reachlab eval runs/tiny --agent trained ik --episodes 20",
    "reachlab plot runs/tiny",
)
"""Commands that a user may run first, from the wheel; the first two from the sdist too."""

NAMES = """
import reachlab
from reachlab.robots.catalogue import ROBOTS
for name in reachlab.__all__:
    getattr(reachlab, name)
for name in ROBOTS:
    reachlab.load_robot(name)
print(f"{len(reachlab.__all__)} names and {len(ROBOTS)} arms, from {reachlab.__file__}")
"""
"""Imports every public name, and loads every arm's files."""

LEFT_OUT = {".gitignore"}
"""Files that are kept with the source and need not be in the sdist; hatchling adds this one nevertheless."""


def main() -> None:
    """Build, check, install and try."""
    shutil.rmtree(DIST, ignore_errors=True)
    # From the sdist comes the wheel: so what is missing in the one is missing in the other.
    _run([sys.executable, "-m", "build", "--outdir", str(DIST)], ROOT, {"PIP_CONSTRAINT": str(CONSTRAINTS)})
    (sdist,), (wheel,) = DIST.glob("*.tar.gz"), DIST.glob("*.whl")
    _check_metadata(sdist, wheel)
    with tempfile.TemporaryDirectory() as folder:
        away = Path(folder)
        _check_files(sdist, wheel, away / "sdist")
        python = away / "venv/bin/python"
        _run([sys.executable, "-m", "venv", str(away / "venv")], away)
        _install(python, "--constraint", str(CONSTRAINTS), str(wheel))
        _run([str(python), "-m", "pip", "check"], away)
        _try(python, away / "of_wheel", TRIED)
        _run([str(python), "-m", "pip", "uninstall", "--yes", "--quiet", "reachlab"], away)
        _install(python, "--no-deps", str(sdist))
        _try(python, away / "of_sdist", TRIED[:2])
    for file in (sdist, wheel):
        say(f"{file.relative_to(ROOT)}: {file.stat().st_size / 1e6:.1f} MB, built, installed and tried")


def _check_metadata(sdist: Path, wheel: Path) -> None:
    """Make sure that both hold the same metadata, that it is valid, and that its long description is the README."""
    with tarfile.open(sdist) as packed:
        (name,) = [name for name in packed.getnames() if name.count("/") == 1 and name.endswith("/PKG-INFO")]
        of_sdist = packed.extractfile(name)
        assert of_sdist is not None
        text = of_sdist.read()
    with zipfile.ZipFile(wheel) as packed:
        (name,) = [name for name in packed.namelist() if name.endswith(".dist-info/METADATA")]
        assert packed.read(name) == text, "sdist and wheel differ in their metadata"
    metadata = Metadata.from_email(text, validate=True)
    assert metadata.description_content_type == "text/markdown"
    assert (metadata.description or "").strip() == (ROOT / "README.md").read_text(encoding="utf-8").strip()


def _check_files(sdist: Path, wheel: Path, unpacked: Path) -> None:
    """Make sure that the wheel holds every file of the package, and the sdist every file that is kept with the source.

    Outside a clone it is not known which these are: then only that tests of files pass in the sdist.
    """
    source = ROOT / "src"
    package = {
        path.relative_to(source).as_posix()
        for path in source.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    with zipfile.ZipFile(wheel) as packed:
        here = {name for name in packed.namelist() if ".dist-info/" not in name}
    assert here == package, f"the wheel differs from the package in {sorted(here ^ package)}"
    with tarfile.open(sdist) as packed:
        packed.extractall(unpacked, filter="data")
    (top,) = unpacked.iterdir()
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    kept = {name for name in listed.stdout.split("\0") if name} if listed.returncode == 0 else set()
    missing = sorted(name for name in kept - LEFT_OUT if (ROOT / name).exists() and not (top / name).exists())
    assert not missing, f"missing in the sdist: {missing}"
    words = ["-m", "pytest", "-p", "no:cacheprovider", "tests/test_imports.py", "tests/test_tables.py"]
    _run([sys.executable, *words], top, {"PYTHONPATH": str(top / "src")})


def _install(python: Path, *words: str) -> None:
    started = time.perf_counter()
    _run([str(python), "-m", "pip", "--disable-pip-version-check", "--quiet", "install", *words], python.parent)
    say(f"installed in {time.perf_counter() - started:.0f} s")


def _try(python: Path, folder: Path, commands: Sequence[str]) -> None:
    """Run commands, and import all names, in an empty folder where nothing but what is installed can be found."""
    folder.mkdir()
    for command in commands:
        program, *words = shlex.split(command)
        _run([str(python.parent / program), *words], folder, quiet=True)
    _run([str(python), "-c", NAMES], folder)


def _run(words: Sequence[str], folder: Path, more: dict[str, str] | None = None, *, quiet: bool = False) -> None:
    """Run a program; a quiet one's results are not shown.

    Raises:
        CalledProcessError: it fails.
    """
    say(f"$ {shlex.join('NAMES' if word is NAMES else word for word in words)}")
    alone = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
    shown = subprocess.DEVNULL if quiet else None
    subprocess.run(words, cwd=folder, env=alone | (more or {}), stdout=shown, check=True)


if __name__ == "__main__":
    main()
