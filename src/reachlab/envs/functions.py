"""An environment's pure functions: what happens before and after the simulator's step, for a batch of episodes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar, cast

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.envs.delays import Sensed, sense, sensed_at_start
from reachlab.envs.random_streams import CHAIN_STREAM, PARTS, SCENE_STREAM, VIEW_STREAM, noise_keys
from reachlab.render.view_randomisation import SAMPLES
from reachlab.robots.kinematics import Pose, forward_kinematics
from reachlab.robots.motion_limits import Motion, MotionLimits
from reachlab.robots.scalar_algebra import once
from reachlab.sims import ArmState, BatchArray, Moved
from reachlab.tasks import actions, observations
from reachlab.tasks.obstacles import Obstacles
from reachlab.tasks.rewards import REWARDS
from reachlab.tasks.schema import Observed
from reachlab.tasks.task import Goal, Progress, Situation, TaskSetup, outside_workspace

POSITION_NOISE, SPEED_NOISE = 0.0005, 0.01
"""Standard deviations of the joint measurements where dynamics vary [rad, rad/s]."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EnvState:
    """A batch of episodes under way.

    Attributes:
        arm: the simulator's state.
        goal: where the tool is asked to be.
        target_q: last joint command `[B, n]` [rad or m]; commands accumulate on it.
        last_action: `[B, a]`, zero at the start.
        progress: what the task remembers of the episodes.
        clock: steps since the reset `[B]`.
        key: random key of each environment `[B]`.
        obstacles: None where there are none.
        motion: of the commands, whose position is `target_q`; None where they are not shaped.
        sensed: what is known of the joints; None where measurements come at once.
    """

    arm: ArmState
    goal: Goal
    target_q: Array
    last_action: Array
    progress: Progress
    clock: Array
    key: Array
    obstacles: Obstacles | None = None
    motion: Motion | None = None
    sensed: Sensed | None = None

    @property
    def distance(self) -> Array:
        """Tool to goal `[B]` [m]."""
        return self.progress.distance


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Transition:
    """What a step gave, before any reset.

    Attributes:
        observation: `[B, k]`, the final one where the episode ended; None where it holds a picture, which is drawn when
            it is asked for, see `Env.observe_now`.
        reward: `[B]`.
        terminated: the task ended the episode `[B]`.
        truncated: the clock did `[B]`.
        done: the episode ended, either way `[B]`.
        terms: `distance` [m], the `error` that counts at the end [m], where the goal has an orientation `angle` and
            `angle_error` [rad], `success` and each term of the reward, `[B]`.
    """

    observation: Observed
    reward: Array
    terminated: Array
    truncated: Array
    done: Array
    terms: dict[str, Array]


Stepped = tuple[EnvState, Transition]
"""State and transition after a step."""

Tree = TypeVar("Tree")


def _errors(progress: Progress) -> dict[str, Array]:
    """Errors of a step by name `[B]`."""
    errors = {"distance": progress.distance, "error": progress.error}
    if progress.angle is None or progress.angle_error is None:
        return errors
    return {**errors, "angle": progress.angle, "angle_error": progress.angle_error}


class Begin(NamedTuple):
    """What `B` episodes begin with.

    Attributes:
        key: `[B]`, of the environments' next episodes.
        q: joints `[B, n]` [rad or m].
        goal: where the tool is asked to be.
        obstacles: None where there are none.
        dynamics: which arms they are, see `Simulator.reset`; None where dynamics do not vary.
    """

    key: Array
    q: Array
    goal: Goal
    obstacles: Obstacles | None
    dynamics: Array | None


