"""Evaluation on held-out targets: every episode counted once, the result with intervals."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.agents.policy import Policy
from reachlab.envs.core import Env, EnvState, Transition
from reachlab.envs.streams import AGENT_STREAM, REPORT_STREAM, episode_keys
from reachlab.jax_setup import jit
from reachlab.robots.kinematics import forward_kinematics
from reachlab.runs.versions import versions
from reachlab.settings import names
from reachlab.settings.validation import InputError, choose
from reachlab.tasks import reach as task

QUANTILES = {"median": 0.5, "p95": 0.95, "p99": 0.99, "max": 1.0}
"""Quantiles of the final error in a report."""

NORMAL_95 = 1.959963984540054
"""97.5 % quantile of the standard normal distribution."""

WITHIN = (100, 50, 20, 10, 5, 2, 1)
"""Errors of which `success_within` speaks [mm]."""

FRESH_SEED = 5000
"""Tables take their held-out targets from this seed on. No setting was chosen on them: choose on the seeds below."""

Watch = Callable[[int], None]
"""Called with the number of episodes that have ended."""


def ignore(ended: int) -> None:
    """Nothing, of whatever number of episodes has ended."""


LANES = 1000
"""Episodes evaluated together where the simulator is pure; one size, so one compiled program."""

Agent = Callable[[Env, Policy | None, EnvState, Array, Array | None], Array]
"""Gives actions `[B, a]` for a state; the key is for agents that draw them, the picture for those that see."""


def _trained(env: Env, policy: Policy | None, state: EnvState, key: Array, picture: Array | None) -> Array:
    """The trained policy, without noise."""
    del key
    if policy is None:
        raise InputError("agent 'trained' needs a run: name its directory.")
    return policy.act(env.observe(state, picture))


def _random(env: Env, policy: Policy | None, state: EnvState, key: Array, picture: Array | None) -> Array:
    """Actions drawn uniformly from their box."""
    del policy, picture
    low, high = env.action_bounds
    return jax.random.uniform(key, state.last_action.shape, minval=low, maxval=high)


def _zero(env: Env, policy: Policy | None, state: EnvState, key: Array, picture: Array | None) -> Array:
    """Actions of zero."""
    del env, policy, key, picture
    return jnp.zeros_like(state.last_action)


def _ik(env: Env, policy: Policy | None, state: EnvState, key: Array, picture: Array | None) -> Array:
    """Inverse kinematics in a closed loop: to the target from where the tool is measured, at every step."""
    del policy, key, picture
    now = env.situation(state)
    return task.ACTIONS[env.reach.config.action].towards(env.reach, now, now)


def _ik_open(env: Env, policy: Policy | None, state: EnvState, key: Array, picture: Array | None) -> Array:
    """Inverse kinematics solved once: to the target from where the tool was commanded, whatever is measured."""
    del policy, key, picture
    now = env.situation(state)
    commanded = forward_kinematics(env.reach.robot.chain, now.target_q).position
    blind = now._replace(q=now.target_q, qd=jnp.zeros_like(now.qd), tool_position=commanded)
    return task.ACTIONS[env.reach.config.action].towards(env.reach, now, blind)


AGENTS: dict[str, Agent] = dict(zip(names.AGENTS, (_trained, _random, _zero, _ik, _ik_open), strict=True))
"""Agents by name: the trained policy, and what it has to beat."""


def compile_agent(env: Env, agent: str) -> Callable[..., Array]:
    """Function that gives an agent's actions for policy, state, key and the lanes to look at; all of them with None.

    Pictures are drawn for the one agent that looks at them.
    """
    act = AGENTS[choose("agent", agent, AGENTS)]
    decide = env.traced(lambda policy, state, key, picture: act(env, policy, state, key, picture))
    if not env.pictured:
        return lambda policy, state, key, _: decide(policy, state, key, None)
    looks = act is _trained

    def decide_seeing(policy: Policy | None, state: EnvState, key: Array, lanes: Array | None) -> Array:
        seen = None if lanes is None else np.asarray(lanes)
        return decide(policy, state, key, env.see(state, seen) if looks else None)

    return decide_seeing


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Episodes:
    """What became of `B` episodes.

    Attributes:
        target: point to reach `[B, 3]` [m].
        done: the episode has ended `[B]`; nothing of it changes any more.
        success: it ended in success `[B]`.
        distance: error at its end `[B]` [m]: from tool to target, held where the task says so.
        steps: its length `[B]`.
        arrival: step from which on the tool stays within the distance of success `[B]`.
        returns: sum of its rewards `[B]`.
        max_speed: largest joint speeds in it `[B, n]` [rad/s].
        squared_jerk: sum over its steps of the squared jerk, mean of the joints `[B]` [rad²/s⁶].
        motion: joint positions, displacement and its change at the last step, three `[B, n]`.
    """

    target: Array
    done: Array
    success: Array
    distance: Array
    steps: Array
    arrival: Array
    returns: Array
    max_speed: Array
    squared_jerk: Array
    motion: tuple[Array, Array, Array]


@dataclass(frozen=True)
class Report:
    """Result of an evaluation.

    Attributes:
        task, robot, sim, agent, seed, episodes: what was evaluated, on which seed's held-out targets.
        checkpoint: of the trained policy, `steps` and `sha256` of its file; None for the others, or without a file.
        perturb: whether every episode had a perturbed arm of its own, see `SimConfig.perturb`.
        perturb_view: whether every episode was seen in a view of its own, see `SimConfig.randomise_view`.
        success_rate: share of episodes that ended in success.
        success_interval: its 95 % Wilson interval.
        success_within: share within so many millimetres at the end; None where success ends the episode.
        final_error_mm: distance from tool to target at the end: median, p95, p99, max; where the task says so the held
            one, None if infinite.
        return_mean: mean sum of rewards.
        steps_mean: mean length, to success or the end.
        time_to_reach_s: mean time of the successes until the tool is there for good [s]; None without any.
        max_joint_speed: largest speed of each joint [rad/s].
        jerk: mean squared joint jerk [rad²/s⁶].
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
    perturb: bool
    perturb_view: bool
    success_rate: float
    success_interval: tuple[float, float]
    success_within: dict[str, float] | None
    final_error_mm: dict[str, float | None]
    return_mean: float
    steps_mean: float
    time_to_reach_s: float | None
    max_joint_speed: list[float]
    jerk: float
    wall_s: float
    versions: dict[str, str]

    def to_json(self) -> dict[str, Any]:
        """Plain form, for `json.dump`."""
        return asdict(self)


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """95 % interval of a rate (Wilson, "Probable inference", J. Am. Stat. Assoc. 22, 1927).

    That of `scipy.stats.binomtest`, whose import takes half a second: a tenth of a whole training.
    """
    z, rate = NORMAL_95, successes / trials
    centre = rate + z**2 / (2 * trials)
    half = z * math.sqrt(rate * (1 - rate) / trials + z**2 / (4 * trials**2))
    scale = 1 + z**2 / trials
    # Exact where rounding would leave the ends a hair away from 0 and 1.
    low, high = (0.0 if successes == 0 else (centre - half) / scale), (centre + half) / scale
    return low, 1.0 if successes == trials else high


