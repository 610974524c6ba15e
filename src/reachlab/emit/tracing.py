"""Functions of JAX as programs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np

from reachlab.emit.builder import Builder, elements
from reachlab.emit.liveness import live_program
from reachlab.emit.operations import REAL
from reachlab.emit.packing import packed
from reachlab.emit.program import Constant, Output, Program, Variable
from reachlab.emit.rules import ELEMENTWISE, RULES
from reachlab.emit.tracer import Tracer, kind_of_type

TRACED_WIDE = 8
"""Numbers from which on an operation is one on an array before several are packed into one."""


def trace(
    name: str,
    function: Callable[..., Mapping[str, Any]],
    inputs: Mapping[str, jax.ShapeDtypeStruct],
    constants: Mapping[str, np.ndarray] | None = None,
) -> Program:
    """The program of a function that can be traced.

    Args:
        name: its name.
        function: takes arrays by the names of `inputs`, gives arrays by name.
        inputs: shapes and types of its arguments.
        constants: names for arrays that it closes over; others are numbered.

    Raises:
        InputError: it computes something that cannot be printed.
    """
    closed, shapes = jax.make_jaxpr(lambda given: function(**given), return_shape=True)(dict(inputs))
    names, tracer = (
        sorted(inputs),
        Tracer(Builder(TRACED_WIDE), ELEMENTWISE, RULES),
    )  # in the order in which JAX flattens a dict
    arguments = [Variable(kind_of_type(inputs[one].dtype), int(np.prod(inputs[one].shape)), one) for one in names]
    given = [elements(one, one.size or 0, inputs[one.name].shape) for one in arguments]
    results = tracer.run(closed, given)
    outputs = tuple(Output(one, tuple(array.ravel())) for one, array in zip(sorted(shapes), results, strict=True))
    named = tuple(Constant(Variable(REAL), one, array) for one, array in (constants or {}).items())
    program = Program(name, tuple(arguments), named, tracer.builder.statements, outputs)
    return packed(live_program(program, tracer.builder.constants.values()))
