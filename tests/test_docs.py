"""What README, CONTRIBUTING, SECURITY and docs/ say is true: examples run, commands parse, names and files exist."""

from __future__ import annotations

import argparse
import dataclasses
import os
import re
import shlex
import subprocess
import sys
import typing
from collections.abc import Iterator
from pathlib import Path

import pytest

import benchmarks
import reachlab
from blocks.__main__ import main as run_pages
from blocks.pages import BLOCK, MARK, fenced, lanes, others
from blocks.pages import blocks as commands_of
from blocks.stand_in import check_pip, shortened
from reachlab.agents import AGENTS
from reachlab.bench import SUITES
from reachlab.cli import main as cli
from reachlab.cli.flags import Bench, Eval, Train
from reachlab.cli.verbs import VERBS
from reachlab.envs.consistency import RANDOMISED, check
from reachlab.runs.sinks import SINKS
from reachlab.settings.validation import choose, hints
from reachlab.tasks import TASKS
from test_imports import FOLDERS

ROOT = Path(__file__).parent.parent
SOURCE = Path(reachlab.__file__).parent

README, CONTRIBUTING, SECURITY = (ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "SECURITY"))
PAGES = (README, CONTRIBUTING, SECURITY, *sorted((ROOT / "docs").glob("*.md")))
TEXTS = {page.relative_to(ROOT).as_posix(): page.read_text(encoding="utf-8") for page in PAGES}

NUMBERS = {"N": "0", "$seed": "0"}
"""What stands for a number in a command."""

