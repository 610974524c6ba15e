"""The environment: a simulator, the task and a clock, on a batch of lanes."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.envs.streams import CHAIN_STREAM, PARTS, VIEW_STREAM, noise_keys
from reachlab.jax_setup import dispatch_inline, first_process, jit
from reachlab.render.marks import NO_PATH, Marks
from reachlab.render.view_randomisation import CHANCES, develop, make_views
from reachlab.robots.kinematics import forward_kinematics
from reachlab.robots.loading import load_robot
from reachlab.settings.config import RunConfig
from reachlab.sims import SIMULATORS, ArmState, BatchArray, make_simulator
from reachlab.tasks import reach as task
from reachlab.tasks.reach import SIZE, Observed, Reach, Situation, make_reach

POSITION_NOISE, SPEED_NOISE = 0.0005, 0.01
"""Standard deviations of the joint measurements where arms are perturbed [rad, rad/s]."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EnvState:
    """A batch of episodes under way.

    Attributes:
        arm: the simulator's state.
        target: point to reach `[B, 3]` [m].
        target_q: last joint command `[B, n]` [rad or m]; commands accumulate on it.
        last_action: `[B, a]`, zero at the start.
        distance: tool to target `[B]` [m].
        recent: errors of the last steps `[B, hold_steps]` [m], see `task.remember`; None if touching is enough.
        clock: steps since the reset `[B]`.
        key: random key of each lane `[B]`.
    """

    arm: ArmState
    target: Array
    target_q: Array
    last_action: Array
    distance: Array
    recent: Array | None
    clock: Array
    key: Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Transition:
    """What a step gave, before any reset.

    Attributes:
        observation: `[B, k]`, the final one where the episode ended; None where it holds a picture, see `Env.look`.
        reward: `[B]`.
        terminated: the task ended the episode `[B]`.
        truncated: the clock did `[B]`.
        done: the episode ended, either way `[B]`.
        terms: `distance` [m], the `error` that counts at the end [m], `success` and each term of the reward, `[B]`.
    """

    observation: Observed
    reward: Array
    terminated: Array
    truncated: Array
    done: Array
    terms: dict[str, Array]


Held = tuple[EnvState, Transition]
"""What a step leads to."""

Tree = TypeVar("Tree")


def merge(mask: np.ndarray, new: Observed, old: Observed) -> Observed:
    """Observations with those of `new` in the lanes of `mask [B]`."""
    return jax.tree.map(lambda a, b: np.where(mask.reshape(-1, *[1] * (np.ndim(a) - 1)), a, b), new, old)


