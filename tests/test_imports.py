"""Imports point one way (DESIGN.md, Layout)."""

from __future__ import annotations

import ast
import subprocess
import sys
from dataclasses import dataclass, field
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import reachlab

SOURCE = Path(reachlab.__file__).parent

LAYERS = (
    {"lanes", "compilation"},
    {"checks", "names"},
    {"config", "interrupts", "chain", "kinematics", "views", "marks", "encoder", "streams"},
    {"policy"},
    {"storage"},
    {"metrics", "lock", "manifest", "threads", "arrays"},
    {"robots", "task", "ppo"},
    {"reachability"},
    {"scene", "solids"},
    {"camera"},
    {"sims"},
    {"env", "validation"},
    {"gym_env", "rollout", "checkpoint", "evaluation"},
    {"curves", "plots", "caption", "video", "viewer", "player", "panel", "stage", "export"},
    {"iteration"},
    {"memory"},
    {"distillation"},
    {"loop"},
    {"training"},
    {
        "console",
        "displays",
        "bench",
        "bench_bound",
        "bench_camera",
        "bench_precise",
        "bench_sims",
        "bench_soak",
        "bench_faults",
        "bench_follow",
        "bench_hostile",
        "bench_trust",
        "bench_viewer",
        "chromium",
    },
    {"flags"},
    {"verbs"},
    {"cli"},
    {"__main__", "__init__"},
)
"""From the leaves up; `sims` stands for all in it. A module imports from its own layer or from below."""

LEAVES = {
    "lanes": set(),
    "compilation": set(),
    "checks": set(),
    "names": set(),
    "config": {"checks"},
    "chain": {"lanes"},
    "kinematics": {"lanes", "chain"},
    "views": set(),
    "marks": set(),
    "encoder": set(),
    "streams": set(),
    "policy": {"encoder"},
    "interrupts": set(),
    "storage": {"checks"},
    "metrics": {"checks", "storage"},
    "lock": {"checks", "storage"},
    "threads": {"checks"},
    "arrays": {"checks", "storage"},
}
"""What the leaves import of the package."""

ONLY_FROM = {
    "scene": {"sims", "stage", "camera"},
    "camera": {"sims"},
    "console": {"verbs", "displays"},
    "displays": {"verbs"},
    "cli": {"__main__"},
}
"""Modules that only these import."""

HEAVY = ("jax", "mujoco", "optax", "matplotlib", "pybullet", "viser")


@dataclass
class Imports:
    """Modules of the package that a module imports: when it is imported, inside functions, and for types only."""

    top: set[str] = field(default_factory=set)
    inner: set[str] = field(default_factory=set)
    types: set[str] = field(default_factory=set)

    @property
    def run(self) -> set[str]:
        return self.top | self.inner


def module_name(path: Path) -> str:
    parts = path.relative_to(SOURCE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)


MODULES = {module_name(path): path for path in sorted(SOURCE.rglob("*.py"))}


def package_imports(node: ast.AST) -> set[str]:
    names: set[str] = set()
    if isinstance(node, ast.Import):
        names = {alias.name for alias in node.names}
    elif isinstance(node, ast.ImportFrom) and node.module:
        assert node.level == 0, "imports are absolute"
        names = {f"{node.module}.{alias.name}" for alias in node.names}
    inner = (name.removeprefix("reachlab.") for name in names if name.startswith("reachlab."))
    # A name is a module of its own, or something in the module before its last dot.
    modules = (name if name in MODULES else name.rpartition(".")[0] for name in inner)
    return {module for module in modules if module in MODULES}


