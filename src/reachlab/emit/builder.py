"""How programs are made: statement by statement, each once and as far out of loops as it can be, constants folded."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from reachlab.emit.operations import FUNCTIONS, INTEGER, REAL, TRUTH
from reachlab.emit.program import (
    Atom,
    Compute,
    Element,
    Gather,
    Join,
    Loop,
    Operand,
    Pack,
    Product,
    Slice,
    Statement,
    Take,
    Variable,
    is_computed,
    kind_of,
    reads,
    result_kind,
)

WIDE = 16
"""Numbers from which on an operation is one on an array: for fewer, NumPy takes longer than Python does."""

LONG = 8
"""Numbers that stand one after the other from which on arrays are joined, in place of their numbers."""

FEW = 2
"""Rows from each of several arrays, on average, up to which rows are joined one by one, and not taken out of all."""

APART = 64
"""Numbers that stand one after the other from which on those beside them, from elsewhere, get arrays of their own."""

Key = tuple[Any, ...]


def _key(part: Any) -> Any:
    """What tells operands apart: 1, 1.0 and True are not the same, nor are 0.0 and -0.0."""
    return (type(part), repr(part)) if isinstance(part, (bool, int, float)) else part


@dataclass
class Scope:
    """Statements under way, and what is already computed in them."""

    statements: list[Statement] = field(default_factory=list)
    known: dict[Key, Variable] = field(default_factory=dict)


class Builder:
    """Statements of a program under way.

    Attributes:
        wide: numbers from which on an operation is one on an array.
        constants: constant arrays with their variables.
    """

    def __init__(self, wide: int = WIDE) -> None:
        """Nothing is computed yet."""
        self.wide = wide
        self.constants: dict[Key, tuple[Variable, np.ndarray]] = {}
        self._scopes, self._depths = [Scope()], dict[Variable, int]()

    @property
    def statements(self) -> tuple[Statement, ...]:
        """What there is of the program outside of loops."""
        return tuple(self._scopes[0].statements)

    # --- numbers ------------------------------------------------------------------------------------

    def compute(self, operation: str, *operands: Any) -> Any:
        """The result of an operation on single numbers."""
        if not any(map(is_computed, operands)):
            return FUNCTIONS[operation](*operands)
        simpler = simplified(operation, operands)
        if simpler is not None:
            return simpler
        return self._add(Compute, Variable(result_kind(operation, operands)), operation, operands)

    def elementwise(self, operation: str, *operands: np.ndarray) -> np.ndarray:
        """The same of arrays `[...]` of numbers that all have one shape."""
        shape, size = operands[0].shape, operands[0].size
        flat = [operand.ravel().tolist() for operand in operands]
        if size < self.wide or not any(map(is_computed, itertools.chain(*flat))):
            return objects([self.compute(operation, *one) for one in zip(*flat, strict=True)], shape)
        parts = [self._operand(operand) for operand in flat]
        if not any(isinstance(part, Slice) for part in parts):
            return objects([self.compute(operation, *parts)] * size, shape)
        simpler = simplified(operation, parts)
        if simpler is not None:
            return elements(simpler, size, shape)
        kind = result_kind(operation, [operand[0] for operand in flat])
        return elements(self._add(Compute, Variable(kind, size), operation, parts), size, shape)

    def take(self, source: Variable, index: Atom) -> Atom:
        """The number of an array at an index that is computed."""
        return self._add(Take, Variable(source.kind), source, index)

    def product(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Matrix product `[m, n]` of `[m, k]` and `[k, n]`."""
        (m, k), n = left.shape, right.shape[1]
        sides = [self.as_slice(side.ravel().tolist()) for side in (left, right)]
        return elements(self._add(Product, Variable(REAL, m * n), *sides, (m, k, n)), m * n, (m, n))

    # --- arrays -------------------------------------------------------------------------------------

    def _operand(self, atoms: list[Any]) -> Operand:
        """What an operation on arrays is given: one number where all are the same, else part of an array."""
        return atoms[0] if all(_key(one) == _key(atoms[0]) for one in atoms[1:]) else self.as_slice(atoms)

    def as_slice(self, atoms: list[Any]) -> Slice:
        """Numbers as part of an array, which is made where there is none."""
        if not any(map(is_computed, atoms)):
            return Slice(self._constant(np.array(atoms)), 0)
        kind = next(kind_of(one) for one in atoms if is_computed(one))
        if all(isinstance(one, Element) for one in atoms):
            firsts = [i for i, one in enumerate(atoms) if not i or one != _next(atoms[i - 1])]
            if len(firsts) == 1:
                return Slice(atoms[0].array, atoms[0].index)
            arrays = list(dict.fromkeys(one.array for one in atoms))
            if len(arrays) == 1:
                indices = [one.index for one in atoms]
                return Slice(self._add(Gather, Variable(kind, len(atoms)), arrays[0], indices), 0)
            if LONG * len(firsts) <= len(atoms):
                return self._joined(atoms, firsts, arrays)
        if len(stretches := _stretches(atoms)) > 1:
            parts = [self.as_slice(one) for one in stretches]
            return Slice(self._add(Join, Variable(kind, len(atoms)), parts, [*map(len, stretches)]), 0)
        places: dict[Any, int] = {}
        indices = [places.setdefault(_key(one), len(places)) for one in atoms]
        if 2 * len(places) > len(atoms):
            return Slice(self._add(Pack, Variable(kind, len(atoms)), atoms), 0)
        each = dict(zip(indices, atoms, strict=True))
        packed = self._add(Pack, Variable(kind, len(places)), [each[i] for i in range(len(places))])
        return Slice(self._add(Gather, Variable(kind, len(atoms)), packed, indices), 0)

    def _joined(self, atoms: list[Any], firsts: list[int], arrays: list[Variable]) -> Slice:
        """Numbers of some arrays in rows that begin at `firsts`; taken out of all, if there are many rows of each."""
        kind = kind_of(atoms[0])
        if len(firsts) <= FEW * len(arrays):
            sizes = [end - first for first, end in itertools.pairwise([*firsts, len(atoms)])]
            parts = [Slice(atoms[i].array, atoms[i].index) for i in firsts]
            return Slice(self._add(Join, Variable(kind, len(atoms)), parts, sizes), 0)
        sizes = [one.size or 0 for one in arrays]
        ends = dict(zip(arrays, np.cumsum(sizes).tolist(), strict=True))
        whole = self._add(Join, Variable(kind, sum(sizes)), [Slice(one, 0) for one in arrays], sizes)
        indices = [ends[one.array] - one.array.size + one.index for one in atoms]
        return Slice(self._add(Gather, Variable(kind, len(atoms)), whole, indices), 0)

    def is_at_hand(self, atoms: list[Any]) -> bool:
        """Whether nothing has to be put side by side to operate on these numbers."""
        alike = all(_key(one) == _key(atoms[0]) for one in atoms)
        row = all(isinstance(a, Element) and b == _next(a) for a, b in itertools.pairwise(atoms))
        return alike or row or not any(map(is_computed, atoms))

    def _constant(self, array: np.ndarray) -> Variable:
        """A constant array, in single precision if it is the same there; equal ones are the same."""
        if array.dtype.kind == "f" and np.array_equal(array, array.astype(np.float32), equal_nan=True):
            array = array.astype(np.float32)
        kind = {"f": REAL, "b": TRUTH}.get(array.dtype.kind, INTEGER)
        return self.constants.setdefault((kind, array.tobytes()), (Variable(kind, array.size), array))[0]

    def _add(self, statement: Any, target: Variable, *parts: Any) -> Variable:
        parts = tuple(tuple(part) if isinstance(part, list) else part for part in parts)
        key = (statement, *(tuple(map(_key, part)) if type(part) is tuple else _key(part) for part in parts))
        for scope in self._scopes:
            if key in scope.known:
                return scope.known[key]
        made = statement(target, *parts)
        # As far out as what it reads: once, in place of once a round.
        depth = self._depths[target] = max((self._depths.get(one, 0) for one in reads(made)), default=0)
        self._scopes[depth].known[key] = target
        self._scopes[depth].statements.append(made)
        return target

    # --- loops --------------------------------------------------------------------------------------

    def carry(self, kind: str, size: int | None = None) -> Variable:
        """A variable that the loop which begins next carries on."""
        variable = Variable(kind, size)
        self._depths[variable] = len(self._scopes)
        return variable

    def begin(self) -> None:
        """Begin a block of a loop, whose results are not known outside."""
        self._scopes.append(Scope())

    def end(self) -> tuple[Statement, ...]:
        """End it, and give its statements."""
        return tuple(self._scopes.pop().statements)

    def loop(self, loop: Loop) -> None:
        """Add a loop, after which what it has carried is known."""
        self._scopes[-1].statements.append(loop)
        self._depths |= {one.variable: len(self._scopes) - 1 for one in loop.carried}


