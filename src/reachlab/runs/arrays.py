"""A pytree as a file of named arrays, and back into the shape of a template. Nothing is ever unpickled."""

from __future__ import annotations

import hashlib
import math
import os
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
import safetensors.numpy
from safetensors import safe_open

from reachlab.runs.earlier_states import FORMAT, upgraded
from reachlab.runs.files import open_plain
from reachlab.settings.validation import InputError

SIZE_LIMIT = 2**30
"""Largest file that is written or read [bytes]."""

HEADER_LIMIT = 2**20
"""Largest header, of names and shapes, that is read [bytes]."""

LENGTH_BYTES = 8
"""A file begins with the length of its header, little-endian (safetensors' format)."""

Tree = TypeVar("Tree")


def to_bytes(tree: object, metadata: dict[str, str] | None = None) -> bytes:
    """A pytree of arrays and random keys, in the format of a file, with words about it.

    Raises:
        InputError: it is larger than `SIZE_LIMIT`.
    """
    arrays = {name: _plain(leaf) for name, leaf in _named_leaves(tree)}
    if (size := sum(array.nbytes for array in arrays.values())) > SIZE_LIMIT - HEADER_LIMIT:
        raise InputError(
            f"a state of {size:,} bytes is larger than {SIZE_LIMIT:,}: choose fewer environments or narrower layers."
        )
    return safetensors.numpy.save(arrays, metadata)


def digest(file: Path, size: int) -> str:
    """Checksum of a plain file of `size` bytes.

    Raises:
        InputError: it has another size, is too large or not a plain file.
        OSError: it cannot be read.
    """
    with os.fdopen(open_plain(file, os.O_RDONLY), "rb") as opened:
        if not LENGTH_BYTES <= os.fstat(opened.fileno()).st_size == size <= SIZE_LIMIT:
            raise InputError("its size does not fit")
        if int.from_bytes(opened.read(LENGTH_BYTES), "little") > HEADER_LIMIT:
            raise InputError("its header is too large")
        opened.seek(0)
        return hashlib.file_digest(opened, "sha256").hexdigest()


def load(file: Path, template: Tree, written: int = FORMAT) -> Tree:
    """The arrays that `template` names, in its shape; other arrays of a file of this format are not loaded.

    Arrays without numbers need not be in it.

    Raises:
        InputError: an array is missing, of another shape or type, or not finite; the sentence's end says which.
        UNREADABLE: it is not such a file.
    """
    leaves = []
    with safe_open(file, framework="numpy") as opened:
        names = set(opened.keys())
        older = None
        if written != FORMAT:
            older = upgraded({name: opened.get_tensor(name) for name in names}, written)
            names = older.keys()
        for name, like in _named_leaves(template):
            wanted = jax.eval_shape(jax.random.key_data, like) if _is_key(like) else like
            if name not in names and not math.prod(wanted.shape):
                array = np.zeros(wanted.shape, wanted.dtype)
            elif name not in names:
                raise InputError(f"it does not fit the run's configuration at {name!r}")
            else:
                array = opened.get_tensor(name) if older is None else older[name]
            leaves.append(_leaf(name, array, wanted, key=_is_key(like)))
    return jax.tree.unflatten(jax.tree.structure(template), leaves)


def _leaf(name: str, array: np.ndarray, wanted: Any, *, key: bool) -> jax.Array:
    if array.dtype != wanted.dtype or array.shape != wanted.shape:
        raise InputError(f"it does not fit the run's configuration at {name!r}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise InputError(f"it holds numbers at {name!r} that are not finite")
    return jax.random.wrap_key_data(jax.device_put(array)) if key else jax.device_put(array)


def _plain(leaf: Any) -> np.ndarray:
    return np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf, order="C")


def _named_leaves(tree: object) -> list[tuple[str, Any]]:
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    return [(jax.tree_util.keystr(path, simple=True, separator="/"), leaf) for path, leaf in leaves]


def _is_key(leaf: Any) -> bool:
    return jax.numpy.issubdtype(leaf.dtype, jax.dtypes.prng_key)
