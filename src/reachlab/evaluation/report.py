"""The report of an evaluation on held-out goals: rates with intervals, errors, times and loads."""

from __future__ import annotations

import logging
import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from reachlab.agents import AGENTS
from reachlab.agents.acting import Function, name_of
from reachlab.agents.policy import Policy
from reachlab.envs.core import Env
from reachlab.envs.presets import preset_of
from reachlab.envs.random_streams import REPORT_STREAM
from reachlab.evaluation.episodes import Episodes, Runner, Watch, ignore, make_runner, run_episodes
from reachlab.evaluation.intervals import quantiles, wilson_interval
from reachlab.evaluation.tracking import followed
from reachlab.runs.provenance import versions
from reachlab.settings.arguments import typed
from reachlab.settings.validation import LAST_SEED, whole_number

QUANTILES = {"median": 0.5, "p95": 0.95, "p99": 0.99, "max": 1.0}
"""Quantiles of the final error in a report."""

WITHIN = (100, 50, 20, 10, 5, 2, 1)
"""Errors of which `success_within` speaks [mm]."""

WITHIN_PAIRS = ((50, 0.2), (10, 0.05), (2, 0.02))
"""Errors of which `success_within_pairs` speaks [mm, rad]; the first are Isaac Lab's for its pose tasks."""

MOST_EPISODES = 2**31 - 1
"""Episodes of an evaluation."""

