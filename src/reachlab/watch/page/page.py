"""The page: policies at work, with the physics of their training, in one file without server and network."""

from __future__ import annotations

import json
import zlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from reachlab.emit.braced import JAVASCRIPT_HEAD, javascript_function
from reachlab.emit.program import Program
from reachlab.render import marks
from reachlab.runs.files import write_whole
from reachlab.settings.validation import InputError
from reachlab.watch.page.document import page_head, part_of, text_of
from reachlab.watch.page.remote import Message, record
from reachlab.watch.page.shapes import scene
from reachlab.watch.page.shown import ENGINES, Shown, facts_of

EPISODES = 5
"""Episodes of a recording."""

SCRIPTS = (
    *("vectors", "physics", "episode", "player", "remote", "solids", "light", "bodies"),
    *("arm", "drawing", "view", "hand", "panel", "perturb", "joints", "chart", "live"),
)
"""The page's scripts, each after those that it needs when it is read."""


def write_page(shown: Sequence[Shown], out: Path, episodes: int = EPISODES) -> int:
    """Write a page of runs to choose from, and give its size [bytes]: what it cannot compute is recorded for it.

    Raises:
        InputError: an agent cannot act, or the file cannot be written.
    """
    check_folder(out)
    records = [None if one.functions else record(one, episodes) for one in shown]
    return write_parts(shown, page_body(shown, records), out)


def write_parts(shown: Sequence[Shown], body: str, out: Path) -> int:
    """Write a page whose body is known, and give its size [bytes].

    Raises:
        InputError: the file cannot be written.
    """
    engine = any(one.env.config.sim == ENGINES[1] for one in shown if one.functions)
    page = (page_head(f"{shown[0].title} · {shown[0].env.config.task}", engine=engine) + body).encode()
    try:
        write_whole(out, page)
    except OSError as error:
        raise InputError(f"page '{out}' cannot be written: {error.strerror}.") from None
    return len(page)


def check_folder(out: Path) -> None:
    """Make sure that a page can be written.

    Raises:
        InputError: its folder is not there, or its name is that of no page.
    """
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"the page cannot be written to '{out}': name a file that ends in .html.")
    if not out.parent.is_dir():
        raise InputError(f"page '{out}' cannot be written: there is no folder '{out.parent}'.")


def page_body(shown: Sequence[Shown], records: Sequence[list[list[Message]] | None] = ()) -> str:
    """What follows `page_head`: runs to choose from, each computed by the page, recorded, or moved by who serves it."""
    several = len({one.env.config.task for one in shown}) > 1
    labels = [one.title + f" · {one.env.config.task}" * several for one in shown]
    counts = Counter(labels)
    facts = {
        "runs": [
            facts_of(one) | {"label": f"{label} · {one.name}" if counts[label] > 1 else label, "record": moments}
            for one, label, moments in zip(shown, labels, records or [None] * len(shown), strict=True)
        ],
        "scenes": {one.scene: scene(one.env.setup.robot) for one in shown},
        "marks": _marks(),
    }
    packed = {
        "facts": json.dumps(facts, separators=(",", ":")).encode(),
        "script": script([printed(one.functions) for one in shown]).encode(),
    }
    parts = [part_of(name, zlib.compress(content, 9)) for name, content in packed.items()]
    return "".join([*parts, "<script>start().catch(fail);</script>\n</body>\n</html>\n"])


def script(functions: Sequence[str] = ()) -> str:
    """The page's own scripts as one, whose names nothing else sees, after the printed functions of its runs."""
    joined = "\n".join(text_of(f"{name}.js") for name in SCRIPTS)
    return (
        f'(() => {{\n"use strict";\n\n{JAVASCRIPT_HEAD}\nconst PROGRAMS = [{", ".join(functions)}];\n\n{joined}}})();\n'
    )


def printed(one: Sequence[Program]) -> str:
    """A function of a run's constants that gives its printed functions by name."""
    names = ", ".join(program.name for program in one)
    return f"(CONSTANTS) => {{\n{''.join(map(javascript_function, one))}return {{ {names} }};\n}}"


def _marks() -> dict[str, Any]:
    return {
        "waiting": marks.WAITING,
        "reached": marks.REACHED,
        "path": marks.PATH,
        "trail": marks.TRAIL,
        "fixed": marks.FIXED,
        "glass": marks.GLASS,
        "object": marks.OBJECT,
        "axes": marks.AXES,
        "tool_axes": marks.TOOL_AXES,
        "goal_axes": marks.TARGET_AXES,
        "radius": marks.TARGET_RADIUS,
        "opacity": marks.BALL_OPACITY,
    }
