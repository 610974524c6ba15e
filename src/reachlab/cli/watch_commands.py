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
from reachlab.cli.eval_subjects import check_trust, find_model, is_model
from reachlab.cli.flags import Plot, Video, View
from reachlab.cli.preparation import prepare
from reachlab.envs.presets import in_simulator
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import override
from reachlab.settings.validation import InputError, choose

if TYPE_CHECKING:
    from reachlab.watch.page.shown import Shown


PAGE = "page.html"
"""File of a run's page, in its directory."""


def _as_it_is(trained: RunConfig, sim: str | None) -> RunConfig:
    """Settings of a run in a simulator, by default its own, without random views."""
    from reachlab.sims import SIMULATORS

    return override(in_simulator(trained, choose("simulator", sim or trained.sim, SIMULATORS)), randomise=())


def video(arguments: Video) -> None:
    """Run `reachlab video`."""
    prepare()
    from reachlab.cli.console import say
    from reachlab.envs.core import Env
    from reachlab.learn.load import load_policy
    from reachlab.runs.shipped import find_run, is_shipped
    from reachlab.watch.video import write_video

    agent = choose("agent", arguments.agent, AGENTS)
    run = find_run(arguments.run)
    config = _as_it_is(run.read_config(), arguments.sim)
    usual = Path(f"{config.robot}-{config.task}.webp") if is_shipped(run) else run.path / "video.webp"
    given = {name: vars(arguments)[name] for name in ("seed", "episodes", "fps", "speed")}
    with closing(Env(config, 1)) as env:
        clip = write_video(env, agent, load_policy(run, env), arguments.out or usual, **given)
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
    if not arguments.runs:
        raise InputError("view needs at least one run directory, or a policy as panda/precise.")
    if arguments.out:
        _write_page(arguments, arguments.out)
    else:
        _serve_page(arguments)


def _write_page(arguments: View, out: Path) -> None:
    """Run `reachlab view --out`."""
    usual = View(arguments.runs)
    if foreign := [name for name in ("host", "port", "open") if getattr(arguments, name) != getattr(usual, name)]:
        raise InputError(f"view --out serves nothing, so --{foreign[0]} has no effect: leave it out.")
    check_trust(arguments)
    prepare()
    from reachlab.cli.console import note, say
    from reachlab.watch.page.page import check_folder, write_page

    check_folder(out)
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
    return [one for path in arguments.runs for one in _shown_of(arguments, path)]


def _shown_of(arguments: View, path: Path) -> Iterator[Shown]:
    from reachlab.envs.core import Env
    from reachlab.runs.shipped import find_run
    from reachlab.watch.page.shown import load_shown, settings_shown, shown_in

    given = {name: getattr(arguments, name) for name in ("sim", "agent", "seed")}
    model = find_model(arguments, path)
    if not model:
        for step in reversed(find_run(path).checkpoint_steps()) if arguments.checkpoints else [None]:
            yield load_shown(path, step=step, **given)
        return
    if not model.config:
        raise InputError(
            f"'{path}' does not say in which environment it was trained: show it from Python, with `reachlab.view`."
        )
    env = Env(settings_shown(model.config, arguments.sim), 1)
    model.check(env.schema)

    def trained(observation: Any) -> Any:
        return model.act(observation)

    agent = trained if AGENTS[choose("agent", arguments.agent, AGENTS)].trained else arguments.agent
    yield shown_in(env, agent, None, seed=arguments.seed, name=path.name)


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
        server.add(page_head(arguments.runs[0].name, engine=engine, served=True))
        say(f"Page: {server.url}   Ctrl-C ends it.")
        if not is_local(arguments.host):
            note(
                f"Warning: --host {arguments.host} lets other machines in, without a password: anyone who reaches"
                " it can watch, and move arms that are computed here."
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
        if all(one.functions for one in shown) and not is_shipped(runs[0]):
            file = runs[0].path / PAGE
            say(f"The same page as a file: {file}, {write_parts(shown, body, file) / 1e6:.2f} MB")
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
