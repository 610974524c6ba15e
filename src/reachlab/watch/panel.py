"""The viewer's controls in the browser."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from queue import SimpleQueue
from typing import TYPE_CHECKING

import numpy as np

from reachlab.agents import AGENTS

if TYPE_CHECKING:
    import viser

SLOWEST, FASTEST, SPEED_STEP = 0.1, 4.0, 0.1
"""The speed slider's range and step, in multiples of real time."""

ENLARGED = 3
"""The policy's picture is shown so many times as large."""

NO_PICTURE = np.zeros((1, 1, 3), np.uint8)
"""Stands for the picture until there is one."""


PLAYABLE = tuple(name for name, entry in AGENTS.items() if not entry.remembers)
"""Agents of the viewer: what is moved by hand is not foreseen by one that has planned."""


class Panel:
    """The controls beside the scene. What is chosen is read from it; buttons leave their name in `pressed`."""

    def __init__(
        self,
        gui: viser.GuiApi,
        agent: str,
        checkpoints: Sequence[int],
        buttons: Sequence[str],
        *,
        pictured: bool,
        axes: bool = False,
    ) -> None:
        """Panel for the agents of `PLAYABLE`, the run's checkpoints, oldest first, and buttons of these names.

        Where the policy observes a picture (`pictured`) there is a place for it. The tool's `axes` are shown, or not.
        """
        self._steps = {_label(steps): steps for steps in checkpoints}
        self.pressed: SimpleQueue[str] = SimpleQueue()
        gui.configure_theme(show_logo=False, show_share_button=False)
        self._text = gui.add_markdown("Compiling …")
        self._refusal = gui.add_markdown("", visible=False)
        self._picture = (
            gui.add_image(NO_PICTURE, label="Observation", format="png", visible=False) if pictured else None
        )
        self._agent = gui.add_dropdown("Agent", PLAYABLE, initial_value=agent)
        self._checkpoint = gui.add_dropdown("Checkpoint", tuple(self._steps), initial_value=[*self._steps][-1])
        self._speed = gui.add_slider("Speed", SLOWEST, FASTEST, SPEED_STEP, 1.0, hint="Multiples of real time")
        group = gui.add_button_group("Control", buttons)
        group.on_click(lambda event: self.pressed.put(event.target.value))
        self._endless = gui.add_checkbox(
            "Endless", False, hint="No episode ends: the arm follows the target and rests there"
        )
        self._axes = gui.add_checkbox("Tool axes", axes)
        self._shadows = gui.add_checkbox("Shadows", False, hint="For a computer with a graphics card")

    @property
    def agent(self) -> str:
        """Name of the chosen agent."""
        return self._agent.value

    @property
    def checkpoint(self) -> int:
        """Steps of the chosen checkpoint."""
        return self._steps[self._checkpoint.value]

    @checkpoint.setter
    def checkpoint(self, steps: int) -> None:
        self._checkpoint.value = _label(steps)

    @property
    def speed(self) -> float:
        """Multiple of real time."""
        return self._speed.value

    @property
    def endless(self) -> bool:
        """Whether no episode ends."""
        return self._endless.value

    @endless.setter
    def endless(self, endless: bool) -> None:
        self._endless.value = endless

    @property
    def axes(self) -> bool:
        """Whether to show the tool's axes."""
        return self._axes.value

    def on_shadows(self, change: Callable[[bool], None]) -> None:
        """Call `change` when shadows are switched on or off."""
        self._shadows.on_update(lambda event: change(event.target.value))

    @property
    def said(self) -> str:
        """What `say` showed."""
        return self._text.content

    def say(self, text: str) -> None:
        """Show a text, in Markdown, above the controls."""
        self._text.content = text

    def show_observation(self, picture: np.ndarray) -> None:
        """Show the picture that the policy observes, `[height, width, 3]` uint8, where there is a place for it."""
        if self._picture is not None:
            self._picture.image = picture.repeat(ENLARGED, 0).repeat(ENLARGED, 1)
            self._picture.visible = True

    @property
    def refusal(self) -> str:
        """What `refuse` said."""
        return self._refusal.content

    def refuse(self, why: str) -> None:
        """Show why something cannot be done, until the next call; nothing where `why` is empty."""
        self._refusal.content, self._refusal.visible = why, bool(why)


def _label(steps: int) -> str:
    return f"{steps:,} steps"
