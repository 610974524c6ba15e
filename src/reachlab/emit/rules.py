"""What JAX's primitives come to on numbers of a program; shapes are resolved while tracing."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from reachlab.emit.indexing import dynamic_slice, gather, scatter
from reachlab.emit.loops import case, cond, scan, while_loop
from reachlab.emit.operations import INTEGER, REAL, TRUTH
from reachlab.emit.tracer import Rule, Tracer, Values, as_array, kind_of_type
from reachlab.settings.validation import InputError

SMALL_PRODUCT = 64
"""Products of numbers up to which a matrix product is written out."""

NEUTRAL = {"add": 0, "multiply": 1, "least": math.inf, "most": -math.inf, "both": True, "either": False}
"""What changes nothing that an operation is done with."""

TO_EVEN = 1
"""JAX's number for rounding to the nearest integer, of two to the even one."""


# --- shapes ---------------------------------------------------------------------------------------


def _same(_tracer: Tracer, _equation: Any, *given: np.ndarray) -> Values:
    return list(given)


def _broadcast(_: Tracer, equation: Any, array: np.ndarray) -> np.ndarray:
    sizes = [1] * len(equation.params["shape"])
    for axis, size in zip(equation.params["broadcast_dimensions"], array.shape, strict=True):
        sizes[axis] = size
    return np.broadcast_to(array.reshape(sizes), equation.params["shape"])


def _slice(_: Tracer, equation: Any, array: np.ndarray) -> np.ndarray:
    starts, ends, steps = (equation.params[name] for name in ("start_indices", "limit_indices", "strides"))
    return array[tuple(slice(*one) for one in zip(starts, ends, steps or [1] * array.ndim, strict=True))]


def _pad(tracer: Tracer, equation: Any, array: np.ndarray, filled: np.ndarray) -> np.ndarray:
    """An array with others around and between its numbers, as what is sliced out of it is given back."""
    parts = equation.params["padding_config"]
    if min(min(part) for part in parts) < 0:
        raise InputError(f"{tracer.place(equation)} pads by less than nothing, which cannot be printed: slice there.")
    sizes = [
        low + max((n - 1) * (gap + 1) + 1, 0) + high for n, (low, high, gap) in zip(array.shape, parts, strict=True)
    ]
    padded = np.full(sizes, filled[()], object)
    padded[tuple(slice(low, size - high, gap + 1) for size, (low, high, gap) in zip(sizes, parts, strict=True))] = array
    return padded


def _split(_: Tracer, equation: Any, array: np.ndarray) -> Values:
    return np.split(array, np.cumsum(equation.params["sizes"])[:-1], equation.params["axis"])


# --- numbers --------------------------------------------------------------------------------------


def _convert(tracer: Tracer, equation: Any, array: np.ndarray) -> np.ndarray:
    wanted, given = (kind_of_type(one) for one in (equation.params["new_dtype"], equation.invars[0].aval.dtype))
    if wanted == TRUTH != given:
        return tracer.each("unequal", array, 0)
    if wanted == INTEGER and given == REAL and equation.params["new_dtype"] not in (np.int32, np.int64):
        made = f"{tracer.place(equation)} makes {equation.params['new_dtype']} of real numbers"
        raise InputError(f"{made}, which cannot be printed: use int32 there.")
    return array if wanted == given else tracer.each(wanted, array)


def _choose(tracer: Tracer, equation: Any, chosen: np.ndarray, *cases: np.ndarray) -> np.ndarray:
    if kind_of_type(equation.invars[0].aval.dtype) == TRUTH:
        return tracer.each("choose", chosen, cases[1], cases[0])
    return case(tracer, chosen, cases)