FRESH_SEED = 5000
"""Tables take their held-out goals from this seed on. No setting was chosen on them: choose on the seeds below."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Report:
    """Result of an evaluation.

    Attributes:
        task, robot, sim, agent, seed, episodes: what was evaluated, on which seed's held-out targets.
        checkpoint: of the trained policy, `steps` and `sha256` of its file; None for the others, or without a file.
        randomised: what varied from episode to episode, see `RunConfig.randomise`.
        success_rate: share of episodes that ended in success.
        success_interval: its 95 % Wilson interval.
        ends: shares of the episodes that ended in `success`, `outside` the workspace, by `contact`, and by `time`.
        success_within: share within so many millimetres at the end; None where success ends the episode.
        success_within_pairs: of goals with an orientation, share within both of so many millimetres and radians, each
            pair named "10 mm, 0.05 rad"; None for others, or where success ends the episode.
        final_error_mm: the error that counts at the end, see `Task.counted`: median, p95, p99, max; None if it is
            infinite.
        final_angle_rad: the same of the orientation; None where any will do.
        tracking: how well a goal that moves was followed, see `tracking.followed`; None of one that stays.
        control_period: time of a step [s].
        return_mean: mean sum of rewards.
        steps_mean: mean length, to success or the end.
        time_to_reach_s: mean time of the successes until the tool is there for good [s]; None without any.
        max_joint_speed: largest speed of each joint [rad/s].
        jerk: mean squared joint jerk [rad²/s⁶].
        contact: share of episodes in which the arm touched anything, itself included, where the engine judges it; their
            errors count as infinite.
        self_contact: share of episodes in which links of the arm met at any step, by their exact shapes, see
            `Episodes.touched`.
        straight: share of episodes in which nothing was in the way of the arm, had its joints moved straight to the
            goal's; None where nothing is beside it.
        planning_s: time of planning an episode [s], where something was planned: median, p95, p99, max; None of agents
            that do not plan. It is part of `time_to_reach_s`.
        largest_force_n: largest force at the wrist in an episode, the weight of what it holds included: median, p95,
            p99, max [N]; None where it is not measured.
        object: shares of episodes in which the object was `untouched`, moved by less than 1 cm, or `dropped`, let go in
            the air; None where there is none.
        wall_s: time that the evaluation took [s].
        versions: of the packages that it depends on.
    """

    task: str
    robot: str
    sim: str
    agent: str
    seed: int
    episodes: int
    checkpoint: dict[str, Any] | None
    randomised: list[str]
    success_rate: float
    success_interval: tuple[float, float]
    ends: dict[str, float]
    success_within: dict[str, float] | None
    success_within_pairs: dict[str, float] | None
    final_error_mm: dict[str, float | None]
    final_angle_rad: dict[str, float | None] | None
    tracking: dict[str, Any] | None
    control_period: float
    return_mean: float
    steps_mean: float
    time_to_reach_s: float | None
    max_joint_speed: list[float]
    jerk: float
    contact: float | None
    self_contact: float | None
    straight: float | None
    planning_s: dict[str, float | None] | None
    largest_force_n: dict[str, float | None] | None
    object: dict[str, float] | None
    wall_s: float
    versions: dict[str, str]

    def to_json(self) -> dict[str, Any]:
        """Plain form, for `json.dump`."""
        return asdict(self)


@typed
def evaluate(
    env: Env,
    agent: str | Function,
    policy: Policy | None = None,
    *,
    seed: int = 1,
    episodes: int = 1000,
    runner: Runner | None = None,
    checkpoint: dict[str, Any] | None = None,
) -> Report:
    """Report of an agent on held-out targets; see `examine`.

    A policy of any other library is evaluated as a function: `evaluate(env, lambda observation: actions)`.

    What the environment's settings vary does vary: a preset names what varies in training, and `reachlab eval` is
    without it, as is `configure(task, randomise=())`. A warning says so.

    Args:
        env: the environment.
        agent: name in `AGENTS`, or a function that gives actions `[B, a]` for observations with the batch in front.
        policy: the trained policy, for agent `trained`.
        seed: seed of the targets; equal for all agents and simulators.
        episodes: how many.
        runner: of `make_runner`, if there is one already compiled.
        checkpoint: what names the policy in the report.

    Raises:
        InputError: see `examine`, or what is given is no environment of reachlab, or no agent.
    """
    if runner is None and (varied := env.config.randomise) and varied == preset_of(env.config).randomise:
        log.warning(
            "reachlab: %s vary in this evaluation, as in the preset's training; `reachlab eval` is without, as is"
            " configure(%r, randomise=()).",
            " and ".join(varied),
            env.config.task,
        )
    return examine(env, agent, policy, seed=seed, episodes=episodes, runner=runner, checkpoint=checkpoint)[0]


def examine(
    env: Env,
    agent: str | Function,
    policy: Policy | None = None,
    *,
    seed: int,
    episodes: int,
    runner: Runner | None = None,
    watch: Watch = ignore,
    checkpoint: dict[str, Any] | None = None,
) -> tuple[Report, Episodes]:
    """Report of an agent on held-out targets, and the episodes that it sums up.

    Args:
        env: the environment.
        agent: name in `AGENTS`, or a function that gives actions `[B, a]` for observations with the batch in front.
        policy: the trained policy, for agent `trained`.
        seed: seed of the targets; equal for all agents and simulators.
        episodes: how many.
        runner: of `make_runner`, if there is one already compiled.
        watch: called with the number of episodes that have ended, now and then.
        checkpoint: what names the policy in the report, see `Manifest.identity`.

    Raises:
        InputError: a seed or a number of episodes that cannot be, no such agent, agent `trained` without a policy or
            with one of another arm, or a function's actions are misshapen or not finite.
    """
    seed, episodes = whole_number("seed", seed, 0, LAST_SEED), whole_number("episodes", episodes, 1, MOST_EPISODES)
    start = time.perf_counter()
    runner = runner or make_runner(env, agent, episodes)
    result = run_episodes(runner, policy, seed, REPORT_STREAM, episodes, watch=watch)
    return summarise(env, agent, result, seed, time.perf_counter() - start, checkpoint), result


def summarise(
    env: Env, agent: str | Function, result: Episodes, seed: int, wall_s: float, checkpoint: Any = None
) -> Report:
    """Report of finished episodes."""
    rules, judged = env.setup.rules, env.setup.task.scene(env.setup).contacts
    count, successes = len(result.done), int(result.success.sum())
    error = np.asarray(result.distance, np.float64) * 1000
    angle, turned = np.asarray(result.angle, np.float64), rules.asks_orientation
    contact = np.any(np.asarray(result.contact, bool).reshape(count, -1), axis=1)  # never where it is not judged
    error = np.where(contact, np.inf, error)
    period, ends, pairs = env.config.physics.control_period, rules.ends_at_goal, None
    if turned and not ends:
        pairs = {f"{mm} mm, {rad} rad": float(((error <= mm) & (angle <= rad)).mean()) for mm, rad in WITHIN_PAIRS}
    success = np.asarray(result.success)
    reached, planned = result.arrival[success], np.zeros(count) if result.planned is None else result.planned
    return Report(
        task=env.config.task,
        robot=env.setup.robot.name,
        sim=env.config.sim,
        agent=name_of(agent),
        seed=seed,
        episodes=count,
        checkpoint=checkpoint if not isinstance(agent, str) or AGENTS[agent].trained else None,
        randomised=list(env.config.randomise),
        success_rate=successes / count,
        success_interval=wilson_interval(successes, count),
        ends=_ends(result, contact),
        success_within=None if ends else {str(limit): float((error <= limit).mean()) for limit in WITHIN},
        success_within_pairs=pairs,
        final_error_mm=quantiles(error, QUANTILES),
        final_angle_rad=quantiles(angle, QUANTILES) if turned else None,
        tracking=result.track and followed(result.track, env.setup.period, rules.settle_steps, rules.goal_speed[1]),
        control_period=period,
        return_mean=float(result.returns.mean()),
        steps_mean=float(result.steps.mean()),
        time_to_reach_s=float((reached * period + planned[success]).mean()) if successes else None,
        max_joint_speed=[float(speed) for speed in result.max_speed.max(axis=0)],
        jerk=float((result.squared_jerk / result.steps).mean()),
        contact=float(np.mean(contact)) if judged else None,
        self_contact=None if result.touched is None else float(result.touched.mean()),
        straight=None if result.straight is None else float(result.straight.mean()),
        planning_s=quantiles(planned[planned > 0], QUANTILES) if planned.any() else None,
        largest_force_n=None if result.force is None else quantiles(np.asarray(result.force, np.float64), QUANTILES),
        object=result.handled and result.handled.shares(),
        wall_s=wall_s,
        versions=versions(),
    )


def _ends(result: Episodes, contact: np.ndarray) -> dict[str, float]:
    """Shares of the episodes that ended in each way; contact outside the workspace is contact."""
    success, early = np.asarray(result.success, bool), np.asarray(result.terminated, bool)
    failed = {"contact": contact & ~success, "outside": early & ~contact & ~success}
    shares = {"success": success, **failed, "time": ~(success | failed["contact"] | failed["outside"])}
    return {name: float(shares[name].mean()) for name in ("success", "outside", "contact", "time")}
