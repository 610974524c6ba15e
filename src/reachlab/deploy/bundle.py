"""Programs of an exported folder as single files: modules and what they import, one after the other."""

from __future__ import annotations

import ast
import importlib
import inspect
from collections import Counter
from collections.abc import Mapping

from reachlab.runs.provenance import versions

CONTROLLER, PLANNER = "reachlab.deploy.onboard.controller", "reachlab.deploy.onboard.planning"
"""Modules that the files are made for; those that they import come before them."""

OURS = "reachlab."


def controller_source() -> str:
    """Content of `controller.py`, which needs NumPy and the standard library alone."""
    return _joined(_collected(CONTROLLER), {})


def planner_source() -> str:
    """Content of `planner.py`, which needs MuJoCo, OMPL and TOPP-RA too, and `controller.py` beside it."""
    there, all_of_it = _collected(CONTROLLER), _collected(PLANNER)
    return _joined({name: text for name, text in all_of_it.items() if name not in there}, there)


def _joined(sources: Mapping[str, str], there: Mapping[str, str]) -> str:
    """Modules joined, of which the last is the one that is asked for; others are `there`, in `controller.py`."""
    imports, taken, bodies, defined = set[str](), set[str](), list[str](), Counter[str]()
    for name, source in sources.items():
        lines, dropped = source.splitlines(), set[int]()
        tree = ast.parse(source)
        for number, node in enumerate(tree.body):
            described = number == 0 and isinstance(node, ast.Expr)
            imported = isinstance(node, (ast.Import, ast.ImportFrom))
            if described or imported:
                dropped |= set(range(node.lineno - 1, node.end_lineno or node.lineno))
            if isinstance(node, ast.ImportFrom) and node.module in there:
                taken |= {alias.name for alias in node.names}
            elif imported and not _is_ours(node) and "__future__" not in ast.unparse(node):
                imports.add(ast.unparse(node))
        defined.update(_defined(tree))
        kept = "\n".join(line for number, line in enumerate(lines) if number not in dropped)
        bodies.append(f"# --- {name.rpartition('.')[2]}: {_summary(tree)}\n\n\n{kept.strip()}\n")
    defined.update(taken)
    if twice := [name for name, count in defined.items() if count > 1]:
        raise ValueError(f"{list(sources)[-1]} and what it imports define {', '.join(twice)} twice: rename one.")
    described = ast.get_docstring(ast.parse(list(sources.values())[-1])) or ""
    head = f'"""{described}\n\nWritten by reachlab {versions()["reachlab"]} from its own modules: mend it there.\n"""\n'
    ordered = sorted(imports, key=lambda line: (line.startswith("from"), line))
    ordered += [f"\nfrom controller import {', '.join(sorted(taken))}"] * bool(taken)
    return "\n".join([head, "from __future__ import annotations\n", *ordered, "\n", "\n\n".join(bodies)])


def _defined(tree: ast.Module) -> set[str]:
    """Names that a module defines."""
    nodes = [node for node in tree.body if not isinstance(node, (ast.Import, ast.ImportFrom, ast.If))]
    names = {node.name for node in nodes if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
    targets = [target for node in nodes if isinstance(node, ast.Assign) for target in node.targets]
    targets += [node.target for node in nodes if isinstance(node, ast.AnnAssign)]
    return names | {one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)}


def _collected(name: str) -> dict[str, str]:
    """Sources of a module and, before it, of those of ours that it imports."""
    source, sources = inspect.getsource(importlib.import_module(name)), dict[str, str]()
    for node in ast.parse(source).body:
        if isinstance(node, ast.ImportFrom) and _is_ours(node):
            sources |= {other: text for other, text in _collected(str(node.module)).items() if other not in sources}
    return {**sources, name: source}


def _is_ours(node: ast.stmt) -> bool:
    return isinstance(node, ast.ImportFrom) and str(node.module).startswith(OURS)


def _summary(tree: ast.Module) -> str:
    return (ast.get_docstring(tree) or "").partition("\n")[0]
