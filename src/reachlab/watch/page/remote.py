"""An arm that Python moves for a page: what the page asks of it, and what it is told; and episodes recorded for one."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from PIL import Image

from reachlab.agents import AGENTS
from reachlab.jax_setup import jit
from reachlab.settings.json_form import build
from reachlab.settings.validation import Checked, Coordinate, InputError, Length, Range, choose
from reachlab.watch.page.episode import arrays_of, links_of
from reachlab.watch.page.shapes import Figure
from reachlab.watch.page.shown import Shown
from reachlab.watch.player import TRAINED, Player, played

MOST_STEPS = 50
"""Control steps that a page asks for at once."""

DIGITS = 6
"""Digits after the point of what a page is told, in its units."""

PICTURES = 25.0
"""Moments of a recording in a second [1/s], about."""

SHORT = 1e-6
"""Length of a quaternion below which it has no direction."""

Message = dict[str, Any]
"""What a page is told of a moment: arrays of the state as the page's own functions give them, and what became of it."""


@dataclass(frozen=True)
class Asked(Checked):
    """What a page asks for, in this order.

    Attributes:
        run: number of the run.
        agent: who acts.
        begin: a new episode.
        proceed: what follows an episode that has ended.
        follow: no success ends an episode; None leaves that as it is.
        goal: where to put the goal `[3]` m, and after it a quaternion, wxyz, where it is turned; empty where it stays.
        body: number of a body and where to put it `[4]` m; empty where all stay.
        command: joint command `[n]` in place of the agent's; empty where the agent acts.
        steps: control steps.
    """

    run: Annotated[int, Range(0, 1000)] = 0
    agent: str = TRAINED
    begin: bool = False
    proceed: bool = False
    follow: bool | None = None
    goal: Annotated[tuple[Coordinate, ...], Length(7)] = ()
    body: Annotated[tuple[Coordinate, ...], Length(4)] = ()
    command: Annotated[tuple[Coordinate, ...], Length(1000)] = ()
    steps: Annotated[int, Range(0, MOST_STEPS)] = 0


def read_asked(text: bytes) -> Asked:
    """What a page asks for in its message.

    Raises:
        InputError: it is no JSON, names something else, or holds a value or a number of values that is not allowed.
    """
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        raise InputError("what is asked for is no JSON.") from None
    asked = build(Asked, data, "what is asked for")
    for name, sizes in {"goal": (0, 3, 7), "body": (0, 4)}.items():
        if (count := len(getattr(asked, name))) not in sizes:
            allowed = " or ".join(map(str, sizes[1:]))
            raise InputError(f"{name} must have {allowed} numbers, got {count}.")
    if len(asked.goal) > 3 and np.linalg.norm(asked.goal[3:]) < SHORT:
        raise InputError("the goal's quaternion must not be zero.")
    return asked


class Remote:
    """One arm of a page, moved here.

    Attributes:
        player: it plays the held-out episodes.
    """

    def __init__(self, shown: Shown) -> None:
        """Arm of a run at the begin of its first episode."""
        self.player, self._shown = Player(shown.env, shown.seed), shown
        self._reachable, self._begun = True, 0
        setup, n = shown.env.setup, shown.env.setup.robot.chain.n

        def arrays(state: Any) -> dict[str, Any]:
            return {**arrays_of(setup, state), **links_of(setup.robot.chain, state.arm.q[0, :n])}

        self._arrays: Callable[[Any], dict[str, Any]] = jit(arrays, brief=True)
        self._figure = Figure(setup.robot)

    def play(self, asked: Asked) -> Message:
        """Do what is asked for, and tell what came of it.

        Raises:
            InputError: it does not fit the arm or the task, or the agent cannot act.
        """
        player = self.player
        self._check(asked)
        if asked.begin or (asked.proceed and not player.over):
            player.begin(player.number + 1)
        elif asked.proceed:
            player.proceed()
        if asked.begin or asked.proceed:
            self._reachable, self._begun = True, self._begun + 1
        if asked.follow is not None:
            player.follow(asked.follow)
        if asked.goal:
            place, turn = np.array(asked.goal[:3]), np.array(asked.goal[3:])
            turn = turn / np.linalg.norm(turn) if turn.size else None
            low, high = self._shown.env.setup.task.goal_box(self._shown.env.setup)
            self._reachable = player.move_target(np.clip(place, low, high), turn)
        if asked.body:
            player.move_body(int(asked.body[0]), np.array(asked.body[1:]))
        command = np.array(asked.command, np.float32) if asked.command else None
        agent = self._shown.agent if asked.agent == self._shown.agent_name else asked.agent
        for _ in range(asked.steps):
            if not player.over:
                player.step(agent, self._shown.policy, command)
        return self.message()

    def _check(self, asked: Asked) -> None:
        """Make sure that what is asked for fits.

        Raises:
            InputError: it does not.
        """
        choose("agent", asked.agent, {*AGENTS, self._shown.agent_name})
        bodies, joints = self.player.state.arm.bodies.kind.shape[1], len(self._shown.env.setup.robot.actuators)
        if asked.body and asked.body[0] not in range(bodies):
            raise InputError(f"body must begin with a number below {bodies}, got {asked.body[0]:g}.")
        if asked.command and len(asked.command) != joints:
            raise InputError(f"command must have {joints} numbers, got {len(asked.command)}.")

    def message(self) -> Message:
        """What there is to tell of the moment."""
        player, moment = self.player, self.player.moment
        arrays = {name: _plain(part) for name, part in self._arrays(player.state).items()}
        arrays["clock"] = [player.clock]  # since the goal was moved
        return arrays | {
            "success": [moment.reached],
            "counted": [round(moment.error or 0.0, DIGITS)],
            "fingers": [[_plain(one[:3, :3].T), _plain(one[:3, 3])] for one in self._figure.move(moment.q)],
            "over": player.over,
            "failed": player.failed,
            "episodes": player.episodes,
            "successes": player.successes,
            "steps": player.steps,
            "begun": self._begun,
            "reachable": self._reachable,
            "picture": self._observed(),
        }

    def _observed(self) -> str | None:
        """What the policy observes now as an address of a PNG, if that is a picture."""
        if (picture := self.player.observed_picture()) is None:
            return None
        file = io.BytesIO()
        Image.fromarray(picture[..., 0]).save(file, "png")
        return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"


def record(shown: Shown, episodes: int) -> list[list[Message]]:
    """Moments of the first episodes of a run, each from its begin to its end."""
    remote, period = Remote(shown), shown.env.config.physics.control_period
    stride, found = max(1, round(1 / (PICTURES * period))), []
    for number in range(episodes):
        remote.player.begin(number)
        found.append([remote.message() for _ in played(remote.player, shown.agent, shown.policy, stride)])
    return found


def _plain(array: Any) -> list[Any]:
    """An array as a list that JSON can tell, NaN as null."""
    flat = np.asarray(array).ravel()
    if flat.dtype.kind != "f":
        return flat.tolist()
    return [round(x, DIGITS) if np.isfinite(x) else None for x in flat.astype(float).tolist()]
