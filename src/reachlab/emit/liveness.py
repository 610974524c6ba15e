"""What of a program is needed for its results."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from reachlab.emit.program import Constant, Loop, Program, Statement, Variable, makes, reads, variables


def live_program(program: Program, arrays: Iterable[tuple[Variable, np.ndarray]]) -> Program:
    """A program without what it does not need, whose constants are those of `arrays`.

    They keep the names that equal constants of the program have, and are numbered where there are none.
    """
    body, live = needed(program.body, variables(atom for one in program.outputs for atom in one.atoms))
    names = {_content(one.array): one.name for one in program.constants}
    numbered = (f"{program.name}.{number}" for number in itertools.count())
    free = (name for name in numbered if name not in names.values())
    used = [(variable, array) for variable, array in arrays if variable in live]
    constants = [Constant(one, names.get(_content(array)) or next(free), array) for one, array in used]
    return replace(program, constants=tuple(constants), body=body)


def _content(array: np.ndarray) -> tuple[int, bytes]:
    return array.size, np.asarray(array, float).tobytes()


def needed(statements: Sequence[Statement], live: set[Variable]) -> tuple[tuple[Statement, ...], set[Variable]]:
    """Those of the statements that variables which are `live` after them need, and what is live before them."""
    kept: list[Statement] = []
    live = set(live)
    for one in reversed(statements):
        if not makes(one) & live:
            continue
        statement = _needed_loop(one, live) if isinstance(one, Loop) else one
        kept.append(statement)
        live |= reads(statement)
    return tuple(reversed(kept)), live


def _needed_loop(loop: Loop, live: set[Variable]) -> Loop:
    """A loop with what it has to carry alone."""
    before, asked = needed(loop.before, variables([loop.condition]))
    wanted = makes(loop) & (live | asked)
    while True:
        carried = tuple(one for one in loop.carried if one.variable in wanted)
        thens = variables(one.then for one in carried)
        body, inside = needed(loop.body, thens)
        more = makes(loop) & (inside | thens)
        if more <= wanted:
            return replace(loop, carried=carried, body=body, before=before)
        wanted |= more
