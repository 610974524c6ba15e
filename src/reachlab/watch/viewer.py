"""The viewer: an agent at work in the browser, with a target that a person moves and turns, and bodies."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from queue import SimpleQueue
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np

from reachlab.agents.policy import Policy
from reachlab.envs.core import Env
from reachlab.settings.validation import InputError, choose
from reachlab.watch.panel import PLAYABLE, Panel
from reachlab.watch.player import TRAINED, Player
from reachlab.watch.server import await_picture, start_server
from reachlab.watch.stage import FRAME_RATE, PAUSE, Stage, errors_text

if TYPE_CHECKING:
    import viser

TEXT_RATE = 5.0
"""Updates of the panel's figures in a second [1/s]."""

MOST_BEHIND = 0.5
"""Time that is made up for where steps take longer than they should [s]; the rest is dropped."""

UNREACHABLE = "The arm has no such pose: the target stays at the last one that it has."
"""Said where a target is dragged or turned to where the arm cannot be."""

MOVABLE = "Obstacles are moved by dragging them."
"""Said where there are some."""

Load = Callable[[int], Policy]
"""Policy of the checkpoint after so many steps."""


class Viewer:
    """A server for the browser, and the loop that plays.

    Attributes:
        url: where the browser finds it.
        player, handle: the arm, and the handle by which its target is moved; there once `prepare` was called.
        paused: nothing moves.
        panel, stage: what a person has chosen, and what is drawn.
        box: corners `[2, 3]` of where targets may be [m]; there once `prepare` was called.
    """

    player: Player
    box: np.ndarray
    handle: viser.TransformControlsHandle

    def __init__(self, env: Env, checkpoints: Sequence[int], load: Load, agent: str, host: str, port: int) -> None:
        """Viewer that shows the arm at home, before anything is compiled.

        Args:
            env: one environment (`num_envs` 1).
            checkpoints: steps of the run's checkpoints, oldest first.
            load: policy of one of them.
            agent: the first one to play, of `PLAYABLE`.
            host: address to listen on.
            port: port to listen on; the next free one where it is taken.

        Raises:
            InputError: viser is not installed, there is no such agent, or the address is not this machine's.
        """
        choose("agent", agent, PLAYABLE)
        self._env, self._load = env, load
        self._policies: dict[int, Policy] = {}
        self._playing: int | None = None
        self._server = start_server(host, port)
        self.stage = Stage(self._server, env.setup)
        self._turns = env.setup.rules.asks_orientation
        self.panel = Panel(
            self._server.gui, agent, checkpoints, tuple(COMMANDS), pictured=env.pictured, axes=self._turns
        )
        self.panel.on_shadows(self.stage.cast_shadows)
        self._pace = Pace()
        self._pulled: SimpleQueue[tuple[int, np.ndarray]] = SimpleQueue()
        self._dragged = self.paused = self._told_reached = False
        self._reachable = True
        self._owed = self._rest = 0.0
        self.url = f"http://{host}:{self._server.get_port()}"

    def __enter__(self) -> Self:
        """Use it until it is closed."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the server."""
        self._server.stop()

    def await_picture(self, ended: Callable[[], bool]) -> None:
        """Leave the processor to a browser that comes at once, until its first picture; see `server.await_picture`."""
        await_picture(self._server, ended)

    def prepare(self, seed: int) -> None:
        """Compile what playing takes and show the first held-out target of a seed."""
        self.player = Player(self._env, seed)
        self.player.prepare_hand()
        self.handle = self.stage.add_handle((self.stage.goals[1] > self.stage.goals[0]).tolist(), turns=self._turns)

        async def drag(event: viser.TransformControlsEvent) -> None:
            self._dragged = event.phase != "end"

        self.handle.on_update(drag)
        self._put_handle()
        self._policy()
        self._play(1)
        for number, body in enumerate(self.stage.bodies):
            self._let_drag(number, body)

    def _let_drag(self, number: int, body: viser.MeshHandle) -> None:
        grabbed = np.zeros(3)

        @body.on_drag
        async def pull(event: viser.SceneNodeDragEvent[viser.MeshHandle]) -> None:
            if event.phase == "start":
                grabbed[:] = np.subtract(event.start_position, body.position)
            self._pulled.put((number, np.subtract(event.end_position, grabbed)))

    def run(self, ended: Callable[[], bool]) -> None:
        """Play until it has ended."""
        last = time.perf_counter()
        while not ended():
            now = time.perf_counter()
            self.frame(now - last)
            last = now
            time.sleep(max(0.0, now + 1 / FRAME_RATE - time.perf_counter()))

    def frame(self, elapsed: float) -> None:
        """Play the time since the last picture [s]. Nothing moves while no browser is there."""
        while not self.panel.pressed.empty():
            COMMANDS[self.panel.pressed.get()](self)
        self._follow_hand()
        while not self._pulled.empty():
            self.player.move_body(*self._pulled.get())
            self._show()
        if self.paused or not self._server.get_clients():
            return
        self.player.follow(self._dragged or self.panel.endless)
        if self.player.over:
            self._rest -= elapsed
            if self._rest <= 0:
                self._begin_next()
        else:
            self._play(self._due(elapsed))

    def toggle_pause(self) -> None:
        """Pause or continue."""
        self.paused = not self.paused
        self._tell()

    def step(self) -> None:
        """Take one control step and pause."""
        self.paused = True
        if self.player.over:
            self._begin_next()
        self._play(1)
        self._tell()

    def reset(self) -> None:
        """Begin a new episode, with a new target; one that moves is on its path again."""
        self.player.begin(self.player.number + 1)
        self._begun()

    def _begin_next(self) -> None:
        """Begin a new episode, or after a failure to follow a new try from home."""
        self.player.proceed()
        self._begun()

    def _begun(self) -> None:
        self._reachable = True
        if not self._dragged:
            self._put_handle()
        self._show()
        self._tell()

    def _due(self, elapsed: float) -> int:
        """Control steps for which it is time."""
        period = self._env.config.physics.control_period
        self._owed += min(elapsed, MOST_BEHIND) * self.panel.speed
        steps = int(self._owed / period)
        self._owed -= steps * period
        return steps

    def _play(self, steps: int) -> None:
        player, agent = self.player, self.panel.agent
        policy = self._policy() if agent == TRAINED else None
        for _ in range(steps):
            if not player.over:
                player.step(agent, policy)
        self._rest = PAUSE
        if steps:
            self._show()

    def _policy(self) -> Policy:
        """Policy of the chosen checkpoint; where it cannot be read the last one stays, and the panel says why.

        Raises:
            InputError: it cannot be read, and there is no last one.
        """
        steps = self.panel.checkpoint
        if steps != self._playing:
            try:
                if steps not in self._policies:
                    self._policies[steps] = self._load(steps)
            except InputError as error:
                if self._playing is None:
                    raise
                self.panel.refuse(str(error))
                self.panel.checkpoint = steps = self._playing
            else:
                self.panel.refuse("")
                self._playing = steps
        return self._policies[steps]

    def _follow_hand(self) -> None:
        """Bring the target to where its handle was moved, and the handle back to where a target may be."""
        hand = self._handle_pose()
        if not np.array_equal(hand, self._hand) or (self._dragged and self.player.on_path):
            self._hand = hand
            self._reachable = self.player.move_target(np.clip(hand[:3], *self.stage.goals), hand[3:])
            self._show()
            self._tell()
        elif not self._dragged:
            self._put_handle()

    def _put_handle(self) -> None:
        moment = self.player.moment
        self.handle.position = moment.target
        if len(moment.target_orientation):
            self.handle.wxyz = moment.target_orientation
        self._hand = self._handle_pose()

    def _handle_pose(self) -> np.ndarray:
        """Position [m] and quaternion, wxyz, of the handle `[7]`."""
        return np.concatenate([self.handle.position, self.handle.wxyz])

    def _show(self) -> None:
        observation = self.player.observed_picture()
        with self._server.atomic():
            self.stage.show(self.player.moment, axes=self.panel.axes, observation=observation)
            if observation is not None:
                self.panel.show_observation(observation)
            if (
                self._pace.due(self.player.steps)
                or self.player.over
                or self.player.moment.reached != self._told_reached
            ):
                self._tell()

    def _tell(self) -> None:
        """Write the figures of one moment into the panel and below the target, both at once."""
        player, moment = self.player, self.player.moment
        rate = "paused" if self.paused else f"{self._pace.rate:.0f} steps/s"
        errors, self._told_reached = errors_text(moment), moment.reached
        mean = "" if moment.error is None else f", RMS {1000 * moment.error:.1f} mm"
        after = (
            ", **reached**" if moment.reached else f": **{player.failed}**, begins again at home" * bool(player.failed)
        )
        with self._server.atomic():
            self.stage.label.text = errors
            self.panel.say(
                f"**{errors}** to the target{mean}{after}\n\n"
                f"{player.successes} of {player.episodes} episodes reached · {rate}"
                + f"\n\n{UNREACHABLE}" * (not self._reachable)
                + f"\n\n{MOVABLE}" * any(block.present for block in moment.blocks)
            )


COMMANDS: dict[str, Callable[[Viewer], None]] = {
    "Pause": Viewer.toggle_pause,
    "Step": Viewer.step,
    "Reset": Viewer.reset,
}
"""Buttons of the panel, and what they do."""


class Pace:
    """Measures control steps in a second, `TEXT_RATE` times in each."""

    def __init__(self) -> None:
        """Pace from now on."""
        self.rate = 0.0
        self._since, self._steps = time.perf_counter(), 0

    def due(self, steps: int) -> bool:
        """Whether it is time for a new figure, which is then taken from all the `steps` so far."""
        elapsed = time.perf_counter() - self._since
        if elapsed < 1 / TEXT_RATE:
            return False
        self.rate = (steps - self._steps) / elapsed
        self._since, self._steps = time.perf_counter(), steps
        return True
