"""An environment's pure functions: what happens before and after the simulator's step, for a batch of episodes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.control.motion_limits import Motion, MotionLimits
from reachlab.control.situation import Goal, Situation
from reachlab.envs import random_streams as streams
from reachlab.envs.delays import Sensed, Sight, felt, goal_seen, misplaced, sense
from reachlab.render.view_randomisation import SAMPLES
from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.robots.kinematics.scalars import once
from reachlab.sims.simulator import BatchArray, Begin, Moved, SimState, chosen
from reachlab.tasks import actions, observations
from reachlab.tasks.judging import judge, outside_workspace
from reachlab.tasks.rewards import reward_terms
from reachlab.tasks.schema import Observed
from reachlab.tasks.task import Errors, Keys, Progress, TaskSetup

POSITION_NOISE, SPEED_NOISE = 0.0005, 0.01
"""Standard deviations of the joint measurements where dynamics vary [rad, rad/s]."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EnvState:
    """A batch of episodes under way, of arrays of JAX or, beside a simulator on the host, of NumPy.

    Attributes:
        arm: the simulator's state.
        goal: what is asked for.
        command: the last one `[B, m]` [rad or m]; commands accumulate on it.
        last_action: `[B, a]`, zero at the start.
        errors: how far what is moved is from where it has to be.
        progress: what the task remembers of the episodes.
        clock: steps since the reset `[B]`.
        key: random key of each environment `[B]`.
        motion: of the commands, whose position is `command`; None where they are not shaped.
        sensed: what is known of the joints; None where measurements come at once.
        sight: what is known of the bodies; None where they are seen at once.
        memory: what the policy remembers of the episode `[B, M]`; None of one without memory.
    """

    arm: SimState
    goal: Goal
    command: Array
    last_action: Array
    errors: Errors
    progress: Progress
    clock: Array
    key: Array
    motion: Motion | None = None
    sensed: Sensed | None = None
    sight: Sight | None = None
    memory: Array | None = None

    @property
    def distance(self) -> Array:
        """Distance of what is moved from where it has to be `[B]` [m]."""
        return self.errors.distance

    @property
    def apart(self) -> EnvState:
        """The state without the engine's own, as what is compiled takes it."""
        return replace(self, arm=replace(self.arm, engine=None))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Transition:
    """Result of a step, before any reset.

    Attributes:
        observation: `[B, k]`, the final one where the episode ended; None where it holds a picture, which is drawn when
            it is asked for, see `Env.observe_now`.
        reward: `[B]`.
        terminated: the task ended the episode `[B]`.
        truncated: the clock did `[B]`.
        done: the episode ended, either way `[B]`.
        errors: how far what is moved is from where it has to be.
        counted: the errors that count at the end, see `Task.counted`.
        terms: `success` and each term of the reward, `[B]`.
    """

    observation: Observed
    reward: Array
    terminated: Array
    truncated: Array
    done: Array
    errors: Errors
    counted: Errors
    terms: dict[str, Array]


def named_errors(setup: TaskSetup, errors: Errors) -> dict[str, BatchArray]:
    """Errors as infos name them: `distance` [m] and, where an orientation is asked for, `angle` [rad]."""
    return {"distance": errors.distance} | ({"angle": errors.angle} if setup.rules.asks_orientation else {})


Stepped = tuple[EnvState, Transition]
"""State and transition after a step."""