def is_types_only(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def imports_of(path: Path) -> Imports:
    result = Imports()

    def visit(node: ast.AST, found: set[str]) -> None:
        found |= package_imports(node)
        if is_types_only(node):
            found = result.types
        elif isinstance(node, ast.FunctionDef | ast.Lambda):
            found = result.inner
        for child in ast.iter_child_nodes(node):
            visit(child, found)

    visit(ast.parse(path.read_text(encoding="utf-8")), result.top)
    return result


GRAPH = {name: imports_of(path) for name, path in MODULES.items()}


def group(name: str) -> str:
    """The module itself, or the package that it lies in."""
    return name.partition(".")[0]


def layer(name: str) -> int:
    return next(i for i, names in enumerate(LAYERS) if group(name) in names)


def test_every_module_has_its_place() -> None:
    assert {group(name) for name in MODULES} <= set().union(*LAYERS)


def test_the_graph_is_read_right() -> None:
    assert {"config", "env", "iteration", "rollout"} <= GRAPH["loop"].top
    assert {"training", "console", "checkpoint"} <= GRAPH["verbs"].inner - GRAPH["verbs"].top
    assert "loop" in GRAPH["displays"].types - GRAPH["displays"].run
    assert "sims" in GRAPH["sims.kinematic"].top


@pytest.mark.parametrize("name", MODULES)
def test_imports_point_to_the_own_layer_or_below(name: str) -> None:
    above = {other for other in GRAPH[name].run - ONLY_FROM.keys() if layer(other) > layer(name)}
    assert not above


def test_there_is_no_circle() -> None:
    order = list(TopologicalSorter({name: imports.run for name, imports in GRAPH.items()}).static_order())
    assert set(order) == set(MODULES)


@pytest.mark.parametrize("name", LEAVES)
def test_leaves_import_no_more_than_they_may(name: str) -> None:
    assert GRAPH[name].run | GRAPH[name].types <= LEAVES[name] | {"compilation"}


@pytest.mark.parametrize("name", ONLY_FROM)
def test_some_modules_have_one_door(name: str) -> None:
    assert {group(user) for user, imports in GRAPH.items() if name in imports.run} <= ONLY_FROM[name]


def test_the_table_of_simulators_loads_none() -> None:
    assert not {name for name in GRAPH["sims"].run if group(name) in ("sims", "scene")}


@pytest.mark.parametrize("name", sorted({"plots", "video", "viewer", "export"} & MODULES.keys()))
def test_outputs_read_a_run_directory_and_never_import_training(name: str) -> None:
    assert "training" not in GRAPH[name].run


@pytest.mark.parametrize("name", ["task", "kinematics", "policy", "ppo", "rollout"])
def test_the_numerical_core_knows_no_simulator_files_or_faces(name: str) -> None:
    faces = {"sims", "gym_env", "checkpoint", "metrics", "scene", "plots", "cli", "console"}
    assert not set(map(group, GRAPH[name].run)) & faces


def loaded_by(statement: str) -> set[str]:
    """Heavy packages that a fresh process has loaded after a statement."""
    probe = f"import contextlib, io, sys\n{statement}\nprint(*sorted(set({HEAVY}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_importing_the_package_loads_neither_jax_nor_a_simulator() -> None:
    assert loaded_by("import reachlab, reachlab.config, reachlab.cli") == set()


def test_help_loads_neither_jax_nor_a_simulator() -> None:
    verbs = ("train", "distil", "eval", "video", "view", "plot", "bench", "list")
    words = [["--help"], *([verb, "--help"] for verb in verbs)]
    statement = (
        "from reachlab.cli import main\n"
        f"for words in {words}:\n"
        "    with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.suppress(SystemExit):\n"
        "        main(words)\n"
        "    assert said.getvalue()"
    )
    assert loaded_by(statement) == set()


def test_public_names_are_loaded_when_asked_for() -> None:
    assert "jax" in loaded_by("import reachlab; reachlab.Env")
    assert set(dir(reachlab)) == set(reachlab.__all__)
    with pytest.raises(AttributeError, match="module 'reachlab' has no attribute 'trian'"):
        _ = reachlab.trian  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", reachlab.__all__)
def test_a_public_name_is_the_same_each_time_it_is_asked_for(name: str) -> None:
    first, second = getattr(reachlab, name), getattr(reachlab, name)
    assert first is second
    assert callable(first)
    assert first.__name__ == name


def test_importing_any_module_starts_no_jax_backend_so_that_threads_can_still_be_chosen() -> None:
    modules = ", ".join(f"reachlab.{name}" for name in sorted(MODULES) if name not in ("__main__", "__init__"))
    probe = f"import {modules}; from reachlab.threads import set_threads; set_threads(1)"
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
