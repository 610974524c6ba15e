"""A recording of episodes as one page, which plays in a browser without server or network."""

from __future__ import annotations

from pathlib import Path

from reachlab.agents import AGENTS
from reachlab.agents.policy import Policy
from reachlab.envs.core import Env
from reachlab.settings.validation import InputError, choose
from reachlab.watch.player import Player, played
from reachlab.watch.server import LOCAL, TITLE, start_server
from reachlab.watch.stage import FRAME_RATE, PAUSE, Stage, errors_text


def save_page(env: Env, agent: str, policy: Policy | None, seed: int, episodes: int, out: Path) -> None:
    """Write episodes of an agent as one page that needs no server and no network.

    Raises:
        InputError: viser is not installed, there is no such agent, or the file cannot be written.
    """
    choose("agent", agent, AGENTS)
    if not out.parent.is_dir():
        raise InputError(f"page '{out}' cannot be written: there is no folder '{out.parent}'.")
    title = f"{TITLE} · {env.config.task} task · {agent}"
    page = _record(env, agent, policy, seed, episodes, title)
    try:
        out.write_text(page.replace("<title>Viser</title>", f"<title>{title}</title>", 1), encoding="utf-8")
    except OSError as error:
        raise InputError(f"page '{out}' cannot be written: {error.strerror}.") from None


def _record(env: Env, agent: str, policy: Policy | None, seed: int, episodes: int, title: str) -> str:
    """The page's HTML."""
    period = env.config.physics.control_period
    steps = max(1, round(1 / FRAME_RATE / period))
    server = start_server(LOCAL, 0)
    try:
        stage, player = Stage(server, env.setup), Player(env, seed)
        recording = server.get_scene_serializer()
        for number in range(episodes):
            player.begin(number)
            for _ in played(player, agent, policy, steps):
                with server.atomic():
                    moment = player.moment
                    stage.show(moment, axes=moment.angle is not None, observation=player.observed_picture())
                    stage.label.text = errors_text(moment)
                    stage.head(f"{title} · episode {number + 1} of {episodes}")
                # The page shows texts and colours a little later than poses: an episode's begin stands too.
                stands = player.over or player.clock == 0
                recording.insert_sleep(PAUSE if stands else steps * period)
        return recording.as_html()
    finally:
        server.stop()
