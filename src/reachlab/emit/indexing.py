"""Parts of arrays at places that are computed: JAX's primitives behind `x[i]`, `jnp.take` and `x.at[i]`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from jax.lax import GatherScatterMode

from reachlab.emit.builder import objects
from reachlab.emit.operations import INTEGER, REAL, TRUTH
from reachlab.emit.program import Atom, is_computed
from reachlab.emit.tracer import Tracer, kind_of_type
from reachlab.settings.validation import InputError

OUTSIDE = {REAL: np.nan, INTEGER: -(2**31), TRUTH: True}
"""What JAX's filling modes give where there is no number, by kind."""


def _corner(tracer: Tracer, starts: Sequence[Any], sizes: Sequence[int], room: Sequence[int]) -> Atom:
    """Place in an array's flat form of a part of it, which is moved to lie in it."""
    corner: Any = 0
    for axis, (start, size, most) in enumerate(zip(starts, sizes, room, strict=True)):
        builder, stride = tracer.builder, int(np.prod(room[axis + 1 :]))
        inside = builder.compute("most", builder.compute("least", start, most - size), 0)
        corner = builder.compute("add", builder.compute("multiply", inside, stride), corner)
    return corner


def _at(tracer: Tracer, array: np.ndarray, corner: Any, offset: int) -> Any:
    """A number of an array, so far from a place in its flat form."""
    if not is_computed(corner):
        return array.ravel()[corner + offset]
    part = tracer.builder.as_slice(array.ravel().tolist())
    return tracer.builder.take(part.array, tracer.builder.compute("add", corner, offset + part.first))


def dynamic_slice(tracer: Tracer, equation: Any, array: np.ndarray, *starts: np.ndarray) -> np.ndarray:
    """See XLA's DynamicSlice."""
    sizes = equation.params["slice_sizes"]
    corner = _corner(tracer, [start[()] for start in starts], sizes, array.shape)
    offsets = np.arange(array.size).reshape(array.shape)[tuple(map(slice, sizes))]
    return objects([_at(tracer, array, corner, int(offset)) for offset in offsets.ravel()], sizes)


def gather(tracer: Tracer, equation: Any, array: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """See XLA's Gather, whose index vectors JAX has in the last axis."""
    numbers, sizes = equation.params["dimension_numbers"], equation.params["slice_sizes"]
    result = np.empty(equation.outvars[0].aval.shape, object)
    within = [a for a in range(array.ndim) if a not in (*numbers.collapsed_slice_dims, *numbers.operand_batching_dims)]
    for here in np.ndindex(*result.shape):
        batch = [here[axis] for axis in range(result.ndim) if axis not in numbers.offset_dims]
        starts, offset = [0] * array.ndim, [0] * array.ndim
        for axis, start in zip(numbers.start_index_map, indices[tuple(batch)].ravel(), strict=True):
            starts[axis] = start
        for axis, of in zip(numbers.operand_batching_dims, numbers.start_indices_batching_dims, strict=True):
            starts[axis] = batch[of]
        for axis, of in zip(within, numbers.offset_dims, strict=True):
            offset[axis] = here[of]
        corner = _corner(tracer, starts, sizes, array.shape)
        result[here] = _at(tracer, array, corner, int(np.ravel_multi_index(offset, array.shape)))
        if equation.params["mode"] == GatherScatterMode.FILL_OR_DROP:
            result[here] = _filled(tracer, equation, result[here], zip(starts, sizes, array.shape, strict=True))
    return result


def _filled(tracer: Tracer, equation: Any, number: Any, axes: Iterable[tuple[Any, int, int]]) -> Any:
    """A number of an array, or what JAX has in its place where a start, along an axis, leaves no room for a size."""
    fill, compute = equation.params["fill_value"], tracer.builder.compute
    if fill is None:
        fill = OUTSIDE[kind_of_type(equation.outvars[0].aval.dtype)]
    for start, size, room in axes:
        if is_computed(start) or not 0 <= start <= room - size:
            inside = compute("both", compute("less_or_equal", 0, start), compute("less_or_equal", start, room - size))
            number = compute("choose", inside, number, fill)
    return number


def scatter(tracer: Tracer, equation: Any, array: np.ndarray, indices: np.ndarray, updates: np.ndarray) -> np.ndarray:
    """See XLA's Scatter; only where places are known, as in `x.at[2].set(y)`."""
    numbers, result = equation.params["dimension_numbers"], array.copy()
    if any(map(is_computed, indices.ravel())):
        raise InputError(
            f"{tracer.place(equation)} sets numbers of an array at places that are computed: use jnp.where there."
        )
    within = [a for a in range(array.ndim) if a not in (*numbers.inserted_window_dims, *numbers.operand_batching_dims)]
    for here in np.ndindex(*updates.shape):
        batch = [here[axis] for axis in range(updates.ndim) if axis not in numbers.update_window_dims]
        target = [0] * array.ndim
        for axis, start in zip(numbers.scatter_dims_to_operand_dims, indices[tuple(batch)].ravel(), strict=True):
            target[axis] = int(start)
        for axis, of in zip(within, numbers.update_window_dims, strict=True):
            target[axis] += here[of]
        if all(0 <= at < size for at, size in zip(target, array.shape, strict=True)):
            new = updates[here]
            if equation.primitive.name == "scatter-add":
                new = tracer.builder.compute("add", result[tuple(target)], new)
            result[tuple(target)] = new
    return result