def _by_kind(of_integers: str, of_reals: str) -> Rule:
    """The rule of an operation that is another on whole numbers."""

    def rule(tracer: Tracer, equation: Any, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return tracer.each(of_integers if kind_of_type(equation.invars[0].aval.dtype) == INTEGER else of_reals, a, b)

    return rule


def _integer_power(tracer: Tracer, equation: Any, array: np.ndarray) -> np.ndarray:
    exponent = equation.params["y"]
    product = functools.reduce(lambda a, b: tracer.each("multiply", a, b), [array] * abs(exponent), as_array(1))
    return product if exponent >= 0 else tracer.each("divide", 1.0, product)


def _round(tracer: Tracer, equation: Any, array: np.ndarray) -> np.ndarray:
    if int(equation.params["rounding_method"]) != TO_EVEN:
        raise InputError(f"{tracer.place(equation)} rounds away from 0, which cannot be printed: use jnp.round there.")
    return tracer.each("round", array)


def _logistic(tracer: Tracer, _: Any, array: np.ndarray) -> np.ndarray:
    return tracer.each(
        "divide", 1.0, tracer.each("add", 1.0, tracer.each("exponential", tracer.each("negative", array)))
    )


# --- along axes -----------------------------------------------------------------------------------


def _rows(array: np.ndarray, axis: int) -> Values:
    return [as_array(array.take(i, axis)) for i in range(array.shape[axis])]


def _fold(tracer: Tracer, operation: str, array: np.ndarray, axes: Sequence[int]) -> np.ndarray:
    """An operation on all numbers along axes, one after the other; of none it is what changes no other."""
    for axis in sorted(axes, reverse=True):
        rows = _rows(array, axis) or [np.full(np.delete(array.shape, axis), NEUTRAL[operation], object)]
        array = functools.reduce(lambda a, b: tracer.each(operation, a, b), rows)
    return array


def _reduction(operation: str) -> Rule:
    return lambda tracer, equation, array: _fold(tracer, operation, array, equation.params["axes"])


def _running(operation: str) -> Rule:
    """The rule of results of an operation on all numbers up to each along an axis."""

    def rule(tracer: Tracer, equation: Any, array: np.ndarray) -> np.ndarray:
        axis, step = equation.params["axis"], -1 if equation.params["reverse"] else 1
        sums = itertools.accumulate(_rows(array, axis)[::step], lambda a, b: tracer.each(operation, a, b))
        return np.stack(list(sums)[::step], axis) if array.size else array

    return rule


def _extreme(*, least: bool) -> Rule:
    """The rule of the place of the smallest or largest number: the first where several are."""

    def rule(tracer: Tracer, equation: Any, array: np.ndarray) -> np.ndarray:
        best, *others = _rows(array, equation.params["axes"][0])
        number = np.zeros(best.shape, int).astype(object)
        for i, now in enumerate(others, 1):
            better = tracer.each("less", *((now, best) if least else (best, now)))
            best, number = tracer.each("choose", better, now, best), tracer.each("choose", better, i, number)
        return number

    return rule


def _dot(tracer: Tracer, equation: Any, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """A product over axes of both; of those of a batch one after the other."""
    (one, other), (rows, columns) = equation.params["dimension_numbers"]
    rest = [axis for axis in range(left.ndim) if axis not in (*one, *rows)]
    others = [axis for axis in range(right.ndim) if axis not in (*other, *columns)]
    batch, size = [left.shape[axis] for axis in rows], math.prod([left.shape[axis] for axis in one])
    high, wide = [left.shape[axis] for axis in rest], [right.shape[axis] for axis in others]
    a = left.transpose([*rows, *rest, *one]).reshape(math.prod(batch), math.prod(high), size)
    b = right.transpose([*columns, *other, *others]).reshape(math.prod(batch), size, math.prod(wide))
    shape = [*batch, *high, *wide]
    if not math.prod(shape):
        return np.empty(shape, object)
    return np.stack([_matrix(tracer, *pair) for pair in zip(a, b, strict=True)]).reshape(shape)


def _matrix(tracer: Tracer, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    if a.size * b.shape[1] > SMALL_PRODUCT:
        return tracer.builder.product(a, b)
    return _fold(tracer, "add", tracer.each("multiply", a[:, :, None], b[None]), [1])


ELEMENTWISE = {
    "floor": "floor",
    "add": "add",
    "add_any": "add",
    "sub": "subtract",
    "mul": "multiply",
    "neg": "negative",
    "abs": "absolute",
    "sign": "sign",
    "sqrt": "square_root",
    "sin": "sine",
    "cos": "cosine",
    "tan": "tangent",
    "asin": "arc_sine",
    "acos": "arc_cosine",
    "atan": "arc_tangent",
    "atan2": "arc_tangent_of_two",
    "exp": "exponential",
    "log": "logarithm",
    "tanh": "hyperbolic_tangent",
    "pow": "power",
    "ceil": "ceiling",
    "min": "least",
    "max": "most",
    "lt": "less",
    "le": "less_or_equal",
    "eq": "equal",
    "ne": "unequal",
    "and": "both",
    "or": "either",
    "not": "no",
    "is_finite": "finite",
}
"""JAX's primitives that are an operation each."""

RULES: dict[str, Rule] = {
    **dict.fromkeys(("optimization_barrier", "stop_gradient", "copy", "copy_p", "reduce_precision"), _same),
    "convert_element_type": _convert,
    "broadcast_in_dim": _broadcast,
    "reshape": lambda _, equation, array: array.reshape(equation.params["new_sizes"]),
    "squeeze": lambda _, equation, array: np.squeeze(array, tuple(equation.params["dimensions"])),
    "transpose": lambda _, equation, array: array.transpose(equation.params["permutation"]),
    "rev": lambda _, equation, array: np.flip(array, equation.params["dimensions"]),
    "concatenate": lambda _, equation, *arrays: np.concatenate(arrays, equation.params["dimension"]),
    "stack": lambda _, equation, *arrays: np.stack(arrays, equation.params.get("axis", 0)),
    "pad": _pad,
    "unstack": lambda _, equation, array: _rows(array, equation.params["axis"]),
    "split": _split,
    "slice": _slice,
    "iota": lambda _, equation: np.indices(equation.params["shape"])[equation.params["dimension"]].astype(object),
    "div": _by_kind("quotient_of_integers", "divide"),
    "rem": _by_kind("remainder_of_integers", "remainder"),
    "gt": lambda tracer, _, a, b: tracer.each("less", b, a),
    "ge": lambda tracer, _, a, b: tracer.each("less_or_equal", b, a),
    "square": lambda tracer, _, array: tracer.each("multiply", array, array),
    "rsqrt": lambda tracer, _, array: tracer.each("divide", 1.0, tracer.each("square_root", array)),
    "integer_pow": _integer_power,
    "logistic": _logistic,
    "round": _round,
    "clamp": lambda tracer, _, low, array, high: tracer.each("least", tracer.each("most", array, low), high),
    "select_n": _choose,
    "argmin": _extreme(least=True),
    "argmax": _extreme(least=False),
    **{f"reduce_{name}": _reduction(one) for name, one in (("sum", "add"), ("prod", "multiply"), ("min", "least"))},
    **{f"reduce_{name}": _reduction(one) for name, one in (("max", "most"), ("and", "both"), ("or", "either"))},
    "cumsum": _running("add"),
    "cumprod": _running("multiply"),
    "cummax": _running("most"),
    "cummin": _running("least"),
    "dot_general": _dot,
    "dynamic_slice": dynamic_slice,
    "gather": gather,
    **dict.fromkeys(("scatter", "scatter-add"), scatter),
    "scan": scan,
    "while": while_loop,
    "cond": cond,
}
"""All other primitives that can be printed, and how."""
