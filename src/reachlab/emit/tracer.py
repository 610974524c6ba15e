"""Equations of JAX on numbers of a program in place of arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from reachlab.emit.builder import Builder, elements, objects
from reachlab.emit.operations import INTEGER, REAL, TRUTH
from reachlab.emit.program import Carried, Loop, Variable, is_computed
from reachlab.settings.validation import InputError

Values = list[np.ndarray]
"""Arrays of numbers of a program, each an array of objects in its shape."""

Rule = Callable[..., Any]
"""What a primitive comes to: of the tracer, the equation and its arguments."""

PYTHON = {REAL: float, INTEGER: int, TRUTH: bool}
"""Numbers of Python by kind."""

CALLS = ("jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "checkpoint", "remat2")
"""Equations that are a function of their own."""


def kind_of_type(dtype: Any) -> str:
    """Kind of the numbers of an array."""
    return {"f": REAL, "b": TRUTH}.get(np.dtype(dtype).kind, INTEGER)


def constant_array(value: Any) -> np.ndarray:
    """A constant array as one of numbers of a program; a random key as it is."""
    return objects([value], ()) if _is_key(value) else np.asarray(value).astype(object)


def _is_key(value: Any) -> bool:
    return isinstance(value, jax.Array) and jax.dtypes.issubdtype(value.dtype, jax.dtypes.prng_key)  # pyright: ignore[reportPrivateImportUsage]


class Tracer:
    """Runs equations.

    Attributes:
        builder: of the program's statements.
    """

    def __init__(self, builder: Builder, operations: Mapping[str, str], rules: Mapping[str, Rule]) -> None:
        """With primitives that are an operation each, and rules for others."""
        self.builder, self._operations, self._rules = builder, operations, rules
        self._calls: list[Any] = []

    def run(self, closed: ClosedJaxpr | Jaxpr, arguments: Sequence[np.ndarray]) -> Values:
        """Results of a traced function."""
        closed = closed if isinstance(closed, ClosedJaxpr) else ClosedJaxpr(closed, ())
        known: dict[Any, np.ndarray] = dict(zip(closed.jaxpr.invars, arguments, strict=True))
        known.update(zip(closed.jaxpr.constvars, map(constant_array, closed.consts), strict=True))

        def read(variable: Any) -> np.ndarray:
            return constant_array(variable.val) if isinstance(variable, Literal) else known[variable]

        for equation in closed.jaxpr.eqns:
            results = self._results(equation, [read(variable) for variable in equation.invars])
            known.update(
                (one, _typed(result, one.aval.dtype)) for one, result in zip(equation.outvars, results, strict=True)
            )
        return [read(variable) for variable in closed.jaxpr.outvars]

    def _results(self, equation: Any, given: Values) -> Values:
        name, settings = equation.primitive.name, equation.params
        if name in CALLS:
            inner = next(settings[one] for one in ("jaxpr", "call_jaxpr", "fun_jaxpr") if one in settings)
            self._calls.append(equation)
            results = self.run(inner, given)
            self._calls.pop()
            return results
        of_bits = name in ("and", "or", "not") and kind_of_type(equation.outvars[0].aval.dtype) != TRUTH
        if name in self._operations and not of_bits:
            return [self.each(self._operations[name], *given)]
        if name in self._rules and not of_bits:
            result = self._rules[name](self, equation, *given)
            return result if isinstance(result, list) else [result]
        if not any(is_computed(one) for array in given for one in array.ravel()):
            return _evaluated(equation, given)
        raise InputError(
            f"{name!r} cannot be printed in Python, C and JavaScript, which {self.place(equation)} computes: use other"
            " functions of jax.numpy there."
        )

    def each(self, operation: str, *given: Any) -> np.ndarray:
        """An operation on arrays and numbers, which are broadcast."""
        return self.builder.elementwise(operation, *np.broadcast_arrays(*map(as_array, given)))

    def place(self, equation: Any) -> str:
        """Function, file and line of an equation, or of the calls that led to it, outside of JAX's own code."""
        inside = str(jax.__path__[0])
        for one in (equation, *reversed(self._calls)):
            for frame in getattr(one.source_info.traceback, "frames", ()):
                if not frame.file_name.startswith(inside):
                    return f"`{frame.function_name}` ({frame.file_name}, line {frame.line_num})"
        return "a function"

    def loop(
        self,
        first: Values,
        kinds: Sequence[str],
        body: Callable[[Values], Values],
        rounds: int | None,
        condition: Callable[[Values], np.ndarray] = lambda _: as_array(True),
    ) -> Values:
        """Arrays after rounds of a body: so many, or as long as a condition holds."""
        builder = self.builder
        made = [self._carried(array, kind) for array, kind in zip(first, kinds, strict=True)]
        arrays = [array for _, array in made]
        builder.begin()
        asked = condition(arrays).ravel()[0]
        before = builder.end()
        firsts = [self._parts(array, each) for (each, _), array in zip(made, first, strict=True)]
        builder.begin()
        thens = [self._parts(array, each) for (each, _), array in zip(made, body(arrays), strict=True)]
        inside = builder.end()
        carried = [
            Carried(*row)
            for (each, _), *sides in zip(made, firsts, thens, strict=True)
            for row in zip(each, *sides, strict=True)
        ]
        builder.loop(Loop(tuple(carried), inside, rounds, before, asked))
        return arrays

    def _carried(self, first: np.ndarray, kind: str) -> tuple[list[Variable], np.ndarray]:
        """Variables that a loop carries for an array, and the array of them."""
        if first.size >= self.builder.wide:
            variable = self.builder.carry(kind, first.size)
            return [variable], elements(variable, first.size, first.shape)
        each = [self.builder.carry(kind) for _ in range(first.size)]
        return each, objects(each, first.shape)

    def _parts(self, array: np.ndarray, variables: list[Variable]) -> list[Any]:
        atoms = array.ravel().tolist()
        return [self.builder.as_slice(atoms)] if variables and variables[0].size is not None else atoms


def as_array(value: Any) -> np.ndarray:
    """A number as an array of one, and an array as it is."""
    return value if isinstance(value, np.ndarray) else objects([value], ())


def _typed(array: np.ndarray, dtype: Any) -> np.ndarray:
    """An array whose constants are numbers of Python as its type has them: what is made of them has its kind."""
    if jax.dtypes.issubdtype(dtype, jax.dtypes.prng_key):  # pyright: ignore[reportPrivateImportUsage]
        return array
    kind = PYTHON[kind_of_type(dtype)]
    if all(is_computed(one) or type(one) is kind for one in array.flat):
        return array
    return objects([one if is_computed(one) else kind(one) for one in array.flat], array.shape)


def _evaluated(equation: Any, given: Values) -> Values:
    """Results of an equation of constants, by JAX itself: as of random numbers of a constant key."""
    arguments = [
        array[()] if array.ndim == 0 and _is_key(array[()]) else jnp.array(array.tolist(), variable.aval.dtype)
        for variable, array in zip(equation.invars, given, strict=True)
    ]
    results = equation.primitive.bind(*arguments, **equation.params)
    return list(map(constant_array, results if equation.primitive.multiple_results else [results]))
