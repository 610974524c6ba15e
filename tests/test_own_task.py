"""A task of a user's own, by the command line alone: from a file, and from an installed package."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

import reachlab
from conformance import CHECKS, Subject
from reachlab.cli import main as cli
from reachlab.cli.flags import evaluated
from reachlab.settings import extensions
from reachlab.settings.validation import InputError
from reachlab.tasks import TASKS

RAIL = Path(__file__).parents[1] / "examples" / "rail.py"

TINY = "--num-envs 8 --rollout-steps 8 --total-steps 128 --hidden 8 --report-episodes 4 --max-steps 20"


@pytest.mark.usefixtures("entered")
def test_the_task_conforms() -> None:
    subject = Subject(
        task="rail", robot="iiwa14", sim="kinematic", observation="ball", action="joint_residual", reward="dense"
    )
    for check in CHECKS:
        check(subject)
    subject.env.close()


@pytest.mark.usefixtures("entered")
def test_its_controller_follows_the_ball_and_its_setting_moves_it() -> None:
    reports = {}
    for speed in (0.1, 1.5):
        env = reachlab.Env(reachlab.configure("rail", rail_speed=speed, max_steps=200, robot="panda"), 50)
        reports[speed] = reachlab.evaluate(env, "ik", seed=1, episodes=50)
    assert reports[0.1].success_rate == 1
    slow, fast = (reports[speed].final_error_mm["median"] for speed in (0.1, 1.5))
    assert slow is not None
    assert fast is not None
    assert 2 * slow < fast


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the task's file, where no extension is known yet."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    place = tmp_path / "work"
    place.mkdir()
    (place / "rail.py").write_text(RAIL.read_text())
    monkeypatch.chdir(place)
    return place


def reachlab_command(*words: str) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own, in which nothing was imported."""
    return subprocess.run([sys.executable, "-m", "reachlab", *words], capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_a_file_is_imported_and_runs_remember_it(folder: Path) -> None:
    trained = reachlab_command("train", "--import", "rail.py", "--task", "rail", *TINY.split(), "--out", "run")
    assert trained.returncode == 0, trained.stderr
    assert json.loads((folder / "run" / "config.json").read_text())["imports"] == [str(folder / "rail.py")]
    told = reachlab_command("eval", "run", "--agent", "trained", "ik", "--episodes", "4", "--json")
    assert [report["task"] for report in json.loads(told.stdout)] == ["rail", "rail"]
    words = ["eval", "run", "--agent", "ik", "--max-steps", "200", "--episodes", "4", "--json", "--rail-speed"]
    slow, fast = (json.loads(reachlab_command(*words, speed).stdout) for speed in ("0.1", "1.5"))
    assert slow["final_error_mm"]["median"] < fast["final_error_mm"]["median"]
    assert "at most 2, got 3.0" in reachlab_command("eval", "run", "--rail-speed", "3").stderr
    assert reachlab_command("video", "run", "--episodes", "1").returncode == 0
    assert reachlab_command("view", "run", "--out", "page.html").returncode == 0
    assert reachlab_command("plot", "run").returncode == 0
    (folder / "space.toml").write_text("[space]\nrail_speed = [0.05, 0.2]\n")
    swept = reachlab_command(
        *["sweep", "space.toml", "--import", "rail.py", "--task", "rail", "--trials", "2", "--out", "sweep"],
        *TINY.split(),
    )
    assert swept.returncode == 0, swept.stderr
    assert reachlab_command("export", "run", "--out", "exported").returncode == 0
    assert (folder / "exported" / "step.py").exists()


def test_an_extension_that_a_run_names_is_not_imported_before_its_user_did(folder: Path) -> None:
    (folder / "evil.py").write_text("raise SystemExit('imported')")
    with pytest.raises(InputError, match=r"was not imported here before.*name it with --import"):
        extensions.import_remembered((str(folder / "evil.py"),))
    (folder / "plain.py").write_text("NUMBER = 1")
    extensions.import_extension("plain.py")
    del sys.modules["plain"], extensions.IMPORTED[-1]
    extensions.import_remembered((str(folder / "plain.py"),))
    del sys.modules["plain"], extensions.IMPORTED[-1]
    (folder / "plain.py").write_text("NUMBER = 2")
    with pytest.raises(InputError, match="or has changed since"):
        extensions.import_remembered((str(folder / "plain.py"),))


@pytest.mark.usefixtures("entered")
def test_settings_that_a_task_says_may_be_evaluated_are_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "rail_speed" in evaluated()
    monkeypatch.setattr(TASKS["rail"].load(), "evaluated", ("rail_sped",))
    with pytest.raises(
        InputError, match=r"setting in rail's `evaluated` 'rail_sped' is not .*Did you mean 'rail_speed'"
    ):
        evaluated()


OWN = (("tasks", "TASKS", "tutorial"), ("agents", "AGENTS", "ik"), ("robots.catalogue", "ROBOTS", "panda"))
"""Tables, and an entry of each that none of a user may take the place of."""


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (None, "extension 'mine.py' is not there"),
        ("1 / 0", "extension 'mine.py' cannot be imported: ZeroDivisionError: division by zero"),
        *(
            (
                f"from reachlab.{room} import {table}\n{table}[{name!r}] = None",
                f"{name!r} is an entry of reachlab's own",
            )
            for room, table, name in OWN
        ),
    ],
)
def test_an_extension_that_cannot_be_imported_is_refused_in_one_sentence(
    folder: Path, text: str | None, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if text:
        (folder / "mine.py").write_text(text)
    assert cli.main(["list", "tasks", "--import", "mine.py"]) == cli.WRONG_INPUT
    said = capsys.readouterr().err
    assert sentence in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "place", "why"),
    [
        (
            "mytask.py",
            "rail:Rail",
            "there is no module 'rail': it has the name of its file, without .py; a notebook's is __main__",
        ),
        ("rail.py", "rail:Rial", "module 'rail' has no 'Rial'"),
    ],
)
def test_an_entry_that_names_nothing_is_refused_in_one_sentence(folder: Path, name: str, place: str, why: str) -> None:
    text = (folder / "rail.py").read_text().replace("rail:Rail", place)
    (folder / "rail.py").unlink()
    (folder / name).write_text(text)
    done = reachlab_command("train", "--import", name, "--task", "rail", *TINY.split())
    assert (done.returncode, done.stdout) == (cli.WRONG_INPUT, "")
    assert done.stderr == f"reachlab: the table's entry {place!r} cannot be loaded: {why}.\n"


