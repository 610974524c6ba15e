"""The C sources of an export at work: compiled where a compiler is there, and called from Python."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.control.motion_limits import Motion
from reachlab.settings.validation import InputError

COMPILERS = ("cc", "gcc", "clang")
"""Names of compilers, of which the first that is there is taken."""

OWN = ("command", "last_action", "memory")
"""Inputs of a decision that are part of the state."""

FLAGS = ("-std=c99", "-shared", "-fPIC", "-Wall", "-Wextra", "-Werror", "-pedantic")

QUICKLY = "-Og"
"""Optimisation that compiles a step in a quarter of the time of -O2, and gives the same numbers."""


def compiler() -> str | None:
    """A C compiler of this machine."""
    return next((found for name in COMPILERS if (found := shutil.which(name))), None)


class CPolicy:
    """A policy's step in C.

    Attributes:
        state, input: the records of `reachlab_policy.h`, whose fields may be set.
    """

    def __init__(self, folder: Path, inputs: dict[str, list[int]], n: int, build: Path, how: str = QUICKLY) -> None:
        """Compile the sources in a folder into another; `inputs` and joints `n` as `policy.json` has them.

        `how` is the compiler's flag of optimisation.

        Raises:
            InputError: they cannot be compiled.
        """
        library = build / "reachlab_policy.so"
        words = [str(compiler()), *FLAGS, how, "-o", str(library), str(folder / "reachlab_policy.c"), "-lm"]
        done = subprocess.run(words, capture_output=True, text=True, check=False)  # noqa: S603
        if done.returncode:
            raise InputError(f"the C sources cannot be compiled: {' '.join(done.stderr.split())[:500]}.")
        self._step = ctypes.CDLL(str(library)).reachlab_step
        sizes = {name: int(np.prod(shape)) for name, shape in sorted(inputs.items())}
        given = {name: size for name, size in sizes.items() if name not in OWN}
        kinds = {"stop_step": ctypes.c_int, "bodies_kind": ctypes.c_int, "picture": ctypes.c_int}
        state = dict.fromkeys(Motion._fields, n) | {name: sizes[name] for name in OWN[1:] if name in sizes}
        self.input, self.state = (
            type(
                what,
                (ctypes.Structure,),
                {"_fields_": [(k, kinds.get(k, ctypes.c_double) * m) for k, m in rows.items()]},
            )()
            for what, rows in (("Input", given), ("State", state))
        )
        self._command = (ctypes.c_double * n)()

    def set(self, record: Any, **numbers: Any) -> None:
        """Set fields of a record."""
        for name, value in numbers.items():
            getattr(record, name)[:] = np.ravel(value).tolist()

    def step(self, *, brake: bool = False) -> tuple[np.ndarray, int]:
        """The next command `[n]`, and the problem; the state moves on."""
        problem = self.call(brake=brake)
        return np.array(self._command), problem

    def call(self, *, brake: bool = False) -> int:
        """The problem of the next step, as `step`, without its command."""
        return self._step(ctypes.byref(self.state), ctypes.byref(self.input), int(brake), self._command)
