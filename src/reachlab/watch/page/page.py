"""The page: policies at work, with the physics of their training, in one file without server and network."""

from __future__ import annotations

import json
import zlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from reachlab.emit.braced import JAVASCRIPT_HEAD, javascript_function
from reachlab.emit.program import Program
from reachlab.render import marks
from reachlab.runs.files import check_place, written
from reachlab.watch.page.document import page_head, part_of, text_of
from reachlab.watch.page.remote import Message, record
from reachlab.watch.page.shapes import scene
from reachlab.watch.page.shown import ENGINES, Shown, facts_of

EPISODES = 5
"""Episodes of a recording."""

ENDINGS = (".html", ".htm")
"""Of a page's file."""

SCRIPTS = (
    *("vectors", "physics", "episode", "player", "remote", "solids", "light", "bodies"),
    *("arm", "drawing", "view", "hand", "panel", "perturb", "joints", "chart", "live"),
)
"""The page's scripts, each after those that it needs when it is read."""

MARKS = (
    *("WAITING", "REACHED", "PATH", "TRAIL", "FIXED", "GLASS", "OBJECT", "AXES"),
    *("TOOL_AXES", "TARGET_AXES", "TARGET_RADIUS", "BALL_OPACITY"),
)
"""Colours and lengths of `render.marks` that the scripts know, by their names in lower case."""


def write_page(shown: Sequence[Shown], out: Path, episodes: int = EPISODES) -> int:
    """Write a page of runs to choose from, and give its size [bytes]: what it cannot compute is recorded for it.

    Raises:
        InputError: an agent cannot act, or the file cannot be written.
    """
    check_place("the page", out, ENDINGS)
    records = [None if one.functions else record(one, episodes) for one in shown]
    return write_parts(shown, page_body(shown, records), out)


def write_parts(shown: Sequence[Shown], body: str, out: Path) -> int:
    """Write a page whose body is known, and give its size [bytes].

    Raises:
        InputError: the file cannot be written.
    """
    engine = any(one.env.config.sim == ENGINES[1] for one in shown if one.functions)
    page = (page_head(f"{shown[0].title} · {shown[0].env.config.task}", engine=engine) + body).encode()
    with written("the page", out) as part:
        part.write_bytes(page)
    return len(page)


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
        "marks": {name.lower(): vars(marks)[name] for name in MARKS},
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
