"""The files around the code say what the code does: version, names of commands, checks."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import yaml

import reachlab
from planted_faults import FAULTS, SOURCE, Fault

ROOT = Path(__file__).parent.parent
GITHUB = ROOT / ".github"
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_the_citation_tells_version_and_date_of_the_changelog_and_the_package() -> None:
    newest = re.search(r"^## (\S+) \((.+)\)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert newest
    version, date = newest.groups()
    assert CITATION["version"] == version == reachlab.__version__
    assert str(CITATION.get("date-released", "unreleased")) == date


def test_the_citation_is_of_the_project() -> None:
    assert CITATION["title"] == PROJECT["name"]
    assert CITATION["authors"] == PROJECT["authors"]
    assert CITATION["license"] == PROJECT["license"]
    assert CITATION["keywords"] == PROJECT["keywords"]
    assert CITATION["abstract"] == PROJECT["description"]


@pytest.mark.parametrize("path", sorted(GITHUB.rglob("*.yml")), ids=lambda path: path.name)
def test_files_of_the_code_host_are_yaml(path: Path) -> None:
    assert isinstance(yaml.safe_load(path.read_text(encoding="utf-8")), dict)


def test_the_code_host_checks_what_is_checked_here_and_may_only_read() -> None:
    workflow = yaml.safe_load((GITHUB / "workflows/check.yml").read_text(encoding="utf-8"))
    assert workflow["permissions"] == {"contents": "read"}
    (job,) = workflow["jobs"].values()
    assert job["timeout-minutes"] <= 90
    assert job["steps"][-1] == {"run": "bash .ci/run"}
    assert (ROOT / ".ci/run").is_file()


@pytest.mark.parametrize(
    ("badge", "said"),
    [
        ("python", " | ".join(re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"])))),
        ("licence", PROJECT["license"]),
    ],
)
def test_a_badge_tells_what_the_project_declares(badge: str, said: str) -> None:
    assert f">{said}</text>" in (ROOT / f"docs/images/badge-{badge}.svg").read_text(encoding="utf-8")


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: f"{fault.file}: {fault.wrong}")
def test_every_planted_fault_still_finds_its_place(fault: Fault) -> None:
    assert (SOURCE / "reachlab" / fault.file).read_text(encoding="utf-8").count(fault.right) == 1
