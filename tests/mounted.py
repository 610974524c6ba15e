"""Arms of the catalogue that stand elsewhere or face another way, as files of their own."""

from __future__ import annotations

import re
from pathlib import Path

from reachlab.robots.catalogue import ROBOTS


def mounted(folder: Path, place: str = "0 0 0", yaw: float = 0.0) -> str:
    """Path of a Panda that stands at a place [m], turned [rad]; its first joint turns it no further than to its sides.

    Were it free to turn, any side of it would be its front.
    """
    text = ROBOTS["panda"].file.read_text()
    text = re.sub(r"<body name=", f'<body pos="{place}" euler="0 0 {yaw}" name=', text, count=1)
    first = text.index("<joint ", text.index('name="link_1"'))
    text = text[:first] + re.sub(r'range="[^"]*"', 'range="-0.9 0.9"', text[first:], count=1)
    file = folder / "mounted.xml"
    file.write_text(text)
    return str(file)