@dataclass(frozen=True)
class Runner:
    """`run(policy, keys)` runs one episode for each of `lanes` keys to its end.

    On the host it takes a `Watch` too, and calls it after every step.
    """

    run: Callable[..., Episodes]
    num_envs: int
    on_host: bool = False


def make_runner(env: Env, agent: str) -> Runner:
    """Runner for an agent of `AGENTS`."""
    period, within = env.config.physics.control_period, env.config.rules.success_distance

    def begin(keys: Array) -> tuple[EnvState, Episodes, Array]:
        state = env.init(keys)
        lanes, still = len(keys), jnp.zeros_like(state.arm.q)
        episodes = Episodes(
            target=state.target,
            done=jnp.zeros(lanes, bool),
            success=jnp.zeros(lanes, bool),
            distance=state.distance,
            steps=jnp.zeros(lanes, jnp.int32),
            arrival=(state.distance >= within).astype(jnp.int32),
            returns=jnp.zeros(lanes),
            max_speed=still,
            squared_jerk=jnp.zeros(lanes),
            motion=(state.arm.q, still, still),
        )
        return state, episodes, jax.random.fold_in(keys[0], AGENT_STREAM)

    decide = compile_agent(env, agent)
    count = env.traced(partial(_count, period=period, within=within))

    def advance(policy: Policy | None, carry: tuple[EnvState, Episodes, Array]) -> tuple[EnvState, Episodes, Array]:
        state, episodes, key = carry
        key, now = jax.random.split(key)
        state, transition = env.step(state, decide(policy, state, now, ~episodes.done))
        return state, count(episodes, state, transition), key

    if env.pure:

        def run(policy: Policy | None, keys: Array) -> Episodes:
            carry = begin(keys)
            return jax.lax.while_loop(lambda c: ~c[1].done.all(), lambda c: advance(policy, c), carry)[1]

        return Runner(jit(run), LANES)

    def run_on_host(policy: Policy | None, keys: Array, watch: Watch = ignore) -> Episodes:
        carry = begin(keys)
        while (ended := int(np.asarray(carry[1].done).sum())) < len(keys):
            watch(ended)
            carry = advance(policy, carry)
        return carry[1]

    return Runner(run_on_host, env.num_envs, on_host=True)


