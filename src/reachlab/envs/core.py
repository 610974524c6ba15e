"""The environment: a simulator, a task and a clock, for a batch of episodes."""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NoReturn, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.bodies import Bodies
from reachlab.control.situation import Goal, Situation, shaped_within
from reachlab.envs.delays import goal_seen
from reachlab.envs.functions import EnvFunctions, EnvState, Stepped, Transition
from reachlab.envs.packing import Computed
from reachlab.envs.random_streams import checked_keys
from reachlab.envs.sampling import AllAtOnce, InParts
from reachlab.envs.setup import make_setup, settled
from reachlab.envs.shown import Shown
from reachlab.jax_setup import jit, prepare
from reachlab.render.marks import NO_PATH
from reachlab.render.view_randomisation import develop, make_views
from reachlab.settings.config import MOST_ENVS, RunConfig
from reachlab.settings.validation import InputError, whole_number
from reachlab.sims.simulator import BatchArray, SimState, chosen, make_simulator
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.observations import design_of
from reachlab.tasks.schema import SIZE, Observed
from reachlab.tasks.targets import solved_for
from reachlab.traced import digest, kept


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
        functions: what happens before and after a step of it.
        shown: what pictures for people show of a state beside the arm.
        sample, parts, observed: what episodes begin with, these functions, and what is observed: traced, or compiled
            one by one.
    """

    def __init__(self, config: RunConfig, num_envs: int, threads: int = 0) -> None:
        """Environment of `num_envs` episodes at a time, which differ in what `config.randomise` names.

        A simulator outside JAX steps them on so many threads, 0 for one a core.

        Raises:
            InputError: a name in the configuration that does not exist, a setting that does not fit the arm, or JAX
                computes with 64 bits.
        """
        num_envs = whole_number("num_envs", num_envs, 1, MOST_ENVS)
        prepare()
        setup = make_setup(config)
        self.config, self.num_envs = settled(config, setup), num_envs
        self.simulator = make_simulator(
            config.sim,
            setup.robot,
            config.physics,
            num_envs,
            threads,
            randomise=config.randomise,
            scene=setup.scene,
        )
        self.setup = replace(setup, lag=self.simulator.lag)
        self._drawn = digest(self.setup.prepared)
        self.schema = design_of(config.rules).schema(self.setup)
        self.action_bounds = ACTIONS[config.rules.action].bounds(self.setup)
        self.pictured = bool(self.schema.pictures)
        simulated = self.simulator.kind == "traced"
        self.traced = simulated and not self.pictured
        limits = shaped_within(self.setup) if config.physics.shaping else None
        more = max(self.simulator.lag) > 0, self.pictured, limits, config.learner.memory
        f = self.functions = EnvFunctions(self.setup, config.randomise, *more)
        # Traced with the simulator's steps or, where an engine takes most of the time, compiled one by one.
        parts = (f.sample_episode, f.chained_start, f.begin, f.command, f.judge, chosen, f.continued)
        self.parts = SimpleNamespace(**{one.__name__: one if simulated else self._part(one) for one in parts})
        at_once = simulated or not solved_for(setup)
        self.sample = AllAtOnce(self.parts.sample_episode) if at_once else InParts(f.sample_episode, self._part)
        # With pictures a simulator that can be traced is compiled here: only the pictures are drawn on the host.
        whole = self._whole = jit if simulated and self.pictured else lambda function: function
        self._init, self._reset = whole(self._init_all), whole(self._reset_some)
        self._steps, self.shown = dict[int, Callable[..., Stepped]](), Shown(self.setup)
        self._goal_seen = jit(functools.partial(goal_seen, setup.rules), brief=True)
        self.observed, self._view_samples = self._part(f.observe), jit(f.view_samples, brief=True)

    def __repr__(self) -> str:
        """Short: its settings fill a screen."""
        return f"<Env of {self.num_envs} {self.config.task!r} with {self.config.robot!r} in {self.config.sim!r}>"

    def _part(self, function: Callable[..., Any]) -> Computed:
        return Computed(kept(function, function.__name__, self.identity))

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

        Raises:
            InputError: no key for each of them.
        """
        return self._init(checked_keys(keys), goal, False)

    def init_held_out(self, keys: Array) -> EnvState:
        """The same for an evaluation: scenes that are drawn before training are others than those to train in."""
        return self._init(keys, None, True)

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
        `instead [B, n]` is a number it is the joint command; without it the arm rests at the goal if the rules let it.

        Raises:
            InputError: the actions have another shape.
        """
        if (shape := jnp.shape(action)) != (allowed := (len(state.key), len(self.action_bounds[0]))):
            raise InputError(f"actions of these environments have shape {allowed}, got {shape}.")
        if times not in self._steps:
            self._steps[times] = self._whole(functools.partial(self._repeat, times))
        return self._steps[times](state, action, instead)

    def rearrange(self, state: EnvState, bodies: Bodies) -> EnvState:
        """State with the bodies `[B, K]` where these are."""
        return replace(state, arm=replace(state.arm, bodies=self._own(bodies)))

    def _init_all(self, keys: Array, goal: Goal | None, held_out: bool) -> EnvState:
        begin = self.sample(keys, self._own(goal), np.ones(len(keys), bool), held_out)
        arm = self.simulator.reset(None, begin, None)
        return replace(self.parts.begin(replace(arm, engine=None), begin), arm=arm)

    def _reset_some(self, state: EnvState, mask: BatchArray, chained: float | None, goal: Goal | None) -> EnvState:
        begin = self.sample(state.key, self._own(goal), mask, False)
        if chained is not None:
            begin = begin._replace(q=self.parts.chained_start(state, begin.q, chained))
        arm = self.simulator.reset(state.arm, begin, mask)
        begun = replace(self.parts.begin(replace(arm, engine=None), begin), arm=arm)
        return self.parts.chosen(jnp.asarray(mask), begun, replace(state, arm=arm))

    def _own(self, given: Any) -> Any:
        return given if self.simulator.kind == "traced" else jax.tree.map(np.array, given)  # a caller may change it

    def _repeat(self, times: int, state: EnvState, action: BatchArray, instead: Array | None) -> Stepped:
        def again(_: Any, before: Stepped) -> Stepped:
            return self.parts.continued(before, self._step(before[0], action, instead))

        stepped = self._step(state, action, instead)
        if self.simulator.kind == "traced" and times > 1:
            return jax.lax.fori_loop(1, times, again, stepped)
        for i in range(1, times):
            stepped = again(i, stepped)
        return stepped

    def _step(self, state: EnvState, action: BatchArray, instead: Array | None) -> Stepped:
        before = state.apart
        taken, command, motion = self.parts.command(before, self._own(action), instead)
        moved = self.simulator.step(state.arm, command)
        after, transition = self.parts.judge(before, moved._replace(engine=None), command, taken, motion)
        return replace(after, arm=replace(after.arm, engine=moved.engine)), transition

    # --- observations -----------------------------------------------------------------------------

    def observe(self, state: EnvState, picture: BatchArray | None = None) -> Observed:
        """Observation of a state; one that holds a picture is given that of `render_observation`."""
        return self.functions.observe(state, picture)

    def observe_now(self, state: EnvState, mask: np.ndarray | None = None) -> Observed:
        """Observation of a state, outside any trace; pictures are drawn for the environments of `mask [B]` alone."""
        return self.observed(state.apart, self.render_observation(state, mask))

    def situation(self, state: EnvState) -> Situation:
        """Situations that observations and agents may use: as measured, with noise where dynamics vary."""
        return self.functions.situation(state)

    def render_observation(self, state: EnvState, mask: np.ndarray | None = None) -> np.ndarray | None:
        """Pictures `[B, SIZE, SIZE]` uint8 of the environments of `mask [B]`, black for the others.

        None where the observation holds no picture.
        """
        if not self.pictured:
            return None
        pictures = np.zeros((self.num_envs, SIZE, SIZE), np.uint8)
        chosen = np.flatnonzero(self.goal_seen(state.key, state.clock) & (True if mask is None else mask))
        pictures[chosen] = self.render_situations(replace(state.arm, engine=None), state.goal, state.key, chosen)
        return pictures

    def goal_seen(self, keys: Array, clock: BatchArray | None) -> np.ndarray:
        """Whether the goal is seen at steps `clock [B]` of the episodes with `keys [B]`, in which it may be hidden."""
        return np.asarray(self._goal_seen(keys, clock)) if self.setup.rules.hides_goal else np.ones(len(keys), bool)

    def render_situations(self, arm: SimState, goal: Goal, keys: Array, rows: np.ndarray) -> np.ndarray:
        """Pictures `[m, SIZE, SIZE]` uint8 of those `rows [m]` of arms and goals in episodes with `keys [B]`."""
        samples, objects = np.asarray(self._view_samples(keys))[rows], self.setup.task.scene(self.setup).objects > 0
        views = make_views(samples, self.setup.robot, objects=objects)
        arm, goal = jax.tree.map(lambda x: np.asarray(x)[rows], (arm, goal))
        return develop(self.simulator.render_observations(arm, goal, views, rows), views)

    def check_rendering(self) -> None:
        """Draw a picture, if the observation holds one, to find out whether that can be done.

        Raises:
            InputError: it cannot.
        """
        if self.pictured:
            state = self.init(jax.random.split(jax.random.key(0), self.num_envs))
            self.render_observation(state, np.arange(self.num_envs) == 0)

    @functools.cached_property
    def identity(self) -> str:
        """All that its functions depend on beside their arguments."""
        return repr((replace(self.config, seed=0), self.setup.robot, self.setup.lag, self.num_envs, self._drawn))

    # --- for callers ------------------------------------------------------------------------------

    def compile_part(self, function: Callable[..., Any], *settings: object) -> Callable[..., Any]:
        """A function beside the simulator: itself where a caller traces everything, compiled where none can.

        It is kept by its name where `settings` are all that it depends on beside its arguments and this environment.
        """
        if self.traced:
            return function
        return Computed(kept(function, function.__name__, self.identity, *settings) if settings else function)

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
        return self.simulator.render(state.arm, state.goal, index, self.shown.marks(state, index, path, trail))

    def close(self) -> None:
        """Close the simulator."""
        self.simulator.close()