@dataclass(frozen=True)
class EnvFunctions:
    """Functions of an environment; every one can be traced by JAX.

    Attributes:
        setup: the task on the arm.
        randomise: what varies from episode to episode, see `RunConfig.randomise`.
        real_time: joints take time to move, so that a command may change no faster than they can.
        pictured: the observation holds a picture.
        limits: within which commands are shaped; None where they are not.
        memory: numbers that the policy remembers.
    """

    setup: TaskSetup
    randomise: tuple[str, ...]
    real_time: bool
    pictured: bool
    limits: MotionLimits | None = None
    memory: int = 0

    def sample_episode(self, keys: Array, goal: Goal | None = None, held_out: Array | bool = False) -> Begin:
        """Beginnings of episodes, of those of a `goal` if one is given, and their next keys; see `Task.sample`."""
        setup, task = self.setup, self.setup.task
        arm = 2 * setup.robot.chain.n + 1 if "dynamics" in self.randomise else 0
        numbers = arm + 2 if "objects" in self.randomise else arm

        def one(key: Array, goal: Goal | None) -> Begin:
            of_episode, (key, for_goal, for_start, for_arm) = key, jax.random.split(key, streams.PARTS)
            dynamics = jax.random.uniform(for_arm, (numbers,), minval=-1.0)
            if "lag" in self.randomise:
                for_lag = jax.random.fold_in(of_episode, streams.LAG_STREAM)
                lag = jax.random.uniform(for_lag, (1,), minval=-1.0)
                dynamics = jnp.concatenate([dynamics[:arm], lag, dynamics[arm:]])
            parts = Keys(for_goal, for_start, jax.random.fold_in(of_episode, streams.SCENE_STREAM))
            start, goal, bodies = task.sample(setup, parts, goal, held_out)
            if "objects" in self.randomise:
                goal, bodies = task.vary(setup, jax.random.fold_in(of_episode, streams.OBJECT_STREAM), goal, bodies)
            return Begin(key, start, goal, bodies, dynamics)

        return jax.vmap(one)(keys, goal)

    def chained_start(self, state: EnvState, start: Array, share: float) -> Array:
        """Starts `[B, n]`: where the last episodes ended, for a share of those whose tool is inside the workspace."""
        sampled = jax.vmap(lambda key: jax.random.uniform(jax.random.fold_in(key, streams.CHAIN_STREAM)))(state.key)
        stays = (sampled < share) & ~outside_workspace(self.setup.robot, state.arm.tool_position)
        return jnp.where(stays[:, None], state.arm.q, start)

    def begin(self, arm: SimState, begin: Begin) -> EnvState:
        """State at the start of episodes."""
        goal, count = begin.goal, len(begin.goal.position)
        action = jnp.zeros((count, len(actions.ACTIONS[self.setup.rules.action].bounds(self.setup)[0])))
        rest = arm.actuated
        now = Situation(arm.q, arm.qd, *arm.tool, goal, rest, action, arm.bodies, arm.contact, arm.tool, arm.opening)
        errors = self.setup.task.errors(self.setup, now)
        return EnvState(
            arm=arm,
            goal=goal,
            command=rest,
            last_action=action,
            errors=errors,
            progress=self.setup.task.begin(self.setup, errors),
            clock=jnp.zeros(count, jnp.int32),
            key=begin.key,
            motion=None if self.limits is None else self.limits.at_rest(rest, jnp),
            sensed=Sensed(arm.q, arm.qd, arm.q, arm.qd) if "delay" in self.randomise else None,
            sight=Sight.of(arm.bodies) if "sight" in self.randomise else None,
            memory=jnp.zeros((count, self.memory)) if self.memory else None,
        )

    def command(self, state: EnvState, action: Array, instead: Array | None) -> tuple[Array, Array, Motion | None]:
        """An action `[B, a]` in its box, the next command `[B, m]` and their motion, where it is shaped.

        The command is no faster than the joints can follow, or what else it may be, see `Env.step`.
        """
        action = actions.bounded(self.setup, action)
        command = actions.command(self.setup, self.situation(state), action)
        if self.real_time:
            most = jnp.array(self.setup.robot.commands.speed) * self.setup.period
            command = jnp.clip(command, state.command - most, state.command + most)
        if instead is not None:
            command = jnp.where(jnp.isnan(instead), command, instead)
        elif self.setup.rules.rests_at_goal:
            near = self.setup.task.near(self.setup.rules, state.errors)
            command = jnp.where(near[:, None], state.command, command)
        return action, *self.shaped(state, command)

    def shaped(self, state: EnvState, command: Array) -> tuple[Array, Motion | None]:
        """A command `[B, m]` within the limits of acceleration and jerk, where they are kept, and its motion."""
        if self.limits is None or state.motion is None:
            return command, None
        motion = self.limits.advance(state.motion, command, xp=jnp)
        return motion.position, motion

    def judge(self, before: EnvState, moved: Moved, command: Array, action: Array, motion: Motion | None) -> Stepped:
        """State, without what the engine keeps, and transition that follow from a step of the simulator."""
        setup, clock = self.setup, before.clock + 1
        # Computed as it is by itself: to the same bits.
        tool = once(forward_kinematics(setup.robot.chain, moved.q)) if moved.tool is None else moved.tool
        goal, bodies = setup.task.move(setup, before.goal, moved.bodies, clock)
        now = Situation(moved.q, moved.qd, *tool, goal, command, action, bodies, moved.contact, tool, moved.opening)
        now = now._replace(wrench=moved.wrench)
        outcome = judge(setup, before.errors, before.progress, now, clock)
        sensed = None if before.sensed is None else sense(before.sensed, before.arm, before.key, clock, setup.period)
        sight = None if before.sight is None else before.sight.after(bodies, before.key, clock)
        terms = reward_terms(setup.rules, outcome)
        seen = (
            None if self.pictured else observations.observe(setup, self.measured(now, before.key, clock, sensed, sight))
        )
        transition = Transition(
            observation=seen,
            reward=sum(terms.values(), jnp.zeros_like(outcome.gap)),
            terminated=outcome.terminated,
            truncated=outcome.timeout,
            done=outcome.terminated | outcome.timeout,
            errors=outcome.errors,
            counted=outcome.counted,
            terms={"success": outcome.success, **terms},
        )
        bodies = bodies if setup.task.scene(setup).moved else moved.bodies
        arm = SimState(moved.q, moved.qd, *tool, bodies, moved.contact, moved.opening, wrench=moved.wrench)
        errors, progress, key = outcome.errors, outcome.progress, before.key
        known = (sensed, sight, before.memory)
        return EnvState(arm, goal, command, action, errors, progress, clock, key, motion, *known), transition

    def observe(self, state: EnvState, picture: BatchArray | None = None) -> Observed:
        """Observation of a state; one that holds a picture is given it."""
        return observations.observe(self.setup, self.situation(state)._replace(picture=cast("Array | None", picture)))

    def situation(self, state: EnvState) -> Situation:
        """Situations as measured, for observations and agents: noisy where dynamics vary, and late if that does."""
        arm = state.arm
        beside = arm.bodies, arm.contact, arm.tool, arm.opening
        now = Situation(arm.q, arm.qd, *arm.tool, state.goal, state.command, state.last_action, *beside)
        now = now._replace(wrench=arm.wrench)
        return self.measured(now, state.key, state.clock, state.sensed, state.sight)

    def measured(
        self, now: Situation, keys: Array, clock: Array, sensed: Sensed | None, sight: Sight | None
    ) -> Situation:
        """A situation as it is measured, and the goal as far as it is known."""
        moved = now.achieved._replace(position=self.setup.task.achieved(now))
        now = now._replace(goal=self.setup.task.known(self.setup, now.goal), achieved=moved)
        if sight is not None:
            now = now._replace(bodies=sight.known)
        if "objects" in self.randomise:
            now = now._replace(bodies=jax.vmap(misplaced)(keys, now.bodies))
        if "dynamics" in self.randomise and now.wrench is not None:
            now = now._replace(wrench=felt(now.wrench, keys, clock))
        if sensed is not None or "dynamics" in self.randomise:
            now = self._sensed(now, keys, clock, sensed)
        if not self.setup.rules.hides_goal:
            return now
        there = goal_seen(self.setup.rules, keys, clock)[:, None]
        place = jnp.where(there, now.goal.position, now.tool_position)
        velocity = jnp.where(there, now.goal.velocity, 0.0)
        return now._replace(goal=replace(now.goal, position=place, velocity=velocity))

    def _sensed(self, now: Situation, keys: Array, clock: Array, sensed: Sensed | None) -> Situation:
        """A situation with its joints as they are measured."""
        q, qd = (now.q, now.qd) if sensed is None else (sensed.q, sensed.qd)
        if "dynamics" in self.randomise:
            of_step = streams.step_keys(keys, clock, streams.NOISE_STREAM)
            noise = jax.vmap(lambda key: jax.random.normal(key, (2, now.q.shape[-1])))(of_step)
            q, qd = q + POSITION_NOISE * noise[:, 0], qd + SPEED_NOISE * noise[:, 1]
        pose = forward_kinematics(self.setup.robot.chain, q)
        return now._replace(q=q, qd=qd, tool_position=pose.position, tool_quaternion=pose.quaternion)

    def view_samples(self, keys: Array) -> Array:
        """Random numbers `[B, SAMPLES]` of the views of episodes, see `make_views`; zeros where views do not vary."""
        if "view" not in self.randomise:
            return jnp.zeros((len(keys), SAMPLES))
        folded = jax.vmap(lambda key: jax.random.fold_in(key, streams.VIEW_STREAM))(keys)
        return jax.vmap(lambda key: jax.random.uniform(key, (SAMPLES,), minval=-1.0))(folded)

    @staticmethod
    def continued(before: Stepped, now: Stepped) -> Stepped:
        """State and transition of a step after those `before`, which stay where the episode has ended."""
        state, transition = now
        added = replace(transition, reward=before[1].reward + transition.reward)
        return chosen(~before[1].done, (state, added), before)
