"""Operations on arrays that do not wait for each other, done at once: NumPy takes as long to begin one as to do it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from reachlab.emit.builder import Builder, elements, objects
from reachlab.emit.liveness import live_program
from reachlab.emit.program import (
    Carried,
    Compute,
    Element,
    Gather,
    Join,
    Loop,
    Pack,
    Product,
    Program,
    Slice,
    Statement,
    Take,
    Variable,
    is_computed,
    makes,
    reads,
)


def packed(program: Program) -> Program:
    """The same program with fewer operations on arrays, each on more numbers."""
    builder = Builder()
    packer = _Packer(builder, program)
    packer.block(program.body)
    outputs = tuple(one._replace(atoms=tuple(map(packer.atom, one.atoms))) for one in program.outputs)
    again = replace(program, body=builder.statements, outputs=outputs)
    return live_program(again, builder.constants.values())


class _Packer:
    """Takes the statements of a program anew, those of one kind together.

    Attributes:
        known: numbers of the new program by variable of the old one.
    """

    def __init__(self, builder: Builder, program: Program) -> None:
        self._builder = builder
        self.known: dict[Variable, list[Any]] = {}
        self.known.update((one, _elements(one)) for one in program.inputs)
        self.known.update((one.variable, one.array.ravel().tolist()) for one in program.constants)

    def atom(self, atom: Any) -> Any:
        """A number of the new program."""
        if not is_computed(atom):
            return atom
        return self.known[atom.array][atom.index] if isinstance(atom, Element) else self.known[atom][0]

    def _atoms(self, operand: Any, size: int) -> list[Any]:
        if isinstance(operand, Slice):
            return self.known[operand.array][operand.first : operand.first + size]
        return [self.atom(operand)] * size

    def block(self, statements: Sequence[Statement]) -> None:
        """Take statements, in the order of how much has to be known before each."""
        levels: dict[Variable, int] = {}
        rows: dict[int, list[Statement]] = defaultdict(list)
        for one in statements:
            level = 1 + max((levels.get(each, 0) for each in reads(one)), default=0)
            levels |= dict.fromkeys(makes(one), level)
            rows[level].append(one)
        for level in sorted(rows):
            self._row(rows[level])

    def _row(self, statements: Iterable[Statement]) -> None:
        """Take statements that do not wait for each other."""
        groups: dict[Any, list[Any]] = defaultdict(list)
        for one in statements:
            match one:
                case Compute(target=target, operation=operation) if target.size is not None:
                    groups[operation, target.kind].append(one)
                case Loop(rounds=int()) if all(each.variable.size for each in one.carried):
                    groups[one.rounds, *((each.variable.kind, each.variable.size) for each in one.carried)].append(one)
                case _:
                    groups[id(one)].append(one)
        for group in groups.values():
            if isinstance(group[0], Compute) and group[0].target.size is not None:
                self._computed(group)
            else:
                self._others(*group)

    def _computed(self, group: list[Compute]) -> None:
        """Take operations of one kind on arrays: together, where more is saved by it than put side by side for it.

        If not of all of them, then of those which operate on the same arrays.
        """
        sizes = [one.target.size or 0 for one in group]
        rows = [[self._atoms(part, size) for part in one.operands] for one, size in zip(group, sizes, strict=True)]
        sides = [[atom for part in column for atom in part] for column in zip(*rows, strict=True)]
        costs = sum(not self._builder.is_at_hand(side) for side in sides)
        if len(group) > 1 and len(group) - 1 <= costs:
            alike: dict[Any, list[Compute]] = defaultdict(list)
            for one, row in zip(group, rows, strict=True):
                alike[tuple(part[0].array if isinstance(part[0], Element) else None for part in row)].append(one)
            for part in alike.values() if len(alike) > 1 else ([one] for one in group):
                self._computed(part)
            return
        arrays = [objects(side, (len(side),)) for side in sides]
        result = self._builder.elementwise(group[0].operation, *arrays).tolist()
        for one, end, size in zip(group, np.cumsum(sizes).tolist(), sizes, strict=True):
            self.known[one.target] = result[end - size : end]

    def _others(self, one: Any, *alike: Loop) -> None:
        """Take a statement of another kind, or loops that are alike."""
        builder = self._builder
        match one:
            case Compute(operation=operation, operands=operands):
                result = [builder.compute(operation, *map(self.atom, operands))]
            case Pack(atoms=atoms):
                result = list(map(self.atom, atoms))
            case Join(parts=parts, sizes=sizes):
                result = [atom for part, size in zip(parts, sizes, strict=True) for atom in self._atoms(part, size)]
            case Gather(source=source, indices=indices):
                result = [self.known[source][index] for index in indices]
            case Take(source=source, index=index):
                part = builder.as_slice(self.known[source])
                result = [builder.take(part.array, builder.compute("add", self.atom(index), part.first))]
            case Product(left=left, right=right, shape=(m, k, n)):
                a = objects(self._atoms(left, m * k), (m, k))
                result = builder.product(a, objects(self._atoms(right, k * n), (k, n))).ravel().tolist()
            case _:
                self._loops([one, *alike])
                return
        self.known[one.target] = result

    def _loops(self, loops: list[Loop]) -> None:
        """Take loops of as many rounds as one."""
        builder, rows = self._builder, list(zip(*(one.carried for one in loops), strict=True))
        made = []
        for row in rows:
            size = row[0].variable.size
            made.append(builder.carry(row[0].variable.kind, None if size is None else size * len(row)))
        firsts = [self._joined([one.first for one in row], row[0].variable.size) for row in rows]
        for row, whole in zip(rows, made, strict=True):
            for number, one in enumerate(row):
                size = one.variable.size
                self.known[one.variable] = [whole] if size is None else _elements(whole)[number * size :][:size]
        builder.begin()
        for one in loops:
            self.block(one.before)
        condition = self.atom(loops[0].condition)
        before = builder.end()
        builder.begin()
        # Alike ones one after the other, as they are put together.
        alike = len({len(one.body) for one in loops}) == 1
        bodies = zip(*(one.body for one in loops), strict=True) if alike else [one.body for one in loops]
        self.block([statement for row in bodies for statement in row])
        thens = [self._joined([one.then for one in row], row[0].variable.size) for row in rows]
        body = builder.end()
        carried = tuple(Carried(*each) for each in zip(made, firsts, thens, strict=True))
        builder.loop(Loop(carried, body, loops[0].rounds, before, condition))

    def _joined(self, operands: list[Any], size: int | None) -> Any:
        if size is None:
            return self.atom(operands[0])
        return self._builder.as_slice([atom for one in operands for atom in self._atoms(one, size)])


def _elements(array: Variable) -> list[Any]:
    return elements(array, array.size or 0, (-1,)).tolist()
