"""What JAX's loops and cases come to on numbers of a program."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from reachlab.emit.tracer import Tracer, Values, as_array, kind_of_type


def scan(tracer: Tracer, equation: Any, *given: np.ndarray) -> Values:
    """See JAX's `scan`: a loop where nothing is kept of its rounds, which are written one after the other otherwise."""
    settings, body = equation.params, equation.params["jaxpr"]
    constants, carries, length = settings["num_consts"], settings["num_carry"], settings["length"]
    fixed, now, rows = given[:constants], list(given[constants : constants + carries]), given[constants + carries :]
    if not rows and len(body.jaxpr.outvars) == carries:
        kinds = [kind_of_type(one.aval.dtype) for one in body.jaxpr.invars[constants:]]
        return tracer.loop(now, kinds, lambda now: tracer.run(body, [*fixed, *now]), length)
    step, kept = -1 if settings["reverse"] else 1, []
    for i in range(length)[::step]:
        after = tracer.run(body, [*fixed, *now, *(as_array(row[i]) for row in rows)])
        now, results = after[:carries], after[carries:]
        kept.append(results)
    if not kept:
        return now + [np.empty(one.aval.shape, object) for one in equation.outvars[carries:]]
    return now + [np.stack(each) for each in zip(*kept[::step], strict=True)]


def while_loop(tracer: Tracer, equation: Any, *given: np.ndarray) -> Values:
    """See JAX's `while_loop`."""
    settings, body = equation.params, equation.params["body_jaxpr"]
    one, other = settings["cond_nconsts"], settings["cond_nconsts"] + settings["body_nconsts"]
    kinds = [kind_of_type(each.aval.dtype) for each in body.jaxpr.invars[other - one :]]
    return tracer.loop(
        list(given[other:]),
        kinds,
        lambda now: tracer.run(body, [*given[one:other], *now]),
        None,
        lambda now: tracer.run(settings["cond_jaxpr"], [*given[:one], *now])[0],
    )


def cond(tracer: Tracer, equation: Any, chosen: np.ndarray, *given: np.ndarray) -> Values:
    """All branches are computed, and one is chosen."""
    branches = [tracer.run(one, given) for one in equation.params["branches"]]
    return [case(tracer, chosen, cases) for cases in zip(*branches, strict=True)]


def case(tracer: Tracer, chosen: np.ndarray, cases: Sequence[np.ndarray]) -> np.ndarray:
    """The case of a number that is chosen."""
    result = cases[-1]
    for number in reversed(range(len(cases) - 1)):
        result = tracer.each("choose", tracer.each("less_or_equal", chosen, number), cases[number], result)
    return result
