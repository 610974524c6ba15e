"""Suite `printed`: every pair of entries of the tables of tasks, observations, actions and robots, exported."""

from __future__ import annotations

import itertools
import json
import shutil
import subprocess
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np

from benchmarks.deploy import UNITS, lively_run
from reachlab.agents.policy import Policy
from reachlab.bench.table import Row, row
from reachlab.deploy.export import export
from reachlab.deploy.weights import named_weights
from reachlab.emit.behaviour import as_measured, behaviour, rows_of
from reachlab.emit.braced import JAVASCRIPT_HEAD, javascript_function
from reachlab.emit.program import constants_of
from reachlab.envs.consistency import check
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import REPORT_STREAM, episode_keys
from reachlab.envs.setup import in_evaluation
from reachlab.learn.load import load_policy
from reachlab.robots.catalogue import ROBOTS
from reachlab.runs.directory import RunDirectory
from reachlab.settings.validation import InputError
from reachlab.tasks import TASKS
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.watch.page.page import write_page
from reachlab.watch.page.shown import load_shown

TABLES = {"task": TASKS, "observation": OBSERVATIONS, "action": ACTIONS, "robot": ROBOTS}

JAVASCRIPT = "JavaScript"
SITUATIONS = 200
"""Situations in which the printed JavaScript is compared."""

Names = dict[str, str]
Pair = tuple[tuple[str, str], tuple[str, str]]


def printed() -> Iterator[Row]:
    """Differences of exports over every pair of entries, how many there are, and what is refused."""
    worst, refused, pages = dict[str, tuple[float, str]](), defaultdict[str, list[str]](list), 0
    chosen = list(combinations())
    for names in chosen:
        label = "/".join(names.values())
        with tempfile.TemporaryDirectory() as place:
            settings = {name: value for name, value in names.items() if name != "task"}
            run, found = lively_run(Path(place) / "run", names["task"], **settings), dict[str, float]()
            try:
                found |= export(run, Path(place) / "policy").differences
                found |= _in_javascript(run)
            except InputError as error:
                refused[str(error).replace(place, "…")].append(label)
            shown = load_shown(run.path)
            if shown.why:
                refused["a page: " + shown.why].append(label)
            else:
                pages += bool(write_page([shown], Path(place) / "page.html"))
        for what, value in found.items():
            worst[what] = max(worst.get(what, (0.0, "")), (value, label))
    for what, (value, label) in worst.items():
        yield row(f"difference/{what}", value, UNITS.get(what, "rad or m"), exports=len(chosen), worst_of=label)
    yield row("exports", len(chosen), "", pages=pages)
    for sentence, labels in refused.items():
        yield row("refused", len(labels), "", sentence=sentence, first=labels[0])


def combinations() -> Iterator[Names]:
    """Names of entries that fit together, so few that every pair of them that fits is in one."""
    fitting = [names for names in map(_named, itertools.product(*TABLES.values())) if _fits(names)]
    open_pairs = {pair for names in fitting for pair in _pairs(names)}
    while open_pairs:
        best = max(fitting, key=lambda names: len(open_pairs & _pairs(names)))
        open_pairs -= _pairs(best)
        yield best


def _named(values: tuple[str, ...]) -> Names:
    return dict(zip(TABLES, values, strict=True))


def _pairs(names: Names) -> set[Pair]:
    return set(itertools.combinations(names.items(), 2))


def _fits(names: Names) -> bool:
    try:
        check(configure(**names))
    except InputError:
        return False
    return True


def _in_javascript(run: RunDirectory) -> dict[str, float]:
    """Largest difference of the printed JavaScript's commands, where Node.js and no picture is there."""
    env = Env(in_evaluation(run.read_config(), run.read_config().sim), SITUATIONS)
    node = shutil.which("node")
    if node is None or env.pictured:
        env.close()
        return {}
    policy: Policy = load_policy(run, env)
    functions = as_measured(env.functions)
    program = behaviour(env, policy, named_weights(policy, env.action_bounds)).decide
    state = env.compile_whole(env.init)(episode_keys(0, REPORT_STREAM, 0, SITUATIONS))
    decide = jax.jit(lambda state: functions.command(state, policy.act(functions.observe(state)), None)[1])
    rows = list(rows_of(state, None, [one.name for one in program.inputs]))
    constants = {name: array.ravel().tolist() for name, array in constants_of([program]).items()}
    source = (
        f"{JAVASCRIPT_HEAD}\nconst CONSTANTS = {json.dumps(constants)};\n{javascript_function(program)}\n"
        f"console.log(JSON.stringify({json.dumps(rows)}.map((row) => {program.name}(row).wanted)));\n"
    )
    done = subprocess.run([node], input=source, capture_output=True, text=True, check=True)  # noqa: S603
    difference = np.abs(np.array(json.loads(done.stdout)) - np.asarray(decide(state))).max()
    env.close()
    return {JAVASCRIPT: float(difference)}
