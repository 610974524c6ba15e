"""The verbs `video`, `view` and `plot`."""

from __future__ import annotations

import json as jsonlib
import webbrowser
from contextlib import closing
from functools import partial
from pathlib import Path

from reachlab.agents import AGENTS
from reachlab.cli.flags import Plot, Video, View
from reachlab.cli.preparation import prepare
from reachlab.envs.presets import in_simulator
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import override
from reachlab.settings.validation import InputError, choose


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
        InputError: no run or several where one is needed, or a flag that does not go with `--live`.
    """
    if arguments.live:
        _view_live(arguments, arguments.live)
        return
    if len(arguments.runs) != 1:
        raise InputError(f"view needs one run directory, got {len(arguments.runs)}: several go with --live.")
    prepare()
    from reachlab.cli.console import note, say
    from reachlab.envs.core import Env
    from reachlab.learn.interrupts import Interrupts
    from reachlab.learn.load import load_policy
    from reachlab.runs.shipped import find_run
    from reachlab.watch.server import is_local
    from reachlab.watch.viewer import Viewer

    run = find_run(arguments.runs[0])
    config = _as_it_is(run.read_config(), arguments.sim)
    with closing(Env(config, 1)) as env:
        if arguments.save:
            from reachlab.watch.saved_page import save_page

            policy = load_policy(run, env)
            save_page(env, arguments.agent, policy, arguments.seed, arguments.episodes, arguments.save)
            say(f"Written: {arguments.save}")
            return
        load = partial(load_policy, run, env)
        viewer = Viewer(env, run.checkpoint_steps(), load, arguments.agent, arguments.host, arguments.port)
        with viewer, Interrupts() as interrupts:
            say(f"Viewer: {viewer.url}   Ctrl-C ends it.")
            if not is_local(arguments.host):
                note(
                    f"Warning: --host {arguments.host} lets other machines in, without a password: anyone who reaches"
                    " it can watch and move the target."
                )
            if arguments.open:
                webbrowser.open(viewer.url)

            def ended() -> bool:
                return interrupts.received is not None

            viewer.await_picture(ended)
            viewer.prepare(arguments.seed)
            viewer.run(ended)


def _view_live(arguments: View, out: Path) -> None:
    """Run `reachlab view --live`."""
    if not arguments.runs:
        raise InputError("view needs at least one run directory.")
    usual = vars(View(arguments.runs, live=out))
    if foreign := sorted(name for name, value in vars(arguments).items() if value != usual[name]):
        raise InputError(f"view --live makes no use of --{foreign[0]}: leave it out.")
    prepare()
    from reachlab.cli.console import say
    from reachlab.watch.page.page import write_page

    say(f"Written: {out}, {write_page(arguments.runs, out) / 1e6:.2f} MB")


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
