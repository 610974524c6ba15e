"""The site: its tables say what the code does, its drawings are of this code, and every public name is documented."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import reachlab
from browser.driver import executable
from browser.site import broken, misfits
from builder import MARK, ON_SITE, PART, PARTS, drawings, filled, renewed
from builder.commands import flags
from builder.docstrings import field_docstrings
from builder.tables import FORMULAS, TERMS, VARIED
from reachlab.cli.verbs import VERBS
from reachlab.envs.consistency import RANDOMISED
from reachlab.settings.validation import hints
from reachlab.tasks.judging import Outcome
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.rewards import REWARDS
from reachlab.tasks.task import Errors
from situations import RULES
from test_imports import FOLDERS

# --- tables ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", REWARDS)
def test_formulas_of_rewards_give_what_the_rewards_give(name: str) -> None:
    rng = np.random.default_rng(0)
    distance, gap_before, speed, effort = rng.uniform(0, 0.3, (4, 50))
    outside, success, timeout = rng.random((3, 50)) < 0.5
    gained = rng.integers(-1, 2, 50)
    rules = dataclasses.replace(RULES, effort_weight=0.3)
    near, errors = distance < rules.success_distance, Errors(distance, 0 * distance)
    ends: list[Any] = [speed, effort, outside, success, timeout, gained, success | outside]
    names = {**vars(rules), "gap": distance, "gap_before": gap_before, "speed": speed, "effort": effort}
    names |= {"gained": gained, "outside": outside, "timeout": timeout, "near": distance < rules.success_distance}
    told = {term: eval(formula, {}, names | {"success": success}) for term, formula in FORMULAS[name].items()}
    given = REWARDS[name](rules, Outcome(errors, gap_before, distance, near, errors, (), *ends))
    assert told.keys() == given.keys()
    for term, values in given.items():
        np.testing.assert_allclose(told[term], np.asarray(values), atol=1e-6)


def test_every_term_and_everything_that_varies_is_described() -> None:
    assert {term.name for design in OBSERVATIONS.values() for term in design.terms} == set(TERMS)
    assert set(VARIED) == set(RANDOMISED)


@pytest.mark.parametrize("verb", VERBS)
def test_every_flag_is_described(verb: str) -> None:
    assert not [flag.written for flag in flags(VERBS[verb].flags, None) if not flag.text]


DOCS = Path(reachlab.__file__).parents[2] / "docs"
PAGES = {page.name: page.read_text(encoding="utf-8") for page in sorted(DOCS.glob("*.md"))}


@pytest.mark.parametrize("page", [name for name, text in PAGES.items() if PART.search(text)])
def test_tables_of_a_page_are_those_of_the_code(page: str) -> None:
    assert renewed(PAGES[page]) == PAGES[page], "write them anew with `make tables`"


def test_a_part_that_a_page_asks_for_is_filled_in() -> None:
    assert filled("a\n<!-- made at the build: live arms -->\nb").count("<iframe") == 1
    assert renewed("<!-- made by make tables: agents -->\nold\n<!-- end -->").count("\n| `ik` |") == 1
    with pytest.raises(KeyError, match="no such part"):
        filled("<!-- made at the build: no such part -->")


def test_every_part_is_asked_for_by_a_page() -> None:
    text = "".join(PAGES.values())
    assert set(PART.findall(text)) == set(PARTS)
    assert set(MARK.findall(text)) == set(ON_SITE)


# --- drawings -------------------------------------------------------------------------------------


def test_drawings_are_those_of_their_script_and_of_the_folders_in_their_order() -> None:
    assert tuple(name for name, _, _ in drawings.ROOMS) == FOLDERS
    for name, text in (("way", drawings.way()), ("rooms", drawings.rooms())):
        assert (drawings.IMAGES / f"{name}.svg").read_text(encoding="utf-8") == text


# --- documentation of public names ----------------------------------------------------------------


def undocumented(one: Any) -> Iterator[str]:
    """Names of what is not described: itself, its parameters, or a public attribute."""
    docstring = inspect.getdoc(one) or ""
    if not docstring:
        yield "itself"
    if not inspect.isclass(one):
        listed = re.findall(r"^    \*{0,2}(\w+): ", docstring.partition("Args:")[2], re.MULTILINE)
        yield from inspect.signature(one).parameters.keys() - set(listed)
        return
    texts = field_docstrings(one)
    for owner in (cls for cls in one.__mro__ if cls.__module__.startswith("reachlab.")):
        yield from (name for name, member in vars(owner).items() if _is_silent(name, member))
        yield from (name for name in _attributes(owner) if name not in texts and not name.startswith("_"))


def _is_silent(name: str, member: Any) -> bool:
    described = inspect.isroutine(member) or isinstance(member, property) or hasattr(member, "func")
    return described and not name.startswith("_") and not inspect.getdoc(member)


def _attributes(cls: type) -> Iterator[str]:
    """Fields of a class, but for those that are groups of settings, and what its `__init__` assigns."""
    for name in inspect.get_annotations(cls):
        kind = hints(cls).get(name) if dataclasses.is_dataclass(cls) else None
        if not (dataclasses.is_dataclass(kind) and field_docstrings(kind) and inspect.isclass(kind)):
            yield name
    if "__init__" in vars(cls) and not dataclasses.is_dataclass(cls):
        tree = ast.parse(textwrap.dedent(inspect.getsource(cls.__init__)))
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
                yield node.attr


@pytest.mark.parametrize("name", reachlab.__all__)
def test_every_public_name_its_parameters_and_its_attributes_are_documented(name: str) -> None:
    assert sorted(set(undocumented(getattr(reachlab, name)))) == []


def test_what_is_not_documented_is_found() -> None:
    class Silent:
        known: int
        """It is described."""
        unknown: int

        def method(self) -> None: ...

    assert set(undocumented(Silent)) == {"itself"}  # only members of the package are asked for
    Silent.__module__ = "reachlab.silent"
    assert set(undocumented(Silent)) == {"itself", "unknown", "method"}


# --- the built site -------------------------------------------------------------------------------

PAGE = '<html><body id="top"><a href="{link}">there</a><img src="a.png"><p style="width: {width}px">x</p></body></html>'


def _site(folder: Path, link: str = "#top", width: int = 100, picture: bool = True) -> Path:
    (folder / "index.html").write_text(PAGE.format(link=link, width=width), encoding="utf-8")
    if picture:
        (folder / "a.png").touch()
    return folder


@pytest.mark.parametrize("link", ["#top", "index.html", "index.html#top", "https://example.org/gone"])
def test_a_link_that_holds_is_not_reported(link: str, tmp_path: Path) -> None:
    assert not list(broken(_site(tmp_path, link)))


@pytest.mark.parametrize("link", ["#bottom", "gone.html", "index.html#bottom"])
def test_a_link_that_leads_nowhere_is_reported(link: str, tmp_path: Path) -> None:
    assert list(broken(_site(tmp_path, link))) == [f"index.html: {link} leads nowhere"]


def test_a_picture_that_is_missing_is_reported(tmp_path: Path) -> None:
    assert list(broken(_site(tmp_path, picture=False))) == ["index.html: a.png leads nowhere"]


@pytest.mark.skipif(executable() is None, reason="needs Chromium")
def test_a_page_that_is_too_wide_for_a_phone_is_reported(tmp_path: Path) -> None:
    assert not list(misfits(_site(tmp_path)))
    assert any("wide on a phone" in line for line in list(misfits(_site(tmp_path, width=600))))
