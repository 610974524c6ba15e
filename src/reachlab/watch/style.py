"""How plots look: colours, kinds of line, and axes."""

from __future__ import annotations

from typing import Any

from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#999999")
"""Told apart without colour vision too (Okabe and Ito, "Color universal design", 2008; a grey in place of yellow)."""

LINES = ("-", "--", ":", "-.")
"""Kinds of line that tell simulators apart, and more groups than there are colours."""

STYLE: dict[str, Any] = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.6,
    "svg.hashsalt": "reachlab",
    "text.parse_math": False,  # a dollar in a run's name is a dollar
}
"""Settings of matplotlib."""

FINE, COARSE = (1.0, 2.0, 5.0), (1.0,)
"""Numbers that a logarithmic axis shows in each decade."""


def group_style(number: int) -> tuple[str, str]:
    """Colour and line of a group, by its place among those that were given."""
    return PALETTE[number % len(PALETTE)], LINES[number // len(PALETTE) % len(LINES)]


def show_plain_numbers(axis: Axis, shown: tuple[float, ...]) -> None:
    """Write the numbers of a logarithmic axis in full: those of `shown` times powers of ten."""
    axis.set_major_locator(LogLocator(subs=shown))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
