"""The printed step of a policy, `step.py` in its folder, and the arrays that it computes with."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.deploy.onboard.folder import content_of

KINDS = {"F32": np.float32, "F64": np.float64, "I32": np.int32, "I64": np.int64, "BOOL": np.bool_}
"""Types of numbers in a file of arrays."""


def read_arrays(file: Path) -> dict[str, np.ndarray]:
    """Arrays by name, of a file in the form of safetensors.

    Raises:
        ValueError: the file is not whole, or not in that form.
    """
    try:
        content = content_of(file)
        (size,) = struct.unpack("<Q", content[:8])
        header, data = json.loads(content[8 : 8 + size]), content[8 + size :]
        header.pop("__metadata__", None)
        arrays = {}
        for name, entry in header.items():
            first, end = entry["data_offsets"]
            arrays[name] = np.frombuffer(data[first:end], KINDS[entry["dtype"]]).reshape(entry["shape"])
    except (OSError, KeyError, ValueError, struct.error) as error:
        raise ValueError(f"'{file}' does not hold the weights of a policy: {error}") from None
    return arrays


def load_step(folder: Path) -> dict[str, Callable[..., Any]]:
    """Functions of the printed step by name, which compute in double precision.

    Raises:
        ValueError: a file is missing or broken.
    """
    arrays = read_arrays(folder / "policy.safetensors")
    constants = {name: array.astype(float) if array.dtype.kind == "f" else array for name, array in arrays.items()}
    file = folder / "step.py"
    try:
        code = compile(content_of(file), str(file), "exec")
    except (OSError, SyntaxError) as error:
        raise ValueError(f"'{file}' cannot be read: {error}: copy the exported folder again.") from None
    functions: dict[str, Any] = {"CONSTANTS": {name: array.ravel() for name, array in constants.items()}}
    exec(code, functions)  # noqa: S102 - it belongs to the controller, and its hash is that of the export
    return functions
