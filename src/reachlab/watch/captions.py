"""Captions below pictures: what is shown, and how far the tool is from the target."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, ImageFont

HEIGHT = 56
"""Height of the strip that a caption adds below a picture [pixels]; even, as MP4 needs it."""

MARGIN, INNER, LINE = 16, 10, 24
"""Distance of text from the strip's sides, of the verdict's text from its frame, and of two lines [pixels]."""

INSET_SCALE, FRAME = 2, 2
"""The policy's picture is drawn so many times as large, in a frame so wide [pixels]."""

FIGURES = 110
"""Width which the verdict leaves free for the figures on the right, at least [pixels]."""

LARGE, SMALL = 17, 13
"""Sizes of type [pixels]."""

FONTS = {"plain": "DejaVuSans.ttf", "bold": "DejaVuSans-Bold.ttf"}
"""Files of the fonts that matplotlib brings; their digits are all of one width."""

GROUND, INK, FAINT = (31, 41, 51), (255, 255, 255), (168, 179, 190)
"""Colours of the strip and of text on it."""

VERDICTS = {"success": (0, 158, 115), "failed": (213, 94, 0)}
"""Colours of an episode's end, told apart without colour vision too (Okabe and Ito, "Color universal design", 2008)."""

FINE_MM = 10.0
"""Below this distance tenths of a millimetre are shown [mm]."""


@dataclass(frozen=True)
class Caption:
    """What a caption says.

    Attributes:
        title, detail: two lines on the left.
        distance: tool to target [m].
        time: since the episode began [s].
        verdict: of `VERDICTS`; empty while the episode is under way.
        angle: between their orientations [rad]; without numbers where any will do.
        error: root mean square of the distance so far [m]; None where it does not count.
    """

    title: str
    detail: str
    distance: float
    time: float
    verdict: str = ""
    angle: ArrayLike = ()
    error: float | None = None


def captioned(picture: np.ndarray, caption: Caption) -> Image.Image:
    """A picture `[height, width, 3]` uint8 with a caption below it, `HEIGHT` pixels higher."""
    height, width, _ = picture.shape
    image = Image.new("RGB", (width, height + HEIGHT), GROUND)
    image.paste(Image.fromarray(picture), (0, 0))
    draw = ImageDraw.Draw(image)
    upper = height + (HEIGHT - LINE) // 2
    right = width - MARGIN
    (large, small), (errors, time) = (_font("bold", LARGE), _font("plain", SMALL)), _figures(caption)
    widest = max(draw.textlength(errors, large), draw.textlength(time, small))
    room = right - widest - 2 * MARGIN
    if caption.verdict:
        free = max(FIGURES, round(widest) + MARGIN + INNER)
        room = _stamp(draw, (right - free, height + HEIGHT // 2), caption.verdict) - INNER - MARGIN
    draw.text((MARGIN, upper), _fitting(caption.title, large, room), INK, large, anchor="lm")
    draw.text((MARGIN, upper + LINE), _fitting(caption.detail, small, room), FAINT, small, anchor="lm")
    draw.text((right, upper), errors, INK, large, anchor="rm")
    draw.text((right, upper + LINE), time, FAINT, small, anchor="rm")
    return image


def inset(picture: np.ndarray, observation: np.ndarray) -> np.ndarray:
    """A picture `[height, width, 3]`, enlarged in its corner the one that the policy observes, `[SIZE, SIZE, 3]`."""
    image, side = Image.fromarray(picture), INSET_SCALE * len(observation)
    small = Image.fromarray(observation).resize((side, side), Image.Resampling.NEAREST)
    corner = (image.width - side - MARGIN, MARGIN)
    frame = Image.new("RGB", (side + 2 * FRAME, side + 2 * FRAME), INK)
    image.paste(frame, (corner[0] - FRAME, corner[1] - FRAME))
    image.paste(small, corner)
    return np.asarray(image)


def distance_text(distance: float) -> str:
    """A distance [m] in millimetres, with a tenth where that can be seen."""
    millimetres = 1000 * distance
    return f"{millimetres:.{1 if millimetres < FINE_MM else 0}f} mm"


def angle_text(angle: float) -> str:
    """An angle [rad] in degrees."""
    return f"{np.degrees(angle):.1f}°"


def _figures(caption: Caption) -> tuple[str, str]:
    """Two lines: how far the tool is from the target, and the time."""
    time, angles = f"{caption.time:.2f} s", map(angle_text, np.ravel(caption.angle))
    errors = "  ".join([distance_text(caption.distance), *angles])
    return errors, time if caption.error is None else f"RMS {distance_text(caption.error)} · {time}"


def _fitting(text: str, font: ImageFont.FreeTypeFont, room: float) -> str:
    """A text as far as there is room for it [pixels]."""
    if font.getlength(text) <= room:
        return text
    kept = next((n for n in range(len(text), 0, -1) if font.getlength(text[:n].rstrip() + "…") <= room), 0)
    return text[:kept].rstrip() + "…"


def _stamp(draw: ImageDraw.ImageDraw, end: tuple[int, int], verdict: str) -> float:
    """Draw the verdict, in a frame filled with its colour, to the left of a point, and say where that begins."""
    font = _font("bold", LARGE)
    left, top, right, bottom = draw.textbbox(end, verdict, font, anchor="rm")
    box = (left - INNER, top - INNER, right + INNER, bottom + INNER)
    draw.rounded_rectangle(box, radius=INNER, fill=VERDICTS[verdict])
    draw.text(end, verdict, INK, font, anchor="rm")
    return box[0]


@functools.cache
def _font(style: str, size: int) -> ImageFont.FreeTypeFont:
    import matplotlib as mpl

    return ImageFont.truetype(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / FONTS[style]), size)
