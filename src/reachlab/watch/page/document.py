"""The page's document: what it holds whatever it shows, which a browser makes ready while runs are read."""

from __future__ import annotations

import base64
import html
import zlib
from pathlib import Path

ENGINE = {"wasm": "mujoco.wasm.zlib", "glue": "mujoco.js.zlib"}
"""The second of them, compressed, by the name of its part of a page."""

LICENCES = ("three.LICENSE", "meshoptimizer.LICENSE")
"""Those of what draws."""

STYLES = ("page.css", "panel.css", "narrow.css")
"""Its styles, of which later ones outrank earlier ones."""

TITLE = "reachlab"
"""Title of the page, after what it shows."""


def page_head(title: str, *, engine: bool, served: bool = False) -> str:
    """The page up to what it has to know of its runs: what draws, and MuJoCo where one is under dynamics."""
    packed, licences = {"three": zlib.compress(bytes_of("three.min.js"), 9)}, list(map(text_of, LICENCES))
    if engine:
        packed |= {name: bytes_of(file) for name, file in ENGINE.items()}
        licences.append("MuJoCo 3.14.0, copyright DeepMind Technologies Limited\n" + text_of("mujoco.LICENSE"))
    parts = {
        "title": html.escape(f"{title} · {TITLE}"),
        "connect": " connect-src 'self';" * served,
        "style": "\n".join(map(text_of, STYLES)),
        "licence": "\n".join(licences),
        "boot": text_of("boot.js"),
        "packed": "".join(part_of(name, content) for name, content in packed.items()),
    }
    before, *rest = text_of("page.html").split("{{")
    return before + "".join(parts[name] + after for name, after in (part.split("}}", 1) for part in rest))


def part_of(name: str, content: bytes) -> str:
    """A compressed part of a page, which no browser reads by itself."""
    return f'<script type="text/plain" id="{name}">{base64.b64encode(content).decode()}</script>\n'


def bytes_of(name: str) -> bytes:
    """A file of this folder."""
    return (Path(__file__).parent / name).read_bytes()


def text_of(name: str) -> str:
    """A file of this folder, as text."""
    return bytes_of(name).decode()