def _stretches(atoms: list[Any]) -> list[list[Any]]:
    """Numbers in stretches, of which every other is a long part of an array."""
    found = [list[Any]()]
    for row in _rows(atoms):
        if len(row) >= APART:
            found += [row, []]
        else:
            found[-1] += row
    return [one for one in found if one]


def _rows(atoms: list[Any]) -> Iterator[list[Any]]:
    """Numbers that stand one after the other in an array, and others by themselves."""
    row = list[Any]()
    for one in atoms:
        if row and not (isinstance(one, Element) and isinstance(row[-1], Element) and one == _next(row[-1])):
            yield row
            row = []
        row.append(one)
    if row:
        yield row


def _next(element: Any) -> Any:
    return Element(element.array, element.index + 1)


def elements(of: Any, size: int, shape: tuple[int, ...]) -> np.ndarray:
    """The numbers of an array or of a part of one, or one number over and over, in a shape."""
    array, first = (of.array, of.first) if isinstance(of, Slice) else (of, 0)
    if not isinstance(array, Variable) or array.size is None:
        return objects([of] * size, shape)
    return objects([Element(array, first + i) for i in range(size)], shape)


def objects(atoms: Sequence[Any], shape: tuple[int, ...]) -> np.ndarray:
    """Numbers as an array of objects."""
    array = np.empty(len(atoms), object)
    for i, atom in enumerate(atoms):
        array[i] = atom
    return array.reshape(shape)


def simplified(operation: str, operands: Sequence[Any]) -> Any:
    """What an operation on finite numbers comes to without being computed; None where it has to be."""

    def known(number: Any, value: float) -> bool:
        return isinstance(number, (bool, int, float)) and number == value

    a, b = operands[0], operands[-1]
    bound = {"least": math.inf, "most": -math.inf}.get(operation)
    match operation:
        case "add":
            return b if known(a, 0) else a if known(b, 0) else None
        case "multiply" if known(a, 0) or known(b, 0):
            return 0.0 if kind_of(b) == REAL else 0
        case "multiply":
            return b if known(a, 1) else a if known(b, 1) else None
        case "subtract" | "divide":
            return a if known(b, operation == "divide") else None
        case "least" | "most" if bound is not None:
            return a if known(b, bound) else b if known(a, bound) else None
        case "choose" if isinstance(a, bool):
            return operands[1 if a else 2]
        case "choose":
            return b if _key(operands[1]) == _key(b) else None
        case "both" | "either" if isinstance(a, bool) or isinstance(b, bool):
            one, other = (a, b) if isinstance(a, bool) else (b, a)
            return other if one == (operation == "both") else one
    return None
