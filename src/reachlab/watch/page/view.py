"""A page of any environment, from Python."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from reachlab.agents import AGENTS
from reachlab.agents.acting import Function
from reachlab.agents.policy import Policy
from reachlab.envs.core import Env
from reachlab.learn.interrupts import Interrupts
from reachlab.settings.arguments import typed
from reachlab.settings.validation import InputError, choose
from reachlab.watch.page.document import page_head
from reachlab.watch.page.page import EPISODES, page_body, write_page
from reachlab.watch.page.remote import Remote
from reachlab.watch.page.server import LOCAL, PageServer
from reachlab.watch.page.shown import shown_in


@typed
def view(
    env: Env,
    agent: str | Function = "trained",
    policy: Policy | None = None,
    *,
    seed: int = 1,
    out: str | Path | None = None,
    episodes: int = EPISODES,
    host: str = LOCAL,
    port: int = 8080,
    ended: Callable[[], bool] | None = None,
) -> None:
    """Show an agent in an environment in the browser, until Ctrl-C; or write the page to a file.

    What a browser can compute itself, it does: a policy of reachlab in the kinematic simulator or in MuJoCo. All else
    is moved here and streamed to the page: a policy of any other library, the planner, pictures, PyBullet.

    Args:
        env: the environment (`num_envs` 1).
        agent: name of an agent, or a function that gives actions `[1, a]` for observations, see `evaluate`.
        policy: the trained policy, for agent `trained`.
        seed: seed of the held-out episodes.
        out: file to write the page to, in place of serving it; what a browser cannot compute is recorded in it.
        episodes: how many are recorded.
        host: address to listen on; by default no other machine reaches it.
        port: port to listen on; the next free one where it is taken.
        ended: whether to end, asked ten times a second.

    Raises:
        InputError: more than one environment, no such agent, or the file cannot be written.
    """
    if env.num_envs != 1:
        raise InputError(f"view shows one environment, got {env.num_envs}: make it with num_envs=1.")
    if isinstance(agent, str) and AGENTS[choose("agent", agent, AGENTS)].trained and policy is None:
        raise InputError(f"agent {agent!r} needs a policy: `reachlab.load` gives that of a run.")
    shown = shown_in(env, agent, policy, seed=seed, name=env.config.task)
    if out is not None:
        write_page([shown], Path(out), episodes)
        return
    with PageServer(host, port) as server, Interrupts() as interrupts:
        engine = bool(shown.functions) and env.config.sim == "mujoco"
        server.add(page_head(shown.title, engine=engine, served=True) + page_body([shown]), last=True)
        sys.stdout.write(f"Page: {server.url}   Ctrl-C ends it.\n")
        server.serve([partial(Remote, shown)], lambda: interrupts.received is not None or bool(ended and ended()))
