"""Small typed programs: what a traced function computes, as statements on numbers and on flat arrays of numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from reachlab.emit.operations import INTEGER, REAL, TRUTH, TRUTHS

Number = float | int | bool


@dataclass(frozen=True, eq=False)
class Variable:
    """A number, or a flat array of so many numbers.

    Attributes:
        kind: of its numbers.
        size: of the array; None of a single number.
        name: of an input; empty of what is computed.
    """

    kind: str
    size: int | None = None
    name: str = ""


@dataclass(frozen=True)
class Element:
    """A number of an array."""

    array: Variable
    index: int


Atom = Number | Variable | Element
"""A constant, or a single number that is known when it is used."""


@dataclass(frozen=True)
class Slice:
    """Numbers of an array that stand one after the other, from the first one on."""

    array: Variable
    first: int


Operand = Atom | Slice
"""What an array is computed of, number by number: a number for all of them, or part of an array."""


@dataclass(frozen=True)
class Compute:
    """`target` is the result of an operation of `OPERATIONS`; of an array number by number."""

    target: Variable
    operation: str
    operands: tuple[Operand, ...]


@dataclass(frozen=True)
class Pack:
    """`target` is an array of these numbers."""

    target: Variable
    atoms: tuple[Atom, ...]


@dataclass(frozen=True)
class Join:
    """`target` is an array of parts of others, of so many numbers each."""

    target: Variable
    parts: tuple[Slice, ...]
    sizes: tuple[int, ...]


@dataclass(frozen=True)
class Gather:
    """`target` is an array of the numbers at `indices` of another."""

    target: Variable
    source: Variable
    indices: tuple[int, ...]


@dataclass(frozen=True)
class Take:
    """`target` is the number of an array at `index`, which is computed."""

    target: Variable
    source: Variable
    index: Atom


@dataclass(frozen=True)
class Product:
    """`target [m, n]` is the matrix product of `left [m, k]` and `right [k, n]`."""

    target: Variable
    left: Slice
    right: Slice
    shape: tuple[int, int, int]


class Carried(NamedTuple):
    """A variable that a loop carries on: what it is at first, and what it becomes in each round."""

    variable: Variable
    first: Operand
    then: Operand


@dataclass(frozen=True)
class Loop:
    """Rounds of a body: so many, or as long as a condition holds, which is computed `before` each."""

    carried: tuple[Carried, ...]
    body: tuple[Statement, ...]
    rounds: int | None = None
    before: tuple[Statement, ...] = ()
    condition: Atom = True


Statement = Compute | Pack | Join | Gather | Take | Product | Loop


class Output(NamedTuple):
    """A result: its name and its numbers."""

    name: str
    atoms: tuple[Atom, ...]


class Constant(NamedTuple):
    """A constant array: the variable that is read, its name outside of the program, and its numbers."""

    variable: Variable
    name: str
    array: np.ndarray


@dataclass(frozen=True)
class Program:
    """A function of arrays, without anything that it does not need.

    Attributes:
        name: of the function.
        inputs: its arguments.
        constants: arrays that it reads.
        body: its statements.
        outputs: its results.
    """

    name: str
    inputs: tuple[Variable, ...]
    constants: tuple[Constant, ...]
    body: tuple[Statement, ...]
    outputs: tuple[Output, ...]

    def reads(self, begin: str) -> bool:
        """Whether it depends on an input whose name begins so."""
        return any(one.name.startswith(begin) for statement in self.body for one in reads(statement))


def constants_of(programs: Sequence[Program]) -> dict[str, np.ndarray]:
    """Constants of programs by name."""
    return {one.name: one.array for program in programs for one in program.constants}


def is_computed(atom: Any) -> bool:
    """Whether a number is known only when the program runs."""
    return isinstance(atom, (Variable, Element))


def kind_of(part: Any) -> str:
    """Kind of a number, or of those of a part of an array."""
    if isinstance(part, (Element, Slice)):
        return part.array.kind
    if isinstance(part, Variable):
        return part.kind
    return TRUTH if isinstance(part, bool) else INTEGER if isinstance(part, int) else REAL


def result_kind(operation: str, operands: Sequence[Any]) -> str:
    """Kind of the result of an operation."""
    if operation in TRUTHS:
        return TRUTH
    return operation if operation in (REAL, INTEGER) else kind_of(operands[-1])


def variables(parts: Iterable[Any]) -> set[Variable]:
    """Variables in operands."""
    return {
        part.array if isinstance(part, (Element, Slice)) else part for part in parts if not isinstance(part, Number)
    }


def reads(statement: Statement) -> set[Variable]:
    """Variables that a statement reads, and of a loop those that it does not make itself."""
    match statement:
        case Compute(operands=parts) | Pack(atoms=parts) | Join(parts=parts):
            return variables(parts)
        case Gather(source=source):
            return {source}
        case Take(source=source, index=index):
            return {source} | variables([index])
        case Product(left=left, right=right):
            return variables((left, right))
        case Loop(carried=carried, before=before, body=body):
            parts = [part for one in carried for part in (one.first, one.then)]
            found, made = variables([*parts, statement.condition]), {one.variable for one in carried}
            for one in (*before, *body):
                found |= reads(one)
                made |= makes(one)
            return found - made


def makes(statement: Statement) -> set[Variable]:
    """Variables that are known after a statement."""
    return {one.variable for one in statement.carried} if isinstance(statement, Loop) else {statement.target}
