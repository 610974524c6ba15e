"""Programs as straight code in Python: floats, and arrays of NumPy where there are many numbers."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Iterator, Sequence, Set
from typing import Any

from reachlab.emit.operations import PYTHON_HEAD, written
from reachlab.emit.program import (
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
    makes,
    reads,
    variables,
)

INDENT = "    "


def to_python(programs: Sequence[Program], pausing: Collection[str] = ()) -> str:
    """A module with a function for each program, which reads its constants from a dict `CONSTANTS` of flat arrays.

    A function takes lists of numbers, and gives a tuple of lists. Those whose names are in `pausing` are generators,
    which pause after each round of their loops.
    """
    functions = (PythonPrinter(one, pauses=one.name in pausing).text() for one in programs)
    return "\n\n".join([PYTHON_HEAD.replace("\n\n", "\n\nimport numpy as np\n\n", 1), *functions])


class PythonPrinter:
    """A program in Python: an array is `a_…`, and as a list, whose numbers Python takes sooner, without that."""

    def __init__(self, program: Program, *, pauses: bool) -> None:
        """Of a program; a generator, if it `pauses`."""
        self._program, self._pauses = program, pauses
        self._names = {one: one.name for one in program.inputs}
        self._names |= {one.variable: f"{program.name}_k{number}" for number, one in enumerate(program.constants)}
        self._free, self._fresh = list[str](), (f"v{number}" for number in itertools.count(len(self._names)))
        self._tables: dict[str, str] = {}
        self._lists, self._arrays = set[Variable](), set[Variable]()
        self._look(program.body)
        self._want(atom for one in program.outputs for atom in one.atoms)

    def _look(self, statements: Sequence[Statement]) -> None:
        """Find out in which forms arrays are needed."""
        for one in statements:
            match one:
                case Compute(operands=parts) | Pack(atoms=parts):
                    self._want(parts)
                case Take(source=source, index=index):
                    self._lists.add(source)
                    self._want([index])
                case Loop():
                    self._look((*one.before, *one.body))
                    self._want([one.condition, *(part for each in one.carried for part in (each.first, each.then))])
                    self._arrays |= {each.variable for each in one.carried}
                case _:
                    self._arrays |= reads(one)

    def _want(self, parts: Iterable[Any]) -> None:
        for part in parts:
            if isinstance(part, Element):
                self._lists.add(part.array)
            elif isinstance(part, Slice):
                self._arrays.add(part.array)

    def text(self) -> str:
        """The function, after its constants."""
        program, names = self._program, ", ".join(one.name for one in self._program.inputs)
        lines = [
            f"a_{one.name} = np.asarray({one.name}, float).ravel()" for one in program.inputs if one in self._arrays
        ]
        results = variables(atom for one in program.outputs for atom in one.atoms)
        lines += ["yield"] * self._pauses + list(self._block(program.body, results))
        lines.append(f"return {' '.join(f'{self._list(one.atoms)},' for one in program.outputs)}")
        tables = [f"{name} = {array}" for array, name in self._tables.items()]
        body = "\n".join(INDENT + line for line in lines)
        return "\n".join([*self._constants(), *tables, "", "", f"def {program.name}({names}):", body, ""])

    def _constants(self) -> Iterator[str]:
        for one in self._program.constants:
            name = self._names[one.variable]
            if one.variable in self._arrays:
                yield f"a_{name} = CONSTANTS[{one.name!r}]"
            if one.variable in self._lists:
                yield f"{name} = CONSTANTS[{one.name!r}].tolist()"

    # --- operands -----------------------------------------------------------------------------------

    def _name(self, variable: Variable) -> str:
        if variable not in self._names:
            self._names[variable] = self._free.pop() if self._free else next(self._fresh)
        return self._names[variable]

    def _list(self, atoms: Sequence[Any]) -> str:
        arrays = variables(atoms)
        array = arrays.pop() if len(arrays) == 1 else None
        if array and array.size and list(atoms) == [Element(array, i) for i in range(array.size)]:
            return self._name(array)
        return f"[{', '.join(map(self._atom, atoms))}]"

    def _atom(self, atom: Any) -> str:
        if isinstance(atom, Element):
            return f"{self._name(atom.array)}[{atom.index}]"
        if isinstance(atom, Variable):
            return self._name(atom)
        return f"({atom!r})" if atom < 0 else repr(atom)

    def _operand(self, operand: Any, size: int | None) -> str:
        if not isinstance(operand, Slice):
            return self._atom(operand)
        text = f"a_{self._name(operand.array)}"
        return text if size is None or operand.array.size == size else f"{text}[{operand.first}:{operand.first + size}]"

    def _places(self, indices: tuple[int, ...]) -> str:
        """Places in an array: as a slice where each is as far from the one before, else a table."""
        steps = {b - a for a, b in itertools.pairwise(indices)}
        if len(steps) == 1 and (step := steps.pop()) > 0:
            return f"{indices[0]}:{indices[-1] + 1}:{step}"
        return self._table(f"np.array({list(indices)})")

    def _table(self, array: str) -> str:
        """Name of an array that is made once."""
        return self._tables.setdefault(array, f"{self._program.name}_i{len(self._tables)}")

    # --- statements ---------------------------------------------------------------------------------

    def _block(self, statements: Sequence[Statement], after: Set[Variable]) -> Iterator[str]:
        """Lines of statements, of whose variables those in `after` are read after them.

        A name stands for another variable once its own is not read any more: Python frees a number then, and takes its
        place for the next, which is an eighth of the time that a step takes.
        """
        last = {variable: place for place, one in enumerate(statements) for variable in reads(one)}
        made = set[Variable]()
        for place, one in enumerate(statements):
            yield from self._loop(one) if isinstance(one, Loop) else self._statement(one)
            made |= makes(one)
            over = {each for each in (reads(one) | makes(one)) & made - after if last.get(each, place) <= place}
            self._free += sorted(self._names[each] for each in over)

    def _statement(self, one: Any) -> Iterator[str]:
        target, name = one.target, self._name(one.target)
        match one:
            case Compute(operation=operation, operands=operands) if target.size is None:
                yield f"{name} = {written(operation, 'python').format(*map(self._atom, operands))}"
            case Take(source=source, index=index):
                yield f"{name} = {self._name(source)}[{self._atom(index)}]"
            case Pack(atoms=atoms):
                if target in self._lists:
                    yield f"{name} = {self._list(atoms)}"
                if target in self._arrays:
                    yield f"a_{name} = np.array({name if target in self._lists else self._list(atoms)})"
            case _:
                yield f"a_{name} = {self._array(one)}"
                if target in self._lists:
                    yield f"{name} = a_{name}.tolist()"

    def _array(self, one: Any) -> str:
        """Value of a statement on arrays."""
        match one:
            case Compute(operation=operation, operands=operands):
                return written(operation, "numpy").format(*(self._operand(part, one.target.size) for part in operands))
            case Join(parts=parts, sizes=sizes):
                return f"np.concatenate(({', '.join(map(self._operand, parts, sizes))}))"
            case Gather(source=source, indices=indices):
                return f"a_{self._name(source)}[{self._places(indices)}]"
            case Product(left=left, right=right, shape=(m, k, n)):
                matrix = f"{self._operand(right, k * n)}.reshape({k}, {n})"
                if any(right.array is one.variable for one in self._program.constants):
                    matrix = self._table(matrix)
                rows = self._operand(left, m * k)
                return f"{rows} @ {matrix}" if m == 1 else f"({rows}.reshape({m}, {k}) @ {matrix}).ravel()"
        raise TypeError(one)

    def _loop(self, loop: Loop) -> Iterator[str]:
        yield from self._assigned(loop, "first")
        yield "while True:" if loop.rounds is None else f"for _ in range({loop.rounds}):"
        inside, thens = variables([loop.condition]), variables(one.then for one in loop.carried)
        lines = list(self._block(loop.before, inside.union(thens, *map(reads, loop.body))))
        if loop.rounds is None:
            lines += [f"if not {self._atom(loop.condition)}:", f"{INDENT}break"]
        pauses, self._pauses = self._pauses, False
        lines += [*self._block(loop.body, thens), *self._assigned(loop, "then"), *["yield"] * pauses]
        self._pauses = pauses
        yield from (INDENT + line for line in lines)

    def _assigned(self, loop: Loop, what: str) -> Iterator[str]:
        """What is carried on, all at once: one may become what another was."""
        names = {one: self._name(one.variable) for one in loop.carried}
        arrays = {one: one.variable.size for one in loop.carried if one.variable.size}
        sides = [f"a_{name}" if one in arrays else name for one, name in names.items()]
        values = [self._operand(getattr(one, what), one.variable.size or 0) for one in loop.carried]
        yield f"{', '.join(sides)} = {', '.join(values)}"
        for one in arrays:
            if one.variable in self._lists:
                yield f"{names[one]} = a_{names[one]}.tolist()"