@dataclass(frozen=True)
class EnvFunctions:
    """Functions of an environment; every one can be traced by JAX.

    Attributes:
        setup: the task on the arm.
        randomise: what varies from episode to episode, see `RunConfig.randomise`.
        real_time: joints take time to move, see `SimulatorEntry.real_time`.
        pictured: the observation holds a picture.
        limits: within which commands are shaped; None where they are not.
    """

    setup: TaskSetup
    randomise: tuple[str, ...]
    real_time: bool
    pictured: bool
    limits: MotionLimits | None = None

    def sample_episode(self, keys: Array, goal: Goal | None = None) -> Begin:
        """What episodes begin with, those of a `goal` if one is given, and their next keys."""
        setup, task = self.setup, self.setup.task
        numbers = 2 * setup.robot.chain.n + 1 if "dynamics" in self.randomise else 0

        def one(key: Array, goal: Goal | None) -> Begin:
            of_episode, (key, for_goal, for_start, for_arm) = key, jax.random.split(key, PARTS)
            start = task.sample_start(setup, for_start)
            goal = task.sample_goal(setup, for_goal) if goal is None else goal
            dynamics = jax.random.uniform(for_arm, (numbers,), minval=-1.0) if numbers else None
            obstacles = None
            if task.sample_obstacles is not None:
                obstacles = task.sample_obstacles(setup, jax.random.fold_in(of_episode, SCENE_STREAM), start, goal)
            return Begin(key, start, goal, obstacles, dynamics)

        return jax.vmap(one)(keys, goal)

    def chained_start(self, state: EnvState, start: Array, share: float) -> Array:
        """Starts `[B, n]`: where the last episodes ended, for a share of those whose tool is inside the workspace."""
        sampled = jax.vmap(lambda key: jax.random.uniform(jax.random.fold_in(key, CHAIN_STREAM)))(state.key)
        stays = (sampled < share) & ~outside_workspace(self.setup.robot, state.arm.tool_position)
        return jnp.where(stays[:, None], state.arm.q, start)

    def begin(self, arm: ArmState, begin: Begin) -> EnvState:
        """State at the start of episodes."""
        goal = begin.goal
        size = len(actions.ACTIONS[self.setup.rules.action].bounds(self.setup)[0])
        return EnvState(
            arm=arm,
            goal=goal,
            target_q=arm.q,
            last_action=jnp.zeros((len(goal.position), size)),
            progress=self.setup.task.begin(self.setup, goal, arm.tool),
            clock=jnp.zeros(len(goal.position), jnp.int32),
            key=begin.key,
            obstacles=begin.obstacles,
            motion=None if self.limits is None else self.limits.at_rest(arm.q, jnp),
            sensed=sensed_at_start(arm) if "delay" in self.randomise else None,
        )

    def command(self, state: EnvState, action: Array, instead: Array | None) -> tuple[Array, Array, Motion | None]:
        """An action `[B, a]` in its box, the next joint command `[B, n]` and their motion, where it is shaped."""
        action = actions.bounded(self.setup, action)
        wanted = self._wanted(state, action, instead)
        if self.limits is None or state.motion is None:
            return action, wanted, None
        motion = self.limits.advance(state.motion, wanted, xp=jnp)
        return action, motion.position, motion

    def _wanted(self, state: EnvState, action: Array, instead: Array | None) -> Array:
        """The action's joint command `[B, n]`, no faster than the joints can follow, or what else it may be.

        See `Env.step`.
        """
        target_q = actions.command(self.setup, self.situation(state), action)
        if self.real_time:
            most = jnp.array(self.setup.robot.speed) * self.setup.period
            target_q = jnp.clip(target_q, state.target_q - most, state.target_q + most)
        if instead is not None:
            return jnp.where(jnp.isnan(instead), target_q, instead)
        if (rests := self.setup.task.rests(self.setup, state.progress)) is not None:
            return jnp.where(rests[:, None], state.target_q, target_q)
        return target_q

    def judge(
        self, before: EnvState, moved: Moved, target_q: Array, action: Array
    ) -> tuple[Pose, Goal, Progress, Array, Sensed | None, Transition]:
        """The tool's pose, the goal, what is remembered, the clock, what is sensed and the transition of a step."""
        setup, clock = self.setup, before.clock + 1
        # Computed as it is by itself: to the same bits.
        tool = once(forward_kinematics(setup.robot.chain, moved.q)) if moved.tool is None else moved.tool
        goal = before.goal if setup.task.move is None else setup.task.move(setup, before.goal, clock)
        scene = {"obstacles": before.obstacles, "contact": moved.contact}
        now = Situation(moved.q, moved.qd, *tool, goal, target_q, action, **scene)
        outcome = setup.task.judge(setup, before.progress, now, clock)
        progress = outcome.progress
        sensed = None if before.sensed is None else sense(before.sensed, before.arm, before.key, clock, setup.period)
        terms = REWARDS[setup.rules.reward](setup.rules, outcome)
        seen = None if self.pictured else observations.observe(setup, self.measured(now, before.key, clock, sensed))
        transition = Transition(
            observation=seen,
            reward=sum(terms.values(), jnp.zeros_like(outcome.distance)),
            terminated=outcome.terminated,
            truncated=outcome.timeout,
            done=outcome.terminated | outcome.timeout,
            terms={**_errors(progress), "success": outcome.success, **terms},
        )
        return tool, goal, progress, clock, sensed, transition

    def observe(self, state: EnvState, picture: BatchArray | None = None) -> Observed:
        """Observation of a state; one that holds a picture is given it."""
        return observations.observe(self.setup, self.situation(state)._replace(picture=cast("Array | None", picture)))

    def situation(self, state: EnvState) -> Situation:
        """What observations and agents may use: as measured, with noise where dynamics vary, and late if that does."""
        arm = state.arm
        pose = arm.tool_position, arm.tool_quaternion
        scene = {"obstacles": state.obstacles, "contact": arm.contact}
        now = Situation(arm.q, arm.qd, *pose, state.goal, state.target_q, state.last_action, **scene)
        return self.measured(now, state.key, state.clock, state.sensed)

    def measured(self, now: Situation, keys: Array, clock: Array, sensed: Sensed | None) -> Situation:
        """A situation as it is measured, and the goal as far as it is known."""
        if now.goal.velocity is not None and not self.setup.rules.goal_velocity:
            now = now._replace(goal=replace(now.goal, velocity=jnp.zeros_like(now.goal.velocity)))
        if sensed is None and "dynamics" not in self.randomise:
            return now
        q, qd = (now.q, now.qd) if sensed is None else (sensed.q, sensed.qd)
        if "dynamics" in self.randomise:
            noise = jax.vmap(lambda key: jax.random.normal(key, (2, now.q.shape[-1])))(noise_keys(keys, clock))
            q, qd = q + POSITION_NOISE * noise[:, 0], qd + SPEED_NOISE * noise[:, 1]
        pose = forward_kinematics(self.setup.robot.chain, q)
        measured = now._replace(q=q, qd=qd, tool_position=pose.position, tool_quaternion=pose.quaternion)
        return measured._replace(achieved=Pose(now.tool_position, now.tool_quaternion))

    def view_samples(self, keys: Array) -> Array:
        """Random numbers `[B, SAMPLES]` of the views of episodes, see `make_views`; zeros where views do not vary."""
        if "view" not in self.randomise:
            return jnp.zeros((len(keys), SAMPLES))
        folded = jax.vmap(lambda key: jax.random.fold_in(key, VIEW_STREAM))(keys)
        return jax.vmap(lambda key: jax.random.uniform(key, (SAMPLES,), minval=-1.0))(folded)

    @staticmethod
    def merge(mask: Array, new: Tree, old: Tree) -> Tree:
        """A pytree of batches with the rows of `new` where `mask [B]` says so."""

        def pick(a: Array, b: Array) -> Array:
            return jnp.where(mask.reshape(mask.shape + (1,) * (a.ndim - 1)), a, b)

        return jax.tree.map(lambda a, b: a if a is b else pick(a, b), new, old)

    @classmethod
    def continued(cls, before: Stepped, now: Stepped) -> Stepped:
        """State and transition of a step after those `before`, which stay where the episode has ended."""
        state, transition = now
        added = replace(transition, reward=before[1].reward + transition.reward)
        return cls.merge(~before[1].done, (state, added), before)