FENCED = re.compile(r"^```([\w{}-]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SPAN = re.compile(r"`([^`]+)`")


def blocks(text: str, language: str) -> list[str]:
    """Fenced blocks of a language."""
    return [block for name, block in FENCED.findall(text) if name == language]


def spans(text: str) -> list[str]:
    """Code inside lines, each on one line."""
    return [" ".join(span.split()) for span in SPAN.findall(FENCED.sub("", text))]


def commands(text: str) -> Iterator[str]:
    """Command lines of `reachlab` in a text: a prompt's, and those in a sentence."""
    prompts = [line[2:] for block in blocks(text, "console") for line in block.splitlines() if line.startswith("$ ")]
    for line in [*prompts, *spans(text)]:
        for part in re.split(r"[;|>]| # ", line):
            words = part.strip().removeprefix("do ")
            if words.startswith("reachlab "):
                yield words


COMMANDS = sorted({command for text in TEXTS.values() for command in commands(text)})


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_the_documents_is_one(
    command: str, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    chosen, nothing = cli._chosen, {"resume": None, "config": None}  # neither runs nor files of settings are there
    monkeypatch.setattr(cli, "_chosen", lambda words: argparse.Namespace(**vars(chosen(words)) | nothing))
    verb, *words = (NUMBERS.get(word, word) for word in shlex.split(command)[1:])
    if verb == "--version":
        return
    choose("command", verb, VERBS)
    if not words or words == ["--help"]:  # only mentioned
        return
    if "--import" in words:
        request.getfixturevalue("entered")
        at = words.index("--import")
        del words[at : at + 2]
    flags = cli._parse(verb, VERBS[verb].flags, words)
    if isinstance(flags, Train):
        check(flags.run)
    elif isinstance(flags, Eval):
        assert set(flags.agent) <= set(AGENTS)
        assert set(flags.randomise) <= set(RANDOMISED)
    elif isinstance(flags, Bench):
        assert flags.suite in SUITES


def test_the_benchmarks_of_the_documents_are_there() -> None:
    named = {name for text in TEXTS.values() for name in re.findall(r"python -m benchmarks (\w+)", text)}
    assert {"precise", "clutter", "simulators"} <= named <= set(benchmarks.SUITES)


def test_the_parts_of_the_example_on_its_page_are_those_of_its_file() -> None:
    for page, file, least in (("own-task", "rail", 6), ("reward", "quick", 1)):
        whole = (ROOT / "examples" / f"{file}.py").read_text(encoding="utf-8")
        parts = blocks(TEXTS[f"docs/{page}.md"], "python")
        assert len(parts) >= least
        assert all(part.rstrip() in whole for part in parts)


def settings(cls: type) -> Iterator[str]:
    """Names of the flags of a dataclass, those of the dataclasses in it among them."""
    for name, hint in hints(cls).items():
        kind = typing.get_args(hint)[0] if hasattr(hint, "__metadata__") else hint
        if dataclasses.is_dataclass(kind):
            yield from settings(typing.cast("type", kind))
        else:
            flag = name.replace("_", "-")
            yield from (f"--{flag}", f"--no-{flag}") if kind is bool else (f"--{flag}",)


OF_TASKS = {flag for task in TASKS.values() for flag in settings(task.load())}
FLAGS = (
    OF_TASKS
    | {flag for verb in VERBS.values() for flag in settings(verb.flags)}
    | {f"--{name}" for name in ("help", "import", *SINKS)}
)


@pytest.mark.parametrize("page", TEXTS)
def test_flags_in_sentences_exist(page: str) -> None:
    named = {word for span in spans(TEXTS[page]) if span.startswith("--") for word in span.split() if word[:2] == "--"}
    assert named <= FLAGS


@pytest.mark.parametrize("page", TEXTS)
def test_targets_of_make_exist(page: str) -> None:
    rules = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert {span.split()[1] for span in spans(TEXTS[page]) if re.fullmatch(r"make [\w-]+", span)} <= rules


@pytest.mark.parametrize("page", TEXTS)
def test_files_that_are_linked_or_named_exist(page: str) -> None:
    links = re.findall(r"\]\(([^):#]+)\)", TEXTS[page])
    assert not [link for link in links if not (ROOT / page).parent.joinpath(link).exists()]
    named = [span for span in spans(TEXTS[page]) if re.fullmatch(r"[\w/]+\.py", span) and "/" in span]
    assert not [file for file in named if not (SOURCE / file).exists() and not (ROOT / file).exists()]


def test_the_folders_of_the_layout_are_those_of_the_package_in_their_order() -> None:
    table = re.findall(r"^\| `(\w+)/` \|", TEXTS["CONTRIBUTING.md"], re.MULTILINE)
    assert table == [folder for folder in FOLDERS if (SOURCE / folder / "__init__.py").exists()]


def test_the_table_of_public_names_is_complete() -> None:
    _, table = TEXTS["docs/python.md"].split("| name | what it gives |\n")
    names = [re.findall(r"\w+", row)[0] for row in table.split("\n\n")[0].splitlines()[1:]]
    assert sorted(names) == sorted(reachlab.__all__)


# --- what is run ----------------------------------------------------------------------------------

PYTHON = [page for page, text in TEXTS.items() if any(not marks for _, marks in fenced(text, "python"))]


@pytest.mark.slow
@pytest.mark.parametrize("page", PYTHON)
def test_the_python_of_a_page_runs_from_top_to_bottom(page: str, tmp_path: Path) -> None:
    # Unless it is told, only the command line keeps compiled programs.
    cache = {"JAX_COMPILATION_CACHE_DIR": str(Path.home() / ".cache" / "reachlab" / "jax")} | dict(os.environ)
    script = "\n".join(body for body, marks in fenced(TEXTS[page], "python") if not marks)
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, env=cache, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    written = set(re.findall(r'Path\("([\w.]+)"\)', script))
    assert not [file for file in written if not (tmp_path / file).is_file()]


@pytest.mark.parametrize("page", TEXTS)
def test_what_is_marked_as_not_run_is_there(page: str) -> None:
    for block in commands_of(page, TEXTS[page]):
        for words, why in block.marks:
            assert why
            assert any(words in command for command in block.commands)
    told = sum(len(MARK.findall(marks)) for marks, _, _ in BLOCK.findall(TEXTS[page]))
    assert told == len(re.findall("^<!-- not run", TEXTS[page], re.MULTILINE))


def test_every_page_is_in_one_lane() -> None:
    found = [page for lane in [*lanes(), others()] for page in lane]
    assert sorted(found) == sorted(page for page in PAGES if page not in (CONTRIBUTING, SECURITY))


def test_a_command_that_fails_is_reported_and_a_marked_one_is_not_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- not run (false): it fails -->\n```console\n$ true\n$ false\n```\n", encoding="utf-8")
    assert run_pages([[page]]) == 0
    assert "page.md: false  (it fails)" in capsys.readouterr().out
    page.write_text("```console\n$ false\n```\n", encoding="utf-8")
    assert run_pages([[page]]) == 1


@pytest.mark.parametrize(
    ("words", "short"),
    [
        (
            "train --seed 3 --num-envs 5",
            "train --seed 3 --num-envs 32 --rollout-steps 8 --total-steps 1 --report-episodes 4 --max-steps 60",
        ),
        ("eval runs/first --episodes 300 --seed 1", "eval runs/first --seed 1 --episodes 4"),
        ("train --resume runs/first", "train --resume runs/first"),
        ("view runs/first", "view runs/first"),
        ("view runs/first --out a.html", "view runs/first --out a.html --episodes 1"),
        ("list", "list"),
    ],
)
def test_a_command_is_shortened(words: str, short: str) -> None:
    assert shortened(words.split()) == short.split()


def test_only_extras_that_exist_can_be_installed(capsys: pytest.CaptureFixture[str]) -> None:
    assert check_pip(["install", "-e", "."]) == check_pip(["install", "-e", ".[sweep,video]"]) == 0
    assert check_pip(["install", "-e", ".[videos]"]) == check_pip(["install", ".[sweep]"]) == 1
    assert "videos" in capsys.readouterr().err
