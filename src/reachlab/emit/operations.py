"""Operations on numbers, and how each is written in Python, on arrays of NumPy, in C99 and in JavaScript."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, NamedTuple

REAL, INTEGER, TRUTH = "real", "integer", "truth"
"""Kinds of numbers."""

PYTHON_HEAD = """\
from math import acos, asin, atan, atan2, ceil, copysign, cos, exp, floor, fmod, inf, isfinite, isnan, log, nan, sin
from math import sqrt, tan, tanh


def divide(a, b):
    if b:
        return a / b
    return nan if a == 0.0 or isnan(a) else copysign(inf, a) * copysign(1.0, b)


def power(a, b):
    try:
        raised = a**b
    except (OverflowError, ZeroDivisionError):
        return inf
    return nan if isinstance(raised, complex) else raised
"""
"""What the operations in Python need: where `math` raises an error, arrays give a number that is not finite."""


class Operation(NamedTuple):
    """An operation on the operands `{0}`, `{1}` and `{2}`; what is not given is written as in the language before."""

    python: str
    numpy: str = ""
    c: str = ""
    javascript: str = ""


def _function(python: str, name: str, *, numpy: str = "") -> Operation:
    """An operation that is a function of one number everywhere, in C one of `math.h` for its own type."""
    known = numpy or name
    return Operation(python, f"np.{known}({{0}})", f"{name.upper()}({{0}})", f"Math.{name}({{0}})")


OPERATIONS: dict[str, Operation] = {
    "add": Operation("{0} + {1}"),
    "subtract": Operation("{0} - {1}"),
    "multiply": Operation("{0} * {1}"),
    "divide": Operation("{0} / {1} if {1} else divide({0}, {1})", "{0} / {1}"),
    "remainder": Operation(
        "fmod({0}, {1}) if {1} and isfinite({0}) else nan", "np.fmod({0}, {1})", "FMOD({0}, {1})", "{0} % {1}"
    ),
    "remainder_of_integers": Operation(
        "int(fmod({0}, {1})) if {1} else 0", "np.fmod({0}, {1})", "{1} ? {0} % {1} : 0", "{1} ? {0} % {1} : 0"
    ),
    "quotient_of_integers": Operation(
        "int({0} / {1}) if {1} else 0",
        "np.trunc({0} / {1}).astype(int)",
        "{1} ? {0} / {1} : 0",
        "{1} ? Math.trunc({0} / {1}) : 0",
    ),
    "negative": Operation("-{0}"),
    "absolute": Operation("abs({0})", "np.abs({0})", "FABS({0})", "Math.abs({0})"),
    "sign": Operation("1 if {0} > 0 else -1 if {0} < 0 else {0}", "np.sign({0})", "{0} > 0 ? 1 : {0} < 0 ? -1 : {0}"),
    "square_root": _function("sqrt({0}) if {0} >= 0.0 else nan", "sqrt"),
    "sine": _function("sin({0}) if isfinite({0}) else nan", "sin"),
    "cosine": _function("cos({0}) if isfinite({0}) else nan", "cos"),
    "tangent": _function("tan({0}) if isfinite({0}) else nan", "tan"),
    "arc_sine": _function("asin({0}) if -1.0 <= {0} <= 1.0 else nan", "asin", numpy="arcsin"),
    "arc_cosine": _function("acos({0}) if -1.0 <= {0} <= 1.0 else nan", "acos", numpy="arccos"),
    "arc_tangent": _function("atan({0})", "atan", numpy="arctan"),
    "arc_tangent_of_two": Operation(
        "atan2({0}, {1})", "np.arctan2({0}, {1})", "ATAN2({0}, {1})", "Math.atan2({0}, {1})"
    ),
    "exponential": _function("exp({0}) if {0} < 709.78 else {0} * inf", "exp"),
    "logarithm": _function("log({0}) if {0} > 0.0 else nan if {0} else -inf", "log"),
    "hyperbolic_tangent": _function("tanh({0})", "tanh"),
    "power": Operation("power({0}, {1})", "np.power({0}, {1})", "POW({0}, {1})", "Math.pow({0}, {1})"),
    "floor": _function("float(floor({0})) if isfinite({0}) else {0}", "floor"),
    "ceiling": _function("float(ceil({0})) if isfinite({0}) else {0}", "ceil"),
    "round": Operation("float(round({0})) if isfinite({0}) else {0}", "np.round({0})", "RINT({0})", "toEven({0})"),
    # Of what is not a number nothing is least or most, and the sum is none either: as in JAX and NumPy.
    "least": Operation(
        "{0} if {0} <= {1} else {1} if {1} < {0} else {0} + {1}",
        "np.minimum({0}, {1})",
        "{0} <= {1} ? {0} : {1} < {0} ? {1} : {0} + {1}",
    ),
    "most": Operation(
        "{0} if {0} >= {1} else {1} if {1} > {0} else {0} + {1}",
        "np.maximum({0}, {1})",
        "{0} >= {1} ? {0} : {1} > {0} ? {1} : {0} + {1}",
    ),
    "less": Operation("{0} < {1}"),
    "less_or_equal": Operation("{0} <= {1}"),
    "equal": Operation("{0} == {1}"),
    "unequal": Operation("{0} != {1}"),
    "both": Operation("{0} and {1}", "{0} & {1}", "{0} && {1}"),
    "either": Operation("{0} or {1}", "{0} | {1}", "{0} || {1}"),
    "no": Operation("not {0}", "~{0}", "!{0}"),
    "choose": Operation("{1} if {0} else {2}", "np.where({0}, {1}, {2})", "{0} ? {1} : {2}"),
    "real": Operation("float({0})", "({0}).astype(float)", "(real) {0}", "+{0}"),
    "integer": Operation(
        "int(min(max({0}, -2147483520.0), 2147483520.0)) if {0} == {0} else 0",
        "np.clip(np.nan_to_num({0}), -2147483520.0, 2147483520.0).astype(int)",
        "WHOLE({0})",
        "Math.trunc(Math.min(Math.max({0}, -2147483520), 2147483520)) || 0",
    ),
    "finite": Operation("isfinite({0})", "np.isfinite({0})", "isfinite({0})", "Number.isFinite({0})"),
}
"""What can be computed of numbers, by name."""

TRUTHS = frozenset({"less", "less_or_equal", "equal", "unequal", "both", "either", "no", "finite"})
"""Operations whose result is a truth; `real` and `integer` give their name's kind, all others what they are given."""


def written(operation: str, language: str) -> str:
    """An operation in a language."""
    row = OPERATIONS[operation]
    return next(text for text in row[row._fields.index(language) :: -1] if text)


def _functions() -> dict[str, Callable[..., Any]]:
    names: dict[str, Any] = {}
    exec(PYTHON_HEAD, names)  # noqa: S102
    texts = {name: re.sub(r"\{(\d)\}", r"x[\1]", one.python) for name, one in OPERATIONS.items()}
    return {name: eval(f"lambda *x: {text}", names) for name, text in texts.items()}  # noqa: S307


FUNCTIONS = _functions()
"""The operations in Python as functions, for what is known already."""
