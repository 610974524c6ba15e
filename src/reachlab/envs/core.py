"""The environment: a simulator, a task and a clock, for a batch of episodes."""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, NoReturn, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.envs.functions import Begin, EnvFunctions, EnvState, Stepped, Transition
from reachlab.envs.sampling import in_parts
from reachlab.envs.setup import make_setup, settled
from reachlab.jax_setup import dispatch_inline, first_process, jit
from reachlab.render.marks import NO_PATH, TARGET_AXES, TOOL_AXES, Axes, Block, Marks
from reachlab.render.view_randomisation import SAMPLES, develop, make_views
from reachlab.robots.clearance import capsules_at
from reachlab.robots.motion_limits import MotionLimits
from reachlab.settings.config import MOST_ENVS, RunConfig
from reachlab.settings.validation import InputError, whole_number
from reachlab.sims import SIMULATORS, ArmState, BatchArray, make_simulator
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.obstacles import Obstacles
from reachlab.tasks.scenes import clearances, places
from reachlab.tasks.schema import SIZE, Observed
from reachlab.tasks.targets import solved_for
from reachlab.tasks.task import Goal, Situation, TaskSetup


def merge(mask: np.ndarray, new: Observed, old: Observed) -> Observed:
    """Observations with those of `new` in the environments of `mask [B]`."""
    return jax.tree.map(lambda a, b: np.where(mask.reshape(-1, *[1] * (np.ndim(a) - 1)), a, b), new, old)


TOUCHING = 0.005
"""Distance within which an arm that touches something touches an obstacle [m]: it has moved on since."""


class _Parts(NamedTuple):
    """The functions around the simulator's steps: traced with them, or compiled one by one."""

    sample_episode: Callable[..., Any]
    chained_start: Callable[..., Any]
    begin: Callable[..., Any]
    command: Callable[..., Any]
    judge: Callable[..., Any]
    merge: Callable[..., Any]
    continued: Callable[..., Any]


def _limits(config: RunConfig, setup: TaskSetup) -> MotionLimits | None:
    """Within which commands are shaped; None where they are not."""
    if not config.physics.shaping:
        return None
    robot, chain = setup.robot, setup.robot.chain
    return MotionLimits(chain.lower, chain.upper, robot.speed, robot.acceleration, robot.jerk, setup.period)


