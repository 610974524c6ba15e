"""Held-out episodes in the live page beside the same ones played natively.

`PYTHONPATH=tests python -m browser.played [ROBOT/TASK ...]` prints how far their states are apart after a second, how
many of them end alike, both success rates, the times in which goals are reached, and how long a control step takes.
`--episodes N` plays so many.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import jax
import numpy as np
from playwright.sync_api import Page

from browser.driver import chromium, opened
from browser.live import SIZES, open_live
from reachlab.agents.acting import make_act
from reachlab.bench.table import Row, row, to_markdown
from reachlab.emit.behaviour import motion_parts
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.envs.random_streams import REPORT_STREAM, episode_keys
from reachlab.jax_setup import use_compilation_cache
from reachlab.watch.page.page import write_page
from reachlab.watch.page.shown import load_shown

RUNS = tuple(f"panda/{task}" for task in ("precise", "pose", "track", "clutter", "push", "lift"))
"""Policies whose pages are played."""


@dataclass(frozen=True)
class Played:
    """Episodes that were played to their ends.

    Attributes:
        success: whether each is one `[B]`.
        steps: their lengths `[B]`.
        reached: steps until the goal was first reached `[B]`; not a number where it never was.
        tools: where the tool was after each step, `[T + 1, B, 3]` m.
        states: joints and bodies after a second `[B, k]`; not numbers where an episode had ended.
    """

    success: np.ndarray
    steps: np.ndarray
    reached: np.ndarray
    tools: np.ndarray
    states: np.ndarray


def begins(state: EnvState) -> list[dict[str, Any]]:
    """How the episodes of a state begin, as the page takes it."""
    parts = {"q": state.arm.actuated}
    for name, record in (("goal", state.goal), ("bodies", state.arm.bodies)):
        parts |= {f"{name}_{field.name}": getattr(record, field.name) for field in fields(record)}
    parts |= motion_parts(state.motion)
    arrays = {name: np.asarray(part) for name, part in parts.items() if part.size}
    return [{name: part[i].ravel().tolist() for name, part in arrays.items()} for i in range(len(state.key))]


def natively(env: Env, policy: Any, agent: str) -> tuple[list[dict[str, Any]], Played]:
    """Held-out episodes of an environment: how they begin, and how they go."""
    state: EnvState = env.compile_whole(env.init)(episode_keys(1, REPORT_STREAM, 0, env.num_envs))
    first, second = begins(state), round(1 / env.setup.period)
    act, key, tools = env.compile_whole(make_act(env, agent)), jax.random.key(0), [np.asarray(state.arm.tool_position)]
    success, steps = np.zeros(env.num_envs, bool), np.zeros(env.num_envs, int)
    reached, states = np.full(env.num_envs, np.nan), np.full((env.num_envs, 1), np.nan)
    while not steps.all():
        state, transition, key = act(policy, state, key)
        tools.append(np.asarray(state.arm.tool_position))
        near = np.asarray(env.setup.task.near(env.setup.rules, state.errors))
        reached[near & np.isnan(reached) & (steps == 0)] = len(tools) - 1
        if len(tools) - 1 == second:
            bodies = np.asarray(state.arm.bodies.position).reshape(env.num_envs, -1)
            states = np.concatenate([np.asarray(state.arm.actuated), bodies], axis=1)
            states[steps > 0] = np.nan
        ended = np.asarray(transition.done) & (steps == 0)
        success[ended], steps[ended] = np.asarray(transition.terms["success"])[ended], len(tools) - 1
    return first, Played(success, steps, reached, np.stack(tools), states)


PLAY = """async asked => {
    const { run, agent, episodes, watched } = JSON.parse(asked), { live } = reachlab;
    const one = await live.run(run), simulator = one.makeSimulator(), Episode = live.player.episode.constructor;
    const play = begin => {
        const episode = new Episode(one, begin, simulator), tools = [episode.tool];
        let reached = null, state = null;
        while (!episode.done) {
            episode.step(agent);
            tools.push(episode.tool);
            if (episode.near) reached ??= episode.clock;
            if (episode.clock === watched) state = [...episode.state.q, ...(episode.state.bodies_position ?? [])];
        }
        return { success: episode.success, steps: episode.clock, reached, tools, state };
    };
    return JSON.stringify(episodes.map(play));
}"""
"""What became of episodes that begin as given: success, steps, those until the goal was first reached, where the tool
was, and joints and bodies after so many steps as are watched."""


def in_page(page: Page, first: list[dict[str, Any]], number: int, agent: str, period: float) -> Played:
    """The same episodes of one of a page's runs."""
    asked = json.dumps({"run": number, "agent": agent, "episodes": first, "watched": round(1 / period)})
    # As texts: many numbers take long to hand over one by one.
    found = json.loads(page.evaluate(PLAY, asked))
    width = max((len(one["state"]) for one in found if one["state"]), default=1)
    tools = np.full((1 + max(one["steps"] for one in found), len(found), 3), np.nan)
    for i, one in enumerate(found):
        tools[: len(one["tools"]), i] = one["tools"]
    return Played(
        np.array([one["success"] for one in found]),
        np.array([one["steps"] for one in found]),
        np.array([np.nan if one["reached"] is None else one["reached"] for one in found]),
        tools,
        np.array([[np.nan] * width if one["state"] is None else one["state"] for one in found]),
    )


def figures(page: Page, run: str, number: int, episodes: int) -> list[Row]:
    """How episodes of a page are beside native ones."""
    shown = load_shown(Path(run))
    env = Env(shown.env.config, episodes)
    first, native = natively(env, shown.policy, "trained")
    env.close()
    began = time.perf_counter()
    there = in_page(page, first, number, "trained", env.setup.period)
    passed = time.perf_counter() - began
    apart = np.abs(native.states - there.states).max(axis=1)
    apart = apart[np.isfinite(apart)]
    steps = min(len(native.tools), len(there.tools))
    ways = np.linalg.norm(native.tools[:steps] - there.tools[:steps], axis=-1)
    told = {"episodes": episodes}
    return [
        row(f"page_tools_apart_worst/{run}", 1000 * float(np.nanmax(ways)), "mm", **told),
        *(
            row(f"page_apart_{q}/{run}", float(np.percentile(apart, q)), "rad or m", **told)
            for q in (50, 99)
            if len(apart)
        ),
        row(f"page_same_end/{run}", float((native.success == there.success).mean()), "share", **told),
        row(f"success/{run}", float(native.success.mean()), "share", **told),
        row(f"page_success/{run}", float(there.success.mean()), "share", **told),
        row(f"page_time/{run}", float(np.nanmean(there.reached) / np.nanmean(native.reached)), "native", **told),
        row(f"page_step/{run}", 1000 * passed / float(there.steps.sum()), "ms", **told),
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m browser.played", description=__doc__)
    parser.add_argument("runs", nargs="*", default=RUNS)
    parser.add_argument("--episodes", type=int, default=300)
    words = parser.parse_args()
    use_compilation_cache()
    with tempfile.TemporaryDirectory() as folder, chromium() as browser, opened(browser, *SIZES[0]) as page:
        file = Path(folder) / "page.html"
        write_page([load_shown(Path(run)) for run in words.runs], file)
        open_live(page, file)
        page.evaluate("reachlab.live.frame = () => {}")  # nothing is drawn
        rows = [one for number, run in enumerate(words.runs) for one in figures(page, run, number, words.episodes)]
    sys.stdout.write(to_markdown(rows))


if __name__ == "__main__":
    main()
