"""The verb `record`."""

from __future__ import annotations

import json as jsonlib
from contextlib import closing

from reachlab.agents import AGENTS
from reachlab.cli.eval_subjects import only_subject, other_goals
from reachlab.cli.preparation import prepare
from reachlab.cli.record_flags import Record
from reachlab.settings.json_form import override
from reachlab.settings.validation import choose


def record(arguments: Record) -> None:
    """Run `reachlab record`.

    Raises:
        InputError: a flag that does not fit, or a dataset that cannot be recorded.
    """
    agent = choose("agent", arguments.agent, AGENTS)
    prepare()
    from reachlab.cli.console import say
    from reachlab.cli.progress import Bar
    from reachlab.deploy.record import PART
    from reachlab.deploy.record import record as write
    from reachlab.envs.core import Env
    from reachlab.envs.setup import in_evaluation
    from reachlab.sims import SIMULATORS

    subject = only_subject(arguments, (agent,))
    known = subject.config
    varied = known.randomise if arguments.randomise is None else arguments.randomise
    # An observation without a picture does not vary with the view, and the cameras' pictures do.
    settings = arguments.settings
    checked = tuple(name for name in varied if name != "view" or not settings.cameras)
    config = in_evaluation(known, arguments.sim or known.sim, randomise=checked, **other_goals(arguments))
    config = override(config, randomise=varied)
    num_envs = min(SIMULATORS[config.sim].most_envs or PART, PART)
    with Bar() as display, closing(Env(config, num_envs)) as env:
        acting, policy, checkpoint = subject.acting(env, agent)
        display.expect(f"{agent} in {config.sim}", settings.episodes)
        try:
            made = write(env, acting, policy, arguments.out, settings, checkpoint=checkpoint, watch=display.count)
        except KeyboardInterrupt as interruption:
            interruption.args = (f"interrupted; the same command goes on in '{arguments.out}'.",)
            raise
    if arguments.json:
        print(jsonlib.dumps(vars(made)))
    else:
        say(
            f"Written: {made.out}, {made.episodes:,} of {made.tried:,} episodes, {made.steps:,} steps,"
            f" {made.bytes / 1e6:.2f} MB, in {made.seconds:.1f} s."
        )
