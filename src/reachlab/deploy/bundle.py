"""The controller as a single file: the modules of `onboard` and what they import, one after the other."""

from __future__ import annotations

import ast
import importlib
import inspect

from reachlab.runs.versions import versions

FIRST = "reachlab.deploy.onboard.controller"
"""Module that the file is made for; those that it imports come before it."""

OURS = "reachlab."


def controller_source() -> str:
    """Content of `controller.py`, which needs NumPy and the standard library alone."""
    sources: dict[str, str] = {}
    _collect(FIRST, sources)
    imports: set[str] = set()
    bodies = []
    for name, source in sources.items():
        lines, dropped = source.splitlines(), set[int]()
        tree = ast.parse(source)
        for number, node in enumerate(tree.body):
            described = number == 0 and isinstance(node, ast.Expr)
            imported = isinstance(node, (ast.Import, ast.ImportFrom))
            if described or imported:
                dropped |= set(range(node.lineno - 1, node.end_lineno or node.lineno))
            if imported and not _is_ours(node) and "__future__" not in ast.unparse(node):
                imports.add(ast.unparse(node))
        kept = "\n".join(line for number, line in enumerate(lines) if number not in dropped)
        bodies.append(f"# --- {name.rpartition('.')[2]}: {_summary(tree)}\n\n\n{kept.strip()}\n")
    described = ast.get_docstring(ast.parse(sources[FIRST])) or ""
    head = f'"""{described}\n\nWritten by reachlab {versions()["reachlab"]} from its own modules: mend it there.\n"""\n'
    ordered = sorted(imports, key=lambda line: (line.startswith("from"), line))
    return "\n".join([head, "from __future__ import annotations\n", *ordered, "\n", "\n\n".join(bodies)])


def _collect(name: str, sources: dict[str, str]) -> None:
    """Add the source of a module, after those of ours that it imports."""
    source = inspect.getsource(importlib.import_module(name))
    for node in ast.parse(source).body:
        if isinstance(node, ast.ImportFrom) and _is_ours(node) and node.module not in sources:
            _collect(str(node.module), sources)
    sources[name] = source


def _is_ours(node: ast.stmt) -> bool:
    return isinstance(node, ast.ImportFrom) and str(node.module).startswith(OURS)


def _summary(tree: ast.Module) -> str:
    return (ast.get_docstring(tree) or "").partition("\n")[0]
