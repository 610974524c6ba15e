"""Folders import only from those above them, files and functions are short, and `import reachlab` loads little."""

from __future__ import annotations

import ast
import graphlib
import subprocess
import sys
from pathlib import Path

import pytest

import reachlab

SOURCE = Path(reachlab.__file__).parent

FOLDERS = (
    *(
        "settings",
        "robots",
        "control",
        "tasks",
        "render",
        "sims",
        "envs",
        "agents",
        "runs",
        "evaluation",
        "learn",
        "emit",
        "watch",
    ),
    *("deploy", "scale", "bench", "cli"),
)
"""From the ground up: a folder imports only from those before it, and from the files at the top of the package."""

GROUND = ("settings",)
"""Folders that the files at the top of the package import from; what is asked for by name is loaded later."""

DOORS = ("gymnax", "lerobot", "sb3")
"""Files at the top that lead to an optional package: they import from any folder, and nothing imports them."""

APART = ("reachlab.envs.gymnax_env",)
"""Modules whose package the tests here are run without; see `make gymnax`."""

LONGEST_FILE, LONGEST_FUNCTION = 300, 60
"""Lines of a source file, and of a function in it, beyond which it has two reasons to exist."""

HEAVY = ("jax", "mujoco", "optax", "matplotlib", "pybullet")


def folder_of(module: str) -> str:
    """Folder of a module such as `reachlab.learn.ppo`; empty for the files at the top."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and (SOURCE / parts[1]).is_dir() else ""


def imports_of(path: Path) -> set[str]:
    """Modules of the package that a file imports: at its top, inside functions and for types alike."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            # What is imported from the package itself may be a folder.
            inside = node.module == "reachlab"
            found |= {f"reachlab.{alias.name}" for alias in node.names} if inside else {str(node.module)}
    return {name for name in found if name.partition(".")[0] == "reachlab"}


def edges() -> dict[str, set[str]]:
    """For each folder, the other folders that its files import from."""
    found: dict[str, set[str]] = {}
    for path in SOURCE.rglob("*.py"):
        parts = path.relative_to(SOURCE).parts
        if len(parts) == 1 and path.stem in DOORS:
            continue
        folder = parts[0] if len(parts) > 1 else ""
        found.setdefault(folder, set()).update(map(folder_of, imports_of(path)))
    return {folder: others - {folder, ""} for folder, others in found.items()}


EDGES = edges()


def test_every_folder_has_its_place() -> None:
    assert EDGES.keys() - {""} <= set(FOLDERS)


@pytest.mark.parametrize("folder", [folder for folder in FOLDERS if folder in EDGES])
def test_a_folder_imports_only_from_those_above_it(folder: str) -> None:
    assert EDGES[folder] <= set(FOLDERS[: FOLDERS.index(folder)])


@pytest.mark.parametrize("path", sorted(SOURCE.glob("[!_]*.py")), ids=lambda path: path.stem)
def test_files_at_the_top_import_from_the_ground_alone_but_for_doors(path: Path) -> None:
    assert path.stem in DOORS or {*map(folder_of, imports_of(path))} <= {*GROUND, ""}


def test_nothing_imports_a_door() -> None:
    imported = {name for path in SOURCE.rglob("*.py") for name in imports_of(path)}
    assert not imported & {f"reachlab.{door}" for door in DOORS}


def test_a_door_without_its_package_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    from reachlab.gymnax import make

    monkeypatch.setitem(sys.modules, "flax", None)
    with pytest.raises(reachlab.InputError, match=r"needs gymnax \(flax is missing\): pip install .*\[gymnax\]'"):
        make()


def test_no_imports_between_files_go_in_a_circle() -> None:
    modules = {".".join(path.relative_to(SOURCE.parent).with_suffix("").parts): path for path in SOURCE.rglob("*.py")}
    modules = {name.removesuffix(".__init__"): path for name, path in modules.items()}
    imports = {name: imports_of(path) & modules.keys() - {name} for name, path in modules.items()}
    assert len(imports) > 100
    assert circle(imports) == []


def circle(imports: dict[str, set[str]]) -> list[str]:
    """Modules of which each imports the one before, the first one again at the end."""
    try:
        graphlib.TopologicalSorter(imports).prepare()
    except graphlib.CycleError as error:
        return error.args[1]
    return []


def test_a_circle_is_noticed() -> None:
    assert set(circle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}})) == {"a", "b", "c"}


def test_the_order_is_read_from_the_files() -> None:
    assert {"envs", "agents", "runs", "evaluation"} <= EDGES["learn"]
    assert "watch" in EDGES["cli"], "inside functions"
    assert "learn" in EDGES["cli"], "for types"


@pytest.mark.parametrize("path", sorted(SOURCE.rglob("*.py")), ids=lambda path: str(path.relative_to(SOURCE)))
def test_no_file_and_no_function_is_long(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    functions = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)]
    assert text.count("\n") <= LONGEST_FILE
    assert not [one.name for one in functions if (one.end_lineno or 0) - one.lineno >= LONGEST_FUNCTION]


def loaded_by(statement: str) -> set[str]:
    """Heavy packages that a fresh process has loaded after a statement."""
    probe = f"import contextlib, io, sys\n{statement}\nprint(*sorted(set({HEAVY}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_importing_the_package_loads_neither_jax_nor_a_simulator() -> None:
    assert loaded_by("import reachlab, reachlab.settings.config, reachlab.cli.main") == set()


def test_help_loads_neither_jax_nor_a_simulator() -> None:
    from reachlab.cli.verbs import VERBS

    words = [["--help"], *([verb, "--help"] for verb in VERBS)]
    statement = (
        "from reachlab.cli.main import main\n"
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
    files = (path.relative_to(SOURCE.parent).with_suffix("") for path in SOURCE.rglob("*.py"))
    names = {".".join(file.parts) for file in files if not file.name.startswith("__")}
    modules = ", ".join(sorted(names.difference(APART)))
    probe = f"import {modules}; from reachlab.jax_setup import set_threads; set_threads(1)"
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
