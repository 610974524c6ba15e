"""Programs as straight code in C99 and in JavaScript, which differ in how variables are declared."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from reachlab.emit.operations import INTEGER, REAL, TRUTH, written
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
    kind_of,
    reads,
    variables,
)

INDENT = "    "

TYPES = {REAL: "real", INTEGER: "int", TRUTH: "int"}
"""Types of C by kind; `real` is double or float."""


@dataclass(frozen=True)
class Language:
    """What is written differently.

    Attributes:
        name: in the table of operations.
        counter: declares the counter of a loop.
        declared: declares a variable, of its kind, name and, of an array, size.
        constant: a number.
        table: an array of whole numbers, of its name and numbers.
        hoists: arrays are made once, outside of the function.
    """

    name: str
    counter: str
    declared: Callable[[str, str, int | None], str]
    constant: Callable[[Any], str]
    table: Callable[[str, Sequence[int]], str]
    hoists: bool = False


def _c_declared(kind: str, name: str, size: int | None) -> str:
    return f"{TYPES[kind]} {name}" + (f"[{size}]" if size else "")


def _c_number(value: Any) -> str:
    if isinstance(value, (bool, int)):
        return f"({value})" if value < 0 else str(int(value))
    if not math.isfinite(value):
        return "NAN" if math.isnan(value) else "INFINITY" if value > 0 else "(-INFINITY)"
    return f"(R({value!r}))" if value < 0 else f"R({value!r})"


def _c_table(name: str, numbers: Sequence[int]) -> str:
    return f"static const int {name}[] = {{ {', '.join(map(str, numbers))} }};"


def _javascript_declared(_: str, name: str, size: int | None) -> str:
    return f"const {name} = new Float64Array({size})" if size else f"let {name}"


def _javascript_number(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    text = repr(value).replace("inf", "Infinity").replace("nan", "NaN")
    return f"({text})" if value < 0 else text


def _javascript_table(name: str, numbers: Sequence[int]) -> str:
    return f"const {name} = Int32Array.of({','.join(map(str, numbers))});"


C = Language("c", "int", _c_declared, _c_number, _c_table)
JAVASCRIPT = Language("javascript", "let", _javascript_declared, _javascript_number, _javascript_table, hoists=True)

LONGEST_GATHER = 8
"""More numbers than these are gathered in a loop, by a table of their places: engines of JavaScript do not optimise a
function that is long."""

JAVASCRIPT_HEAD = """\
/** The nearest integer, of two the even one. */
function toEven(x) {
    const r = Math.round(x);
    return Math.abs(x % 1) === 0.5 && r % 2 !== 0 ? r - 1 : r;
}
"""
"""What the operations in JavaScript need."""


class _Printer:
    """Statements of a program in a language.

    Attributes:
        head: lines that stand before the function: tables, and arrays where they are made once.
    """

    def __init__(self, program: Program, language: Language) -> None:
        self._language, self._depth, self._program = language, 0, program.name
        self.head: list[str] = []
        self._tables: dict[tuple[int, ...], str] = {}
        self._names = {one: one.name for one in program.inputs}
        self._names |= {one.variable: f"{program.name}_k{number}" for number, one in enumerate(program.constants)}

    def name(self, variable: Variable) -> str:
        """The name of a variable."""
        prefix = f"{self._program}_" * (self._language.hoists and variable.size is not None)
        return self._names.setdefault(variable, f"{prefix}v{len(self._names)}")

    def atom(self, atom: Any) -> str:
        """A number."""
        if isinstance(atom, Element):
            return f"{self.name(atom.array)}[{atom.index}]"
        return self.name(atom) if isinstance(atom, Variable) else self._language.constant(atom)

    def block(self, statements: Sequence[Statement]) -> Iterator[str]:
        """Lines of statements."""
        for one in statements:
            yield from self._loop(one) if isinstance(one, Loop) else self._statement(one)

    def _at(self, operand: Any, index: str = "i") -> str:
        """A number of an operand, in a round of a loop over all."""
        if not isinstance(operand, Slice):
            return self.atom(operand)
        return f"{self.name(operand.array)}[{index}{f' + {operand.first}' * bool(operand.first)}]"

    def _declared(self, variable: Variable, name: str) -> str:
        return self._language.declared(variable.kind, name, variable.size)

    def _made(self, variable: Variable, name: str) -> Iterator[str]:
        """The declaration of an array, where it stands in the function."""
        line = f"{self._declared(variable, name)};"
        if self._language.hoists:
            self.head.append(line)
        else:
            yield line

    def _table(self, numbers: tuple[int, ...]) -> str:
        """The name of a table of numbers."""
        if numbers not in self._tables:
            self._tables[numbers] = name = f"{self._program}_t{len(self._tables)}"
            self.head.append(self._language.table(name, numbers))
        return self._tables[numbers]

    def _each(self, size: int | None, line: str, counter: str = "i") -> str:
        return f"for ({self._language.counter} {counter} = 0; {counter} < {size}; ++{counter}) {line}"

    def _begun(self, variable: Variable, name: str, value: Any) -> Iterator[str]:
        """A variable under a name, with its first value."""
        if variable.size is None:
            yield f"{self._declared(variable, name)} = {self.atom(value)};"
        else:
            yield from self._made(variable, name)
            yield self._each(variable.size, f"{name}[i] = {self._at(value)};")

    def _statement(self, one: Any) -> Iterator[str]:
        target, name = one.target, self.name(one.target)
        declared = self._declared(target, name)
        if target.size is not None:
            yield from self._made(target, name)
        match one:
            case Compute(operation=operation, operands=operands):
                value = written(operation, self._language.name).format(*map(self._at, operands))
                each = self._each(target.size, f"{name}[i] = {value};")
                yield f"{declared} = {value};" if target.size is None else each
            case Take(source=source, index=index):
                yield f"{declared} = {self.name(source)}[{self.atom(index)}];"
            case Pack(atoms=atoms):
                yield " ".join(f"{name}[{i}] = {self.atom(atom)};" for i, atom in enumerate(atoms))
            case Join(parts=parts, sizes=sizes):
                ends = np.cumsum(sizes)
                for part, size, end in zip(parts, sizes, ends, strict=True):
                    yield self._each(size, f"{name}[i + {end - size}] = {self._at(part)};")
            case Gather(source=source, indices=indices) if len(indices) > LONGEST_GATHER:
                yield self._each(len(indices), f"{name}[i] = {self.name(source)}[{self._table(indices)}[i]];")
            case Gather(source=source, indices=indices):
                yield " ".join(f"{name}[{i}] = {self.name(source)}[{index}];" for i, index in enumerate(indices))
            case Product(left=left, right=right, shape=(m, k, n)):
                row = f"{name}[{n} * i + j]"
                product = f"{self._at(left, f'{k} * i + l')} * {self._at(right, f'{n} * l + j')}"
                yield self._each(m, "{")
                yield INDENT + self._each(n, f"{row} = 0;", "j")
                yield INDENT + self._each(k, self._each(n, f"{row} += {product};", "j"), "l")
                yield "}"

    def _loop(self, loop: Loop) -> Iterator[str]:
        self._depth += 1
        for one in loop.carried:
            yield from self._begun(one.variable, self.name(one.variable), one.first)
        lines = list(self.block(loop.before))
        if loop.rounds is None:
            lines.append(f"if (!{self.atom(loop.condition)}) break;")
        lines += [*self.block(loop.body), *self._renewed(loop)]
        yield "for (;;) {" if loop.rounds is None else self._each(loop.rounds, "{", f"r{self._depth}")
        yield from (INDENT + line for line in lines)
        yield "}"
        self._depth -= 1

    def _renewed(self, loop: Loop) -> Iterator[str]:
        """What is carried on: first all that it becomes, for one may become what another was."""
        names = {one: self.name(one.variable) for one in loop.carried}
        for one, name in names.items():
            yield from self._begun(one.variable, f"{name}_then", one.then)
        for one, name in names.items():
            size = one.variable.size
            yield f"{name} = {name}_then;" if size is None else self._each(size, f"{name}[i] = {name}_then[i];")


# --- C --------------------------------------------------------------------------------------------


def c_declarations(inputs: Sequence[Variable], real: str = "real") -> list[str]:
    """Declarations of inputs in C."""
    return [f"{real if one.kind == REAL else 'int'} {one.name}[{one.size}]" for one in inputs]


def c_numbers(array: np.ndarray) -> str:
    """Numbers of an array as its initialiser in C; those in single precision as such, which are shorter."""
    single = array.dtype == np.float32 and np.isfinite(array).all()
    numbers = (f"{number}f" for number in array.ravel()) if single else map(_c_number, array.ravel().tolist())
    return f"{{ {', '.join(numbers)} }}"


def c_function(program: Program) -> str:
    """A function in C99: `void name(const real input[], …, real output[], …)`, after its constants."""
    printer, atoms = _Printer(program, C), [atom for one in program.outputs for atom in one.atoms]
    results = [f"{TYPES[kind_of(one.atoms[0])]} {one.name}[{len(one.atoms)}]" for one in program.outputs]
    tables = [
        f"static const {TYPES[one.variable.kind]} {printer.name(one.variable)}[] = {c_numbers(one.array)};"
        for one in program.constants
    ]
    read = variables(atoms).union(*map(reads, program.body))
    lines = [f"(void) {one.name};" for one in program.inputs if one not in read]
    lines += printer.block(program.body)
    for output in program.outputs:
        lines += [f"{output.name}[{i}] = {printer.atom(atom)};" for i, atom in enumerate(output.atoms)]
    given = [*(f"const {one}" for one in c_declarations(program.inputs)), *results]
    head = f"static void {program.name}({', '.join(given)})"
    return "\n".join([*tables, *printer.head, head, "{", *(INDENT + line for line in lines), "}", ""])


# --- JavaScript -----------------------------------------------------------------------------------


def javascript_function(program: Program) -> str:
    """A function in JavaScript: of an object of arrays by name, giving another; constants are in `CONSTANTS`."""
    printer = _Printer(program, JAVASCRIPT)
    constants = [f"const {printer.name(one.variable)} = CONSTANTS[{one.name!r}];" for one in program.constants]
    lines = list(printer.block(program.body))
    results = ", ".join(f"{one.name}: [{', '.join(map(printer.atom, one.atoms))}]" for one in program.outputs)
    lines.append(f"return {{ {results} }};")
    given = ", ".join(one.name for one in program.inputs)
    body = [f"function {program.name}({{ {given} }}) {{", *(INDENT + line for line in lines), "}", ""]
    return "\n".join([*constants, *printer.head, *body])
