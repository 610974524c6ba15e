"""The verbs `video`, `view` and `plot`."""

from __future__ import annotations

import json as jsonlib
import webbrowser
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reachlab.agents import AGENTS
from reachlab.cli.eval_subjects import check_trust, find_subject, is_model, only_subject, other_goals
from reachlab.cli.flags import Plot, Video, View
from reachlab.cli.preparation import prepare
from reachlab.runs.files import check_place
from reachlab.settings.validation import InputError, choose

if TYPE_CHECKING:
    from reachlab.watch.page.shown import Shown


PAGE = "page.html"
"""File of a run's page, in its directory."""


def video(arguments: Video) -> None:
    """Run `reachlab video`."""
    prepare()
    from reachlab.cli.console import say
    from reachlab.cli.progress import Bar
    from reachlab.envs.core import Env
    from reachlab.envs.setup import in_evaluation
    from reachlab.runs.shipped import is_shipped
    from reachlab.watch.video import write_video

    agent = choose("agent", arguments.agent, AGENTS)
    subject = only_subject(arguments, (agent,))
    config, run = in_evaluation(subject.config, arguments.sim, **other_goals(arguments)), subject.run
    own = run is not None and not is_shipped(run)
    usual = run.path / "video.webp" if run and own else Path(f"{Path(config.robot).stem}-{config.task}.webp")
    given = {name: vars(arguments)[name] for name in ("seed", "episodes", "fps", "speed")}
    with closing(Env(config, 1)) as env, Bar() as display:
        acting, policy, _ = subject.acting(env, agent)
        display.expect(f"film of {agent} in {config.sim}", arguments.episodes)
        clip = write_video(env, acting, policy, arguments.out or usual, **given, watch=display.count)
    if arguments.json:
        print(jsonlib.dumps(vars(clip)))
    else:
        say(
            f"Written: {clip.out}, {clip.seconds:.1f} s, {clip.frames} pictures, {clip.bytes / 1e6:.2f} MB:"
            f" {clip.successes} of {clip.episodes} episodes reach the target."
        )


def view(arguments: View) -> None:
    """Run `reachlab view`.

    Raises:
        InputError: no run, or a flag without effect.
    """
    if not arguments.runs and not arguments.task:
        raise InputError(
            "view needs a run directory, a policy as panda/precise, or --task with a baseline as --agent ik."
        )
    if arguments.out:
        _write_page(arguments, arguments.out)
    else:
        _serve_page(arguments)


def _write_page(arguments: View, out: Path) -> None:
    """Run `reachlab view --out`."""
    usual = View()
    if foreign := [name for name in ("host", "port", "open") if getattr(arguments, name) != getattr(usual, name)]:
        raise InputError(f"view --out serves nothing, so --{foreign[0]} has no effect: leave it out.")
    check_trust(arguments)
    prepare()
    from reachlab.cli.console import note, say
    from reachlab.watch.page.page import ENDINGS, write_page

    check_place("the page", out, ENDINGS)
    shown = _load(arguments)
    for one in shown:
        if one.why:
            count = f"{arguments.episodes} episode{'s'[: arguments.episodes > 1]}"
            note(f"{one.name} is recorded for the page, {count}: {one.why}.")
    say(f"Written: {out}, {write_page(shown, out, arguments.episodes) / 1e6:.2f} MB")


def _load(arguments: View) -> list[Shown]:
    """What the page shows of each run and each model of another library.

    Raises:
        InputError: one of them cannot be read, or a model does not say what it was trained in.
    """
    return [one for path in arguments.runs or (None,) for one in _shown_of(arguments, path)]


def _shown_of(arguments: View, path: Path | None) -> Iterator[Shown]:
    from reachlab.envs.core import Env
    from reachlab.envs.setup import in_evaluation
    from reachlab.watch.page.shown import load_shown, shown_in

    given: dict[str, Any] = {name: getattr(arguments, name) for name in ("sim", "agent", "seed")}
    agent, changed = choose("agent", arguments.agent, AGENTS), other_goals(arguments)
    subject = find_subject(arguments, (agent,), path)
    if path and subject.run:
        for step in reversed(subject.run.checkpoint_steps()) if arguments.checkpoints else [None]:
            yield load_shown(path, step=step, changed=changed, **given)
        return
    model: Any = subject.model
    if model and not model.config:
        raise InputError(
            f"'{path}' does not say in which environment it was trained: show it from Python, with `reachlab.view`."
        )
    env = Env(in_evaluation(subject.config, arguments.sim, **changed), 1)
    acting, _, _ = subject.acting(env, agent)

    def trained(observation: Any, begins: Any) -> Any:
        return model and model.act(observation, begins)

    name = path.name if path else subject.config.task
    yield shown_in(env, trained if model and AGENTS[agent].trained else acting, None, seed=arguments.seed, name=name)


def _serve_page(arguments: View) -> None:
    """Run `reachlab view` without `--out`: a browser makes ready what draws and moves while the runs are read."""
    from reachlab.cli.console import note, say
    from reachlab.learn.interrupts import Interrupts
    from reachlab.runs.shipped import find_run, is_shipped
    from reachlab.watch.page.document import page_head
    from reachlab.watch.page.server import PageServer, is_local

    check_trust(arguments)
    runs = [find_run(path) for path in arguments.runs if not is_model(path)]
    engine = "mujoco" in [arguments.sim or run.read_config().sim for run in runs]
    with PageServer(arguments.host, arguments.port) as server, Interrupts() as interrupts:
        name = arguments.runs[0].name if arguments.runs else str(arguments.task)
        server.add(page_head(name, engine=engine, served=True))
        say(f"Page: {server.url}   Ctrl-C ends it.")
        if not is_local(arguments.host):
            note(
                f"Warning: --host {arguments.host} lets other machines in, without a password: anyone who reaches"
                " it can watch, and move arms that are computed here. They name this machine by its number, not by its"
                " name."
            )
        if arguments.open:
            webbrowser.open(server.url)
        prepare()
        from reachlab.watch.page.page import page_body, write_parts
        from reachlab.watch.page.remote import Remote

        shown = _load(arguments)
        server.add(body := page_body(shown), last=True)
        for one in shown:
            if one.why:
                note(f"{one.name} is computed here and streamed to the page: {one.why}.")
        if all(one.functions for one in shown) and not is_shipped(runs[0]) and not other_goals(arguments):
            file = runs[0].path / PAGE
            try:
                say(f"The same page as a file: {file}, {write_parts(shown, body, file) / 1e6:.2f} MB")
            except InputError as error:  # it is served all the same
                note(f"Warning: {error}")
        server.serve([partial(Remote, one) for one in shown], lambda: interrupts.received is not None)


def plot(arguments: Plot) -> None:
    """Run `reachlab plot`."""
    from reachlab.cli.console import note, say
    from reachlab.watch.plots import plot as draw

    if not arguments.runs:
        raise InputError("plot needs at least one run directory.")
    out = arguments.out or arguments.runs[0] / "plots.png"
    left_out = draw(arguments.runs, out)
    say(f"Written: {out}")
    for sentence in left_out:
        note(f"Not drawn: {sentence}")