class Env:
    """A batch of environments as functions of an `EnvState`.

    `step` never resets; `reset` does, with a new goal. Where everything can be traced by JAX (`traced`), `init`,
    `reset` and `step` are meant to be compiled by the caller, together with what is around them; see `compile_whole`.
    Otherwise they run on the host: between the steps of a simulator that JAX cannot trace, or between pictures.

    Attributes:
        config: the settings.
        num_envs: environments in the batch.
        setup: the task on the arm.
        schema: what an observation is made of.
        action_bounds: lower and upper bounds of an action `[a]`.
        pictured: whether an observation holds a picture.
        traced: whether JAX can trace everything.
        simulator: who moves the arms.
    """

    def __init__(self, config: RunConfig, num_envs: int, threads: int = 0) -> None:
        """Environment of `num_envs` episodes at a time, which differ in what `config.randomise` names.

        A simulator outside JAX steps them on so many threads, 0 for one a core.

        Raises:
            InputError: a name in the configuration that does not exist, or a setting that does not fit the arm.
        """
        num_envs = whole_number("num_envs", num_envs, 1, MOST_ENVS)
        dispatch_inline()
        first_process()  # JAX starts in this one
        dynamics = "dynamics" in config.randomise
        setup = make_setup(config)
        self.config, self.num_envs = settled(config, setup), num_envs
        obstacles = places(setup) if setup.task.sample_obstacles is not None else 0
        self.simulator = make_simulator(
            config.sim, setup.robot, config.physics, num_envs, threads, randomise_dynamics=dynamics, obstacles=obstacles
        )
        self.setup = replace(setup, lag=self.simulator.lag)
        self.schema = OBSERVATIONS[config.rules.observation].schema(self.setup)
        self.action_bounds = ACTIONS[config.rules.action].bounds(self.setup)
        self.pictured = bool(self.schema.pictures)
        simulated = self.simulator.kind == "traced"
        self.traced = simulated and not self.pictured
        f = self._functions = EnvFunctions(
            self.setup, config.randomise, SIMULATORS[config.sim].real_time, self.pictured, _limits(config, self.setup)
        )
        parts = (f.sample_episode, f.chained_start, f.begin, f.command, f.judge, f.merge, f.continued)
        self._parts = _Parts(*(parts if simulated else map(jit, parts)))
        self._sample_some = in_parts(f.sample_episode) if solved_for(setup) and not simulated else None
        # With pictures a simulator that can be traced is compiled here: only the pictures are drawn on the host.
        whole = jit if simulated and self.pictured else lambda function: function
        self._init, self._reset = whole(self._init_all), whole(self._reset_some)
        self._steps = functools.cache(lambda times: whole(functools.partial(self._repeat, times)))
        robot = setup.robot
        self._clearances = jit(lambda q, here: clearances(robot, capsules_at(robot.chain, robot.capsules, q), here))
        self._observe, self._view_samples = jit(f.observe), jit(f.view_samples)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Copy of its own, which continues as this one."""
        twin = memo[id(self)] = object.__new__(type(self))
        vars(twin).update(copy.deepcopy(vars(self), memo))
        return twin

    def __reduce__(self) -> NoReturn:
        """Refuse to be pickled: compiled programs cannot be."""
        raise InputError("an environment cannot be pickled: make another with the same settings where it is needed.")

    # --- episodes ---------------------------------------------------------------------------------

    def init(self, keys: Array, goal: Goal | None = None) -> EnvState:
        """State in which every environment begins an episode; `keys [B]`, see `random_streams`.

        Its goal is sampled or, where one is given, that `goal [B, ...]`.
        """
        return self._init(keys, goal)

    def reset(
        self, state: EnvState, mask: BatchArray, chained: float | None = None, goal: Goal | None = None
    ) -> EnvState:
        """State in which those of `mask [B]` begin a new episode, a share `chained` of them where the arm is.

        Its goal is that of `init`.
        """
        return self._reset(state, mask, chained, goal)

    def step(
        self, state: EnvState, action: BatchArray, times: int = 1, instead: Array | None = None
    ) -> tuple[EnvState, Transition]:
        """State and transition after `action [B, a]`, taken so many `times`.

        An environment whose episode ends on the way stays where it ended, to be reset; rewards are added up. Where
        `instead [B, n]` is a number it is the joint command; without it the command stays where `Task.rests` says so.
        """
        return self._steps(times)(state, action, instead)

    def rearrange(self, state: EnvState, obstacles: Obstacles) -> EnvState:
        """State with the obstacles `[B, K, ...]` where these are, in a task that has some."""
        return replace(state, arm=self.simulator.rearrange(state.arm, obstacles), obstacles=obstacles)

    def _init_all(self, keys: Array, goal: Goal | None) -> EnvState:
        begin = self._sample(keys, goal, np.ones(len(keys), bool))
        return self._parts.begin(self._reset_arms(None, begin, None), begin)

    def _reset_some(self, state: EnvState, mask: BatchArray, chained: float | None, goal: Goal | None) -> EnvState:
        begin = self._sample(state.key, goal, mask)
        if chained is not None:
            begin = begin._replace(q=self._parts.chained_start(state, begin.q, chained))
        arm = self._reset_arms(state.arm, begin, mask)
        begun = replace(self._parts.begin(arm, begin), arm=arm)
        return self._parts.merge(jnp.asarray(mask), begun, replace(state, arm=arm))

    def _sample(self, keys: Array, goal: Goal | None, mask: BatchArray) -> Begin:
        if self._sample_some is None:
            return self._parts.sample_episode(keys, goal)
        return self._sample_some(keys, goal, np.asarray(mask))

    def _reset_arms(self, arm: ArmState | None, begin: Begin, mask: BatchArray | None) -> ArmState:
        return self.simulator.reset(arm, begin.q, begin.goal, mask, begin.dynamics, begin.obstacles)

    def _repeat(self, times: int, state: EnvState, action: BatchArray, instead: Array | None) -> Stepped:
        def again(_: Any, before: Stepped) -> Stepped:
            return self._parts.continued(before, self._step(before[0], action, instead))

        stepped = self._step(state, action, instead)
        if self.simulator.kind == "traced" and times > 1:
            return jax.lax.fori_loop(1, times, again, stepped)
        for i in range(1, times):
            stepped = again(i, stepped)
        return stepped

    def _step(self, state: EnvState, action: BatchArray, instead: Array | None) -> Stepped:
        before = replace(state, arm=replace(state.arm, engine=None))
        taken, target_q, motion = self._parts.command(before, action, instead)
        moved = self.simulator.step(state.arm, target_q)
        judged = self._parts.judge(before, moved._replace(engine=None), target_q, taken)
        tool, goal, progress, clock, sensed, transition = judged
        arm = ArmState(moved.q, moved.qd, tool.position, tool.quaternion, moved.engine, moved.contact)
        state = EnvState(arm, goal, target_q, taken, progress, clock, state.key, state.obstacles, motion, sensed)
        return state, transition

    # --- observations -----------------------------------------------------------------------------

    def observe(self, state: EnvState, picture: BatchArray | None = None) -> Observed:
        """Observation of a state; one that holds a picture is given that of `render_observation`."""
        return self._functions.observe(state, picture)

    def observe_now(self, state: EnvState, mask: np.ndarray | None = None) -> Observed:
        """Observation of a state, outside any trace; pictures are drawn for the environments of `mask [B]` alone."""
        return self._observe(state, self.render_observation(state, mask))

    def situation(self, state: EnvState) -> Situation:
        """What observations and agents may use: as measured, with noise where dynamics vary."""
        return self._functions.situation(state)

    def render_observation(self, state: EnvState, mask: np.ndarray | None = None) -> np.ndarray | None:
        """Pictures `[B, SIZE, SIZE]` uint8 of the environments of `mask [B]`, black for the others.

        None where the observation holds no picture.
        """
        if not self.pictured:
            return None
        if mask is None:
            return self.render_situations(state.arm.q, state.goal, state.key)
        q, samples = np.asarray(state.arm.q), np.asarray(self._view_samples(state.key))
        chosen, pictures = np.flatnonzero(mask), np.zeros((len(q), SIZE, SIZE), np.uint8)
        goal = jax.tree.map(lambda x: np.asarray(x)[chosen], state.goal)
        pictures[chosen] = self._rendered(q[chosen], goal, samples[chosen], chosen)
        return pictures

    def render_situations(self, q: BatchArray, goal: Goal, keys: Array) -> np.ndarray:
        """Pictures `[m, SIZE, SIZE]` uint8 of joints `[m, n]` and goals in episodes with `keys [m]`."""
        return self._rendered(np.asarray(q), goal, np.asarray(self._view_samples(keys)), np.arange(len(q)))

    def check_rendering(self) -> None:
        """Draw a picture, if the observation holds one, to find out whether that can be done.

        Raises:
            InputError: it cannot.
        """
        if self.pictured:
            home, goal = np.array([self.setup.robot.home]), Goal(jnp.zeros((1, 3)))
            self._rendered(home, goal, np.zeros((1, SAMPLES)), np.zeros(1, int))

    def _rendered(self, q: np.ndarray, goal: Goal, samples: np.ndarray, indices: np.ndarray) -> np.ndarray:
        views = make_views(samples, self.setup.robot)
        return develop(self.simulator.render_observations(q, goal, views, indices), views)

    # --- for callers ------------------------------------------------------------------------------

    def compile_part(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """A function beside the simulator: itself where a caller traces everything, compiled where none can."""
        return function if self.traced else jit(function)

    def compile_whole(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """A function that uses this environment, compiled as a whole where everything can be traced."""
        return jit(function) if self.traced else function

    def render(
        self, state: EnvState, index: int = 0, path: np.ndarray = NO_PATH, trail: np.ndarray = NO_PATH
    ) -> np.ndarray:
        """Picture of one environment for people, `[height, width, 3]` uint8.

        With the tool's `path [k, 3]` and the goal's `trail [k, 3]` [m], and the axes of both where an orientation is
        asked for.
        """
        goal, arm, axes = state.goal, state.arm, ()
        if goal.quaternion is not None:
            target = (np.asarray(rows)[index] for rows in (goal.position, goal.quaternion))
            tool = (np.asarray(rows)[index] for rows in (arm.tool_position, arm.tool_quaternion))
            axes = Axes(*target, size=TARGET_AXES), Axes(*tool, size=TOOL_AXES)
        blocks = self.blocks(state, index)
        marks = Marks(self.setup.rules.success_distance, self.reached(state, index), path, trail, axes, blocks)
        return self.simulator.render(arm, goal, index, marks)

    def blocks(self, state: EnvState, index: int = 0) -> tuple[Block, ...]:
        """The obstacles of one environment, as they are drawn; where contact is told, which of them it is with."""
        if state.obstacles is None:
            return ()
        here: Obstacles = jax.tree.map(lambda rows: np.asarray(rows)[index], state.obstacles)
        touched = np.zeros(len(here.radius), bool)
        if state.arm.contact is not None and np.asarray(state.arm.contact)[index]:
            q = np.asarray(state.arm.q)[index]
            touched = np.asarray(self._clearances(q[None], here))[0] < TOUCHING
        parts = (here.position, here.quaternion, here.half, here.radius.tolist(), here.present.tolist())
        return tuple(Block(*one) for one in zip(*parts, touched.tolist(), strict=True))

    def reached(self, state: EnvState, index: int = 0) -> bool:
        """Whether a goal is reached now: the tool is near enough and, where the task asks for it, was held there."""
        progress, rules = state.progress, self.setup.rules
        # Of a goal that moves `solved` tells the whole episode.
        now = progress.solved(rules) if progress.mean_square is None else progress.near(rules)
        return bool(np.asarray(now)[index])

    def close(self) -> None:
        """Close the simulator."""
        self.simulator.close()