def test_a_file_may_import_those_beside_it(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    elsewhere = folder / "tasks"
    elsewhere.mkdir()
    (elsewhere / "weights_of_mine.py").write_text("WEIGHT = 3.0")
    (elsewhere / "mine_beside.py").write_text("import weights_of_mine\nOWN = weights_of_mine.WEIGHT")
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(extensions, "IMPORTED", [])
    extensions.import_extension("tasks/mine_beside.py")
    assert sys.modules["mine_beside"].OWN == 3.0


def test_a_file_that_is_called_as_a_module_in_use_is_refused(folder: Path) -> None:
    (folder / "json.py").write_text("NUMBER = 1")
    with pytest.raises(InputError, match=r"'json\.py' is called as module 'json' is, which is in use: rename it"):
        extensions.import_extension("json.py")


def test_extensions_of_installed_packages_are_imported(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    del folder
    entries = [EntryPoint("mine", "colorsys", extensions.GROUP), EntryPoint("broken", "gone.missing", extensions.GROUP)]
    asked: list[str] = []

    def installed(group: str) -> list[EntryPoint]:
        asked.append(group)
        return entries

    monkeypatch.setattr(extensions, "entry_points", installed)
    monkeypatch.setattr(extensions, "INSTALLED", [])  # what is imported here is not remembered
    with pytest.raises(InputError, match=r"extension 'gone.missing' cannot be imported: ModuleNotFoundError"):
        extensions.import_installed.__wrapped__()
    assert asked == ["reachlab.extensions"]
    assert "colorsys" in sys.modules
