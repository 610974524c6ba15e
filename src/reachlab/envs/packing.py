"""How the numbers of a compiled program are handed over: each array by itself, or packed into one array."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from typing import Any, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.stages import Lowered

from reachlab.jax_setup import COMPILERS, beside, jit

MOST_SMALL, LEAST_LARGE = 16, 4096
"""Environments up to which, but for a single one, and from which on arrays are handed over by themselves.

A call takes 2 to 4 µs for each array that goes in or out, as long in all as the step of some hundred environments. Up
to 16 packing costs more than it saves: all arrays are of 512 bytes or less, and XLA runs such a program in one go,
where it hands others to its threads kernel by kernel. In large batches it is the copying that costs more.
"""


def make_packing(example: Any, num_envs: int) -> Apart | Packed:
    """The faster way to hand over pytrees that are like an example: of arrays, or of their shapes and types."""
    fits = all(map(_fits, jax.tree.leaves(example)))
    return Packed(example) if fits and (num_envs == 1 or MOST_SMALL < num_envs < LEAST_LARGE) else Apart(example)


class AsTheyAre:
    """Pytrees of the host, which no compiled program takes or gives."""

    def taken(self, packed: Any, *, in_numpy: bool) -> Any:
        """A packed pytree of arrays: in NumPy, the caller's own, or in JAX."""
        return jax.tree.map(np.array if in_numpy else jnp.asarray, packed)


class Apart:
    """A pytree handed over array by array, but for those without numbers."""

    def __init__(self, example: Any) -> None:
        """Pytrees that are like an example: of arrays, or of their shapes and types."""
        leaves, self._structure = jax.tree.flatten(example)
        self._empty = [None if leaf.size else np.zeros(leaf.shape, leaf.dtype) for leaf in leaves]
        self._full = [(leaf.shape, leaf.dtype, _bits_shape(leaf)) for leaf in leaves if leaf.size]

    @property
    def zeros(self) -> Any:
        """A packed pytree of zeros."""
        return [
            jax.random.wrap_key_data(jnp.zeros(bits, jnp.uint32)) if _is_key(dtype) else np.zeros(shape, dtype)
            for shape, dtype, bits in self._full
        ]

    def pack(self, tree: Any) -> Any:
        """A pytree, packed, in JAX's traces."""
        return [leaf for leaf in jax.tree.leaves(tree) if leaf.size]

    def unpack(self, packed: Any) -> Any:
        """A packed pytree, in JAX's traces."""
        filled = iter(packed)
        return jax.tree.unflatten(self._structure, [next(filled) if one is None else one for one in self._empty])

    in_jax = unpack
    """A packed pytree as JAX's functions take it."""

    def taken(self, packed: Any, *, in_numpy: bool) -> Any:
        """See `AsTheyAre`."""
        return self.unpack(map(np.array, packed) if in_numpy else packed)


class Packed:
    """A pytree of arrays with a batch in front as one array `[B, columns]` uint32, the bits of its numbers."""

    def __init__(self, example: Any) -> None:
        """Pytrees that are like an example: of arrays, or of their shapes and types."""
        leaves, self._structure = jax.tree.flatten(example)
        shapes = [_bits_shape(leaf) for leaf in leaves]
        ends = np.cumsum([math.prod(shape[1:]) for shape in shapes]).tolist()
        self._leaves = [
            (slice(start, end) if len(shape) > 1 else start, leaf.shape, leaf.dtype)
            for start, end, shape, leaf in zip([0, *ends], ends, shapes, leaves, strict=False)
        ]
        self._deep = [i for i, shape in enumerate(shapes) if len(shape) > 2]
        self._types = {leaf.dtype for leaf in leaves if jnp.issubdtype(leaf.dtype, np.number)}
        self.zeros: Any = np.zeros((shapes[0][0], ends[-1]), np.uint32)
        self._in_jax = jit(self.unpack)

    def pack(self, tree: Any) -> Array:
        """A pytree, packed, in JAX's traces."""
        return jnp.concatenate([_bits(leaf).reshape(len(leaf), -1) for leaf in jax.tree.leaves(tree)], axis=1)

    def unpack(self, packed: Array) -> Any:
        """A packed pytree, in JAX's traces."""
        leaves = [_numbers(packed[:, columns], shape, dtype) for columns, shape, dtype in self._leaves]
        return jax.tree.unflatten(self._structure, leaves)

    def in_jax(self, packed: Any) -> Any:
        """See `Apart`."""
        return self._in_jax(packed)

    def taken(self, packed: Any, *, in_numpy: bool) -> Any:
        """See `AsTheyAre`; numbers are of 32 bits, or truths."""
        if not in_numpy:
            return self._in_jax(packed)
        alone = len(packed) == 1  # what is a row's part is in one piece, and need not be copied again
        bits = np.array(packed) if alone else np.asarray(packed)
        views = {dtype: bits.view(dtype) for dtype in self._types}
        leaves = [
            bits[:, columns] != 0 if (view := views.get(dtype)) is None else view[:, columns]
            for columns, _, dtype in self._leaves
        ]
        for i in self._deep:
            leaves[i] = leaves[i].reshape(self._leaves[i][1])
        return jax.tree.unflatten(self._structure, leaves if alone else map(np.copy, leaves))