def _count(episodes: Episodes, state: EnvState, transition: Transition, period: float, within: float) -> Episodes:
    q, moved, change = episodes.motion
    moved_now = state.arm.q - q
    change_now = moved_now - moved
    jerk = jnp.square((change_now - change) / period**3).mean(-1)
    new = Episodes(
        target=episodes.target,
        done=transition.done,
        success=transition.terms["success"],
        distance=transition.terms["error"],
        steps=episodes.steps + 1,
        arrival=jnp.where(transition.terms["distance"] < within, episodes.arrival, episodes.steps + 2),
        returns=episodes.returns + transition.reward,
        max_speed=jnp.maximum(episodes.max_speed, jnp.abs(state.arm.qd)),
        squared_jerk=episodes.squared_jerk + jerk,
        motion=(state.arm.q, moved_now, change_now),
    )

    def keep(old: Array, now: Array) -> Array:
        ended = episodes.done.reshape(episodes.done.shape + (1,) * (old.ndim - 1))
        return jnp.where(ended, old, now)

    return jax.tree.map(keep, episodes, new)


def run_episodes(
    runner: Runner,
    policy: Policy | None,
    seed: int,
    stream: int,
    episodes: int,
    first: int = 0,
    watch: Watch = ignore,
) -> Episodes:
    """Exactly `episodes` episodes of a seed's stream from number `first` on, as NumPy arrays."""
    parts = []
    for done in range(0, episodes, runner.num_envs):

        def watch_all(ended: int, before: int = done) -> None:
            watch(min(before + ended, episodes))

        keys = episode_keys(seed, stream, first + done, runner.num_envs)
        part = runner.run(policy, keys, watch_all) if runner.on_host else runner.run(policy, keys)
        watch_all(runner.num_envs)
        # BatchArray beyond the last episode ran too; they do not count.
        parts.append(jax.tree.map(lambda x, left=episodes - done: np.asarray(x)[:left], part))
    return jax.tree.map(lambda *x: np.concatenate(x), *parts)


def evaluate(
    env: Env,
    agent: str,
    policy: Policy | None = None,
    *,
    seed: int,
    episodes: int,
    runner: Runner | None = None,
    checkpoint: dict[str, Any] | None = None,
) -> Report:
    """Report of an agent on held-out targets; see `examine`."""
    return examine(env, agent, policy, seed=seed, episodes=episodes, runner=runner, checkpoint=checkpoint)[0]


def examine(
    env: Env,
    agent: str,
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
        agent: name in `AGENTS`.
        policy: the trained policy, for agent `trained`.
        seed: seed of the targets; equal for all agents and simulators.
        episodes: how many.
        runner: of `make_runner`, if there is one already compiled.
        watch: called with the number of episodes that have ended, now and then.
        checkpoint: what names the policy in the report, see `Manifest.identity`.

    Raises:
        InputError: no episodes, no such agent, or agent `trained` without a policy.
    """
    if episodes < 1:
        raise InputError(f"episodes must be at least 1, got {episodes}.")
    start = time.perf_counter()
    result = run_episodes(runner or make_runner(env, agent), policy, seed, REPORT_STREAM, episodes, watch=watch)
    return summarise(env, agent, result, seed, time.perf_counter() - start, checkpoint), result


def summarise(
    env: Env, agent: str, result: Episodes, seed: int, wall_s: float, checkpoint: dict[str, Any] | None = None
) -> Report:
    """Report of finished episodes."""
    count, successes = len(result.done), int(result.success.sum())
    error = np.asarray(result.distance, np.float64) * 1000
    period = env.config.physics.control_period
    reached = result.arrival[np.asarray(result.success)]
    return Report(
        task=env.config.task,
        robot=env.reach.robot.name,
        sim=env.config.sim,
        agent=agent,
        seed=seed,
        episodes=count,
        checkpoint=checkpoint if AGENTS[agent] is _trained else None,
        perturb=env.config.physics.perturb,
        perturb_view=env.config.physics.randomise_view,
        success_rate=successes / count,
        success_interval=wilson_interval(successes, count),
        success_within=_shares_within(error) if env.config.rules.at_goal != "end" else None,
        final_error_mm={
            name: _finite(np.quantile(error, share, method="inverted_cdf")) for name, share in QUANTILES.items()
        },
        return_mean=float(result.returns.mean()),
        steps_mean=float(result.steps.mean()),
        time_to_reach_s=float(reached.mean() * period) if successes else None,
        max_joint_speed=[float(speed) for speed in result.max_speed.max(axis=0)],
        jerk=float((result.squared_jerk / result.steps).mean()),
        wall_s=wall_s,
        versions=versions(),
    )


def _shares_within(error: np.ndarray) -> dict[str, float]:
    return {str(limit): float((error <= limit).mean()) for limit in WITHIN}


def _finite(value: np.floating[Any]) -> float | None:
    """The number, None for infinity, which JSON has no word for."""
    return float(value) if np.isfinite(value) else None
