"""The examples run as they stand, with a small budget."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[1] / "examples"
NOTEBOOK = EXAMPLES / "first.ipynb"
APART = ("rejax_ppo.py", "rail.py", "cue.py", "quick.py")
"""The first runs in an environment of its own, see `make gymnax`; the others are modules to import."""


@pytest.mark.parametrize(
    "path", sorted(path for path in EXAMPLES.glob("*.py") if path.name not in APART), ids=lambda path: path.name
)
def test_an_example_prints_its_result_as_json(path: Path) -> None:
    words = [sys.executable, str(path), "--steps", "1200", "--seed", "3"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    low, high = result["interval"]
    assert 0 <= low <= result["success"] <= high <= 1
    assert result["steps"] >= 1200
    assert result["seed"] == 3
    assert result["wall_s"] > 0


def test_the_notebook_is_kept_without_outputs_and_gives_figures_and_a_film(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Unless it is told, only the command line keeps compiled programs.
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(Path.home() / ".cache" / "reachlab" / "jax"))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    codes = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in codes)
    # What fails in it is raised here.
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": tmp_path}}).execute()
    outputs = [output for cell in codes for output in cell.outputs]
    assert not [output.text for output in outputs if output.get("name") == "stderr"]
    shown = [kind for output in outputs for kind in output.get("data", {}) if kind.startswith("image/")]
    assert shown == ["image/png", "image/webp", "image/png", "image/png"]
    said = "".join(output.text for output in outputs if output.get("name") == "stdout")
    assert "reached after" in said
    assert "not reached" not in said