class Env:
    """A batch of reach environments as functions of an `EnvState`.

    `step` never resets; `reset` does, lane by lane, with a new target. Where the simulator is pure both can
    be traced by JAX.
    """

    def __init__(self, config: RunConfig, num_envs: int) -> None:
        """Environment of `num_envs` lanes.

        Raises:
            InputError: a name in the configuration that does not exist.
        """
        dispatch_inline()
        first_process()  # JAX starts in this one
        self.config = config
        self.num_envs = num_envs
        robot = load_robot(config.robot, config.rules.tool)
        self.simulator = make_simulator(config.sim, robot, config.physics, num_envs)
        self.reach: Reach = make_reach(config.rules, robot, config.physics.control_period, self.simulator.lag)
        self._real_time = SIMULATORS[config.sim].real_time
        design = task.OBSERVATIONS[config.rules.observation]
        self.observation_bounds = design.bounds(self.reach)
        self.action_bounds = task.ACTIONS[config.rules.action].bounds(self.reach)
        self.pictured = design.pictured
        self.pure = self.simulator.pure and not self.pictured
        self._look, self._chances = jit(self.observe), jit(self._chances)
        if not self.simulator.pure:  # it steps on the host, between compiled parts
            self._draw, self._command, self._judge, self._begin, self._merge, self._go_on = map(
                jit, (self._draw, self._command, self._judge, self._begin, self._merge, self._go_on)
            )
            self._chain = jit(self._chain)
        elif self.pictured:  # pictures alone are drawn on the host
            self._init, self._reset, steps = jit(self._init), jit(self._reset), self._steps
            self._steps = functools.cache(lambda times: jit(steps(times)))

    def init(self, keys: Array) -> EnvState:
        """State in which every lane begins an episode; `keys [B]`, see `streams`."""
        return self._init(keys)

    def reset(self, state: EnvState, mask: Array | np.ndarray, chained: float | None = None) -> EnvState:
        """State in which the lanes of `mask [B]` begin a new episode, a share `chained` of them where they are."""
        return self._reset(state, mask, chained)

    def step(
        self, state: EnvState, action: BatchArray, times: int = 1, instead: Array | None = None
    ) -> tuple[EnvState, Transition]:
        """State and transition after `action [B, a]`, taken so many `times`.

        A lane whose episode ends on the way stays where it ended, to be reset; rewards are added up. Where `instead
        [B, n]` is a number it is the joint command; without it the command stays where `task.rests` says so.
        """
        return self._steps(times)(state, action, instead)

    def _init(self, keys: Array) -> EnvState:
        key, q, target, chance = self._draw(keys)
        return self._begin(self.simulator.reset(None, q, target, None, chance), target, key)

    def _reset(self, state: EnvState, mask: Array | np.ndarray, chained: float | None) -> EnvState:
        key, q, target, chance = self._draw(state.key)
        q = q if chained is None else self._chain(state, q, chained)
        arm = self.simulator.reset(state.arm, q, target, mask, chance)
        return self._merge(jnp.asarray(mask), replace(self._begin(arm, target, key), arm=arm), replace(state, arm=arm))

    def _chain(self, state: EnvState, start: Array, share: float) -> Array:
        """Starts `[B, n]`: where the last episodes ended in a share of the lanes whose tool is inside the workspace."""
        chance = jax.vmap(lambda key: jax.random.uniform(jax.random.fold_in(key, CHAIN_STREAM)))(state.key)
        stays = (chance < share) & ~task.is_outside(self.reach, state.arm.tool_position)
        return jnp.where(stays[:, None], state.arm.q, start)

    def _steps(self, times: int) -> Callable[[EnvState, BatchArray, Array | None], Held]:
        def steps(state: EnvState, action: BatchArray, instead: Array | None) -> Held:
            def again(_: Any, held: Held) -> Held:
                return self._go_on(held, self._step(held[0], action, instead))

            held = self._step(state, action, instead)
            if self.simulator.pure and times > 1:
                return jax.lax.fori_loop(1, times, again, held)
            for i in range(1, times):
                held = again(i, held)
            return held

        return steps

    def _step(self, state: EnvState, action: BatchArray, instead: Array | None) -> Held:
        action = task.bounded(self.reach, jnp.asarray(action))
        target_q = self._command(replace(state, arm=replace(state.arm, engine=None)), action)
        if instead is not None:
            target_q = jnp.where(jnp.isnan(instead), target_q, instead)
        elif (rests := task.rests(self.reach, state.distance)) is not None:
            target_q = jnp.where(rests[:, None], state.target_q, target_q)
        arm = self.simulator.step(state.arm, target_q)
        last = (state.distance, state.recent, state.clock)
        (distance, recent, clock), transition = self._judge(self._true(state, arm, target_q, action), last, state.key)
        state = replace(
            state,
            arm=arm,
            target_q=target_q,
            last_action=action,
            distance=distance,
            recent=recent,
            clock=clock,
        )
        return state, transition

    def observe(self, state: EnvState, picture: BatchArray | None = None) -> Observed:
        """Observation `[B, k]` of a state; one that holds a picture takes it from `see`."""
        return task.observe(self.reach, self.situation(state)._replace(picture=cast("Array | None", picture)))

    def look(self, state: EnvState, lanes: np.ndarray | None = None) -> Observed:
        """Observation of a state, outside any trace; its pictures are those of the lanes of `lanes [B]` alone."""
        return self._look(state, self.see(state, lanes))

    def see(self, state: EnvState, lanes: np.ndarray | None = None) -> np.ndarray | None:
        """Pictures `[B, SIZE, SIZE]` uint8 of the lanes of `lanes [B]`, black for the others.

        None where the observation holds no picture.
        """
        if not self.pictured:
            return None
        if lanes is None:
            return self.draw(state.arm.q, state.target, state.key)
        q, target, chances = (np.asarray(x) for x in (state.arm.q, state.target, self._chances(state.key)))
        chosen, pictures = np.flatnonzero(lanes), np.zeros((len(q), SIZE, SIZE), np.uint8)
        pictures[chosen] = self._drawn(q[chosen], target[chosen], chances[chosen], chosen)
        return pictures

    def open_eyes(self) -> None:
        """Draw a picture, if the observation holds one, to find out whether that can be done.

        Raises:
            InputError: it cannot.
        """
        if self.pictured:
            home = np.array([self.reach.robot.home])
            self._drawn(home, np.zeros((1, 3)), np.zeros((1, CHANCES)), np.zeros(1, int))

    def draw(self, q: Array, target: Array, keys: Array) -> np.ndarray:
        """Pictures `[m, SIZE, SIZE]` uint8 of joints `[m, n]`, targets `[m, 3]` and episodes with `keys [m]`."""
        return self._drawn(*(np.asarray(x) for x in (q, target, self._chances(keys), np.arange(len(q)))))

    def _drawn(self, q: np.ndarray, target: np.ndarray, chances: np.ndarray, lanes: np.ndarray) -> np.ndarray:
        views = make_views(chances)
        return develop(self.simulator.see(q, target, views, lanes), views)

    def _chances(self, keys: Array) -> Array:
        """Chances `[B, CHANCES]` of the views of episodes; see `make_views`."""
        if not self.config.physics.randomise_view:
            return jnp.zeros((len(keys), CHANCES))
        return jax.vmap(lambda key: jax.random.uniform(jax.random.fold_in(key, VIEW_STREAM), (CHANCES,), minval=-1.0))(
            keys
        )

    def situation(self, state: EnvState) -> Situation:
        """What observations and baselines may look at: as measured, with noise where the physics has it."""
        now = self._true(state, state.arm, state.target_q, state.last_action)
        return self._measured(now, state.key, state.clock)

    @staticmethod
    def _true(state: EnvState, arm: ArmState, target_q: Array, action: BatchArray) -> Situation:
        return Situation(arm.q, arm.qd, arm.tool_position, state.target, target_q, cast("Array", action))

    def _measured(self, now: Situation, keys: Array, clock: Array) -> Situation:
        if not self.config.physics.perturb:
            return now
        noise = jax.vmap(lambda key: jax.random.normal(key, (2, now.q.shape[-1])))(noise_keys(keys, clock))
        q, qd = now.q + POSITION_NOISE * noise[:, 0], now.qd + SPEED_NOISE * noise[:, 1]
        return now._replace(q=q, qd=qd, tool_position=forward_kinematics(self.reach.robot.chain, q).position)

    def traced(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """A function beside the simulator: itself where a caller traces everything, compiled where none can."""
        return function if self.pure else jit(function)

    def compile(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """A function that uses this environment, compiled as a whole if the simulator can be traced."""
        return jit(function) if self.pure else function

    def render(self, state: EnvState, lane: int = 0, path: np.ndarray = NO_PATH) -> np.ndarray:
        """Picture of a lane, `[height, width, 3]` uint8, with the tool's path through points `[k, 3]` [m]."""
        marks = Marks(self.config.rules.success_distance, self.reached(state, lane), path)
        return self.simulator.render(state.arm, state.target, lane, marks)

    def reached(self, state: EnvState, lane: int = 0) -> bool:
        """Whether a lane's target is reached now: the tool is near enough and, where the task asks for it, was held."""
        errors = state.distance if state.recent is None else state.recent
        return bool((np.asarray(errors)[lane] < self.config.rules.success_distance).all())

    def close(self) -> None:
        """Close the simulator."""
        self.simulator.close()

    def _draw(self, keys: Array) -> tuple[Array, Array, Array, Array | None]:
        """Next keys, starts, targets and, where they are perturbed, the chances of the arms."""
        chances = 2 * self.reach.robot.chain.n + 1 if self.config.physics.perturb else 0

        def one(key: Array) -> tuple[Array, Array, Array, Array | None]:
            key, for_target, for_start, for_arm = jax.random.split(key, PARTS)
            start, target = task.draw_start(self.reach, for_start), task.draw_target(self.reach, for_target)
            chance = jax.random.uniform(for_arm, (chances,), minval=-1.0) if chances else None
            return key, start, target, chance

        return jax.vmap(one)(keys)

    def _begin(self, arm: ArmState, target: Array, key: Array) -> EnvState:
        lanes = target.shape[0]
        return EnvState(
            arm=arm,
            target=target,
            target_q=arm.q,
            last_action=jnp.zeros((lanes, len(self.action_bounds[0]))),
            distance=jnp.linalg.norm(arm.tool_position - target, axis=-1),
            recent=task.nothing_held(self.reach, lanes),
            clock=jnp.zeros(lanes, jnp.int32),
            key=key,
        )

    @staticmethod
    def _merge(mask: Array, new: Tree, old: Tree) -> Tree:
        def pick(a: Array, b: Array) -> Array:
            return jnp.where(mask.reshape(mask.shape + (1,) * (a.ndim - 1)), a, b)

        return jax.tree.map(lambda a, b: a if a is b else pick(a, b), new, old)

    @classmethod
    def _go_on(cls, held: Held, now: Held) -> Held:
        """State and transition of a step after those `held`, which stay where the episode has ended."""
        before, (state, transition) = held[1], now
        added = replace(transition, reward=before.reward + transition.reward)
        return cls._merge(~before.done, (state, added), held)

    def _command(self, state: EnvState, action: Array) -> Array:
        target_q = task.command(self.reach, self.situation(state), action)
        if not self._real_time:
            return target_q
        most = jnp.array(self.reach.robot.speed) * self.config.physics.control_period
        return jnp.clip(target_q, state.target_q - most, state.target_q + most)

    def _judge(
        self, now: Situation, last: tuple[Array, Array | None, Array], keys: Array
    ) -> tuple[tuple[Array, Array | None, Array], Transition]:
        """Distance, recent errors and clock, and the transition, of a step that led to a situation."""
        rules, recent, clock = self.reach.config, task.remember(self.reach, last[1], now), last[2] + 1
        outcome = task.judge(self.reach, last[0], recent, now, clock, task.held_error(last[0], last[1]))
        terms = task.REWARDS[rules.reward](rules, outcome)
        ends = outcome.success if rules.at_goal == "end" else jnp.zeros_like(outcome.success)
        terminated = outcome.outside | ends
        transition = Transition(
            observation=None if self.pictured else task.observe(self.reach, self._measured(now, keys, clock)),
            reward=sum(terms.values(), jnp.zeros_like(outcome.distance)),
            terminated=terminated,
            truncated=outcome.timeout,
            done=terminated | outcome.timeout,
            terms={"distance": outcome.distance, "error": outcome.held, "success": outcome.success, **terms},
        )
        return (outcome.distance, recent, clock), transition