class PackedResults:
    """A function that gives a tuple of pytrees, compiled so that each of them is handed over packed.

    Attributes:
        packings: of the results, known from the first call on.
    """

    packings: tuple[Apart | Packed, ...] = ()

    def __init__(self, function: Callable[..., tuple[Any, ...]], num_envs: int) -> None:
        """A function for batches of so many environments, which can be traced."""
        self._function, self._num_envs = function, num_envs
        self._program = self._run = jit(self._packed, brief=True)

    def __call__(self, *arguments: Any) -> tuple[Any, ...]:
        """Its packed results."""
        return self._run(*arguments)

    def ahead(self, *arguments: Any) -> tuple[Any, ...]:
        """Shapes of its results for such arguments, or their shapes; it is compiled beside the main thread."""
        lowered = self._program.lower(*arguments)
        compiled = COMPILERS.submit(lowered.compile)

        def first(*arguments: Any) -> tuple[Any, ...]:
            compiled.result()  # JAX finds it then
            self._run = self._program
            return self._run(*arguments)

        self._run = first
        return jax.tree.map(alike, lowered.out_info)

    def __deepcopy__(self, _memo: dict[int, Any]) -> Self:
        """Itself: nothing changes after the first call."""
        return self

    def _packed(self, *arguments: Any) -> tuple[Any, ...]:
        results = self._function(*arguments)
        self.packings = tuple(make_packing(one, self._num_envs) for one in results)
        return tuple(packing.pack(one) for packing, one in zip(self.packings, results, strict=True))


class Computed:
    """A function compiled so that only what it computes is handed over, neither what it is given nor empty arrays.

    It is compiled once for arrays of the same types, whichever library's they are and whatever they come from.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        """A function of pytrees of arrays, which can be traced."""
        self._function = function
        self._programs: dict[Any, tuple[Callable[..., Any], Any]] = {}

    def __call__(self, *arguments: Any) -> Any:
        """What the function gives; what it was given is the caller's own."""
        given, structure = jax.tree.flatten(arguments)
        if structure in self._programs:
            with contextlib.suppress(TypeError):  # of other types than before
                return self._programs[structure][0](given)
        self._lower(structure, given, lambda lowered: lowered.compile())
        return self._programs[structure][0](given)

    def ahead(self, *arguments: Any) -> Any:
        """Shapes of what it gives for such arguments, or their shapes; it is compiled beside the main thread."""
        given, structure = jax.tree.flatten(arguments)
        if structure not in self._programs:
            self._lower(structure, given, lambda lowered: beside(lowered.compile))
        return self._programs[structure][1]

    def __deepcopy__(self, _memo: dict[int, Any]) -> Self:
        """Itself: what it learns is the same for all."""
        return self

    def _lower(self, structure: Any, given: list[Any], compiled: Callable[[Lowered], Callable[..., Any]]) -> None:
        """Keep the program for such arguments, as `compiled` gives it, and the shapes of what the function gives."""
        found: list[Any] = []

        def computed(*leaves: Any) -> list[Array]:
            results, form = jax.tree.flatten(self._function(*jax.tree.unflatten(structure, leaves)))
            numbers = {id(leaf): number for number, leaf in enumerate(leaves)}
            # Of each: which of those given it is, or what it is without numbers, or None of what is computed.
            places = [numbers.get(id(x)) if x.size else np.zeros(x.shape, x.dtype) for x in results]
            found[:] = places, form
            return [leaf for leaf, place in zip(results, places, strict=True) if place is None]

        lowered = jit(computed, brief=True).lower(*given)
        places, form = found
        program = compiled(lowered)

        def merged(given: list[Any], computed: list[Any]) -> Any:
            new = iter(computed)
            parts = [next(new) if at is None else given[at] if isinstance(at, int) else at for at in places]
            return jax.tree.unflatten(form, parts)

        shapes = jax.tree.map(alike, merged(list(map(jax.typeof, given)), lowered.out_info))
        self._programs[structure] = (lambda given: merged(given, program(*given))), shapes


def alike(example: Any, count: int | None = None) -> Any:
    """Shape and type of an array or, with a count, of a batch of so many like it."""
    shape = example.shape if count is None else (count, *example.shape[1:])
    return jax.ShapeDtypeStruct(shape, example.dtype)


def _is_key(dtype: Any) -> bool:
    return jnp.issubdtype(dtype, jax.dtypes.prng_key)


def _fits(leaf: Any) -> bool:
    """Whether `_bits` are as many numbers as the leaf's, or it is of keys."""
    return _is_key(leaf.dtype) or leaf.dtype.kind == "b" or leaf.dtype.itemsize == 4


def _bits(leaf: Array) -> Array:
    """Numbers, truths or keys as uint32."""
    if _is_key(leaf.dtype):
        return jax.random.key_data(leaf)
    return leaf.astype(jnp.uint32) if leaf.dtype.kind == "b" else jax.lax.bitcast_convert_type(leaf, jnp.uint32)


def _bits_shape(leaf: Any) -> tuple[int, ...]:
    """Shape of the bits of a leaf, which may be its shape and type alone."""
    return jax.eval_shape(jax.random.key_data, leaf).shape if _is_key(leaf.dtype) else leaf.shape


def _numbers(columns: Any, shape: tuple[int, ...], dtype: Any) -> Array:
    """The reverse of `_bits`."""
    if _is_key(dtype):
        return jax.random.wrap_key_data(columns)
    columns = columns.reshape(shape)
    return columns != 0 if dtype.kind == "b" else jax.lax.bitcast_convert_type(columns, dtype)
