"""Picture of all arms at home, `images/arms.png`: `python docs/builder/arms.py` draws it anew."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from reachlab import load_robot
from reachlab.render.offscreen import portrait
from reachlab.robots.catalogue import ROBOTS

OUT = Path(__file__).parents[1] / "images" / "arms.png"

WIDTH, HEIGHT = 400, 320
"""Size of the picture of one arm [pixels]."""

FINER = 2
"""Pictures are drawn so many times as large, for smooth edges."""

COLUMNS = 3


def main() -> None:
    """Draw it."""
    pictures = [portrait(load_robot(name), FINER * WIDTH, FINER * HEIGHT) for name in ROBOTS]
    rows = [np.hstack(pictures[first : first + COLUMNS]) for first in range(0, len(pictures), COLUMNS)]
    whole = Image.fromarray(np.vstack(rows))
    whole.resize((whole.width // FINER, whole.height // FINER)).save(OUT, optimize=True)


if __name__ == "__main__":
    main()
