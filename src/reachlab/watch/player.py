"""Plays an agent's episodes on one arm; the target may be moved and turned by hand, and is then followed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.agents import AGENTS
from reachlab.agents.acting import Function, make_act
from reachlab.agents.policy import Policy
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, Transition
from reachlab.envs.given_goal import make_place
from reachlab.envs.random_streams import AGENT_STREAM, REPORT_STREAM, episode_keys
from reachlab.jax_setup import jit
from reachlab.tasks.task import Errors
from reachlab.watch.moment import PATH_STEP, TRAIL_STEP, Moment, Trace

Advance = Callable[[Policy | None, EnvState, Array, bool, np.ndarray], tuple[EnvState, Transition, Array]]

TRAINED = "trained"
"""The agent that takes a policy."""

LEFT, LATE, TOUCHED = "left the workspace", "did not arrive in time", "touched something"
"""Why an arm does not follow its target."""


class Player:
    """One arm, driven step by step through the episodes that `evaluate` counts.

    While it follows no success ends an episode: the arm rests at the target, its joint command held, and acts again
    when the target is moved away. Where the task asks the policy to hold the target, the policy acts all the time.
    A policy whose episodes all began at home knows no other way: the arm first goes back there on the way it came.

    Attributes:
        moment: the arm now.
        state: of the environment, now.
        number: of the episode, from 0.
        clock: control steps since the episode began or the target was moved.
        over: the episode has ended; `proceed` begins what comes next.
        success: the last step was one, by the task's rules.
        failed: `LEFT`, `LATE` or `TOUCHED`, where the arm does not follow a target that was moved; else empty.
        steps: control steps taken.
        episodes, successes: those that ended, and in success. One whose target was followed or moved does not count.
    """

    moment: Moment
    state: EnvState

    def __init__(self, env: Env, seed: int) -> None:
        """Player of the held-out targets of a seed, on an environment of a single episode."""
        self._env, self._seed = env, seed
        self._advances: dict[str | Function, Advance] = {}
        self._init = env.compile_whole(env.init_held_out)
        setup = env.setup
        self._place, self._begin_task = make_place(setup), jit(partial(_begun, env))
        self._knows_home_alone = knows_home_alone(env)
        self._nothing = np.full(len(env.setup.robot.actuators), np.nan, np.float32)
        self._following = False
        self.steps = self.episodes = self.successes = 0
        self.begin(0)

    def begin(self, number: int) -> None:
        """Begin the episode of that number."""
        keys = episode_keys(self._seed, REPORT_STREAM, number, 1)
        self.number, self._key = number, jax.random.fold_in(keys[0], AGENT_STREAM)
        self._touched, self._at_home = self._following, True
        self.state, self.clock = self._init(keys), 0
        self.over, self.success, self.failed = False, False, ""
        self._path, self._trail = Trace(PATH_STEP), Trace(TRAIL_STEP)
        self._way: list[np.ndarray] = []
        self._going_back = False
        self._look()

    def step(self, agent: str | Function, policy: Policy | None, wanted: np.ndarray | None = None) -> None:
        """Take one control step with an agent, see `make_act`, or towards a joint command `[n]` that is `wanted`."""
        if agent not in self._advances:
            self._advances[agent] = make_advance(self._env, agent)
        by_hand = wanted is not None
        command = self._way_back(agent) if wanted is None else self._towards(wanted)
        follows = self._following and not by_hand
        self.state, transition, self._key = self._advances[agent](policy, self.state, self._key, follows, command)
        self._touched |= by_hand
        self.steps, self.clock = self.steps + 1, self.clock + 1
        self._look()
        done, terminated, success = (
            bool(np.asarray(row)[0]) for row in (transition.done, transition.terminated, transition.terms["success"])
        )
        self.success = success
        if self._touched:
            self.failed = "" if by_hand else self._failure()
            self.over = bool(self.failed) or (done and not (self._following or by_hand) and (success or not terminated))
        elif done:
            self.over = True
            self.episodes += 1
            self.successes += success

    def _towards(self, wanted: np.ndarray) -> np.ndarray:
        """The next joint command `[n]` on the way to one that is wanted, at most as far as the joints are fast."""
        last, setup = np.asarray(self.state.command)[0], self._env.setup
        most = setup.period * np.array(setup.robot.commands.speed)
        return (last + np.clip(wanted - last, -most, most)).astype(np.float32)

    def _way_back(self, agent: str | Function) -> np.ndarray:
        """Joint command `[n]` on the way back home; not a number where the agent acts, whose way is remembered."""
        if self._going_back and self._way and agent == TRAINED:
            return self._way.pop()
        if self._going_back:
            self._going_back = False
            self._renew()
        last = np.asarray(self.state.command)[0]
        if not self._way or not np.array_equal(last, self._way[-1]):  # an arm at rest makes no way
            self._way.append(last)
        return self._nothing

    def _failure(self) -> str:
        """Why the arm does not follow; empty where it does.

        A tool near a target at the workspace's edge may be outside by the success distance: that is no failure.
        """
        rules, (low, high) = self._env.setup.rules, np.array(self._env.setup.robot.workspace)
        away = np.linalg.norm(self.moment.tool - np.clip(self.moment.tool, low, high))
        if rules.ends_outside and away > rules.success_distance:
            return LEFT
        if rules.ends_on_contact and np.asarray(self.state.arm.contact)[0]:
            return TOUCHED
        late = self.clock >= rules.max_steps and not self.on_path and not self._near()
        return LATE if late else ""

    def proceed(self) -> None:
        """Begin the next episode; after a failure to follow, begin anew from home with all else as it is.

        A target that nobody holds any more is tried from home only once.
        """
        if not self.failed or (self._at_home and not self._following):
            self.begin(self.number + 1)
            return
        moment, moves, bodies = self.moment, self.on_path, self.state.arm.bodies
        self.begin(self.number)
        self.state = self._env.rearrange(self.state, bodies)
        if not moves:
            self.move_target(moment.target, moment.target_orientation)
        self._at_home = True

    def observed_picture(self) -> np.ndarray | None:
        """What the policy observes now, `[SIZE, SIZE, 3]` uint8, if that is a picture."""
        pictures = self._env.render_observation(self.state)
        return jax.tree.map(lambda each: np.stack([each[0]] * 3, axis=-1), pictures)  # None stays None

    def follow(self, following: bool) -> None:
        """Follow the target, or play episodes to their end."""
        self._following, self._touched = following, self._touched or following
        self.over = self.over and (bool(self.failed) or not following)

    @property
    def on_path(self) -> bool:
        """Whether the target moves by itself."""
        return bool(self.state.goal.moves()[0])

    def move_target(self, target: np.ndarray, orientation: np.ndarray | None = None) -> bool:
        """Put the target at `[3]` m and, where one is asked for, into an orientation `[4]` wxyz, by default its own.

        The arm continues from where it is, with all the time of an episode. False where no joints are found at which
        the tool is so: then the target stays.
        """
        own = self.moment.target_orientation
        turned = np.asarray(orientation if len(own) and orientation is not None else own, np.float32)
        state = self.state
        goal, found = self._place(state.goal, np.asarray(target, np.float32), turned, np.asarray(state.arm.q)[0])
        if not found:
            return False
        self.state = replace(state, goal=goal)
        self._renew()
        self._going_back = self._knows_home_alone and not self._near() and bool(self._way)
        self._touched, self._at_home, self.over = True, False, bool(self.failed)
        self._look()
        return True

    def move_body(self, number: int, position: np.ndarray) -> None:
        """Put a body at `[3]` m, inside the workspace; the arm has all the time of an episode again."""
        bodies = self.state.arm.bodies
        positions = np.array(bodies.position)
        positions[0, number] = np.clip(position, *self._env.setup.robot.workspace)
        self.state = self._env.rearrange(self.state, replace(bodies, position=jnp.asarray(positions)))
        self._renew()
        self._touched, self._at_home, self.over = True, False, bool(self.failed)
        self._look()

    def _near(self) -> bool:
        return bool(np.asarray(self._env.setup.task.near(self._env.setup.rules, self.state.errors))[0])

    def _renew(self) -> None:
        """Give the arm all the time of an episode again."""
        state = self.state
        errors, progress = self._begin_task(state)
        self.state = replace(state, errors=errors, progress=progress, clock=jnp.zeros_like(state.clock))
        self.clock = 0

    def _look(self) -> None:
        arm, goal, errors, setup = self.state.arm, self.state.goal, self.state.errors, self._env.setup
        tool, target, rules = _row(arm.tool_position), _row(goal.position), setup.rules
        counted = setup.task.counted(errors, self.state.progress)
        settled = rules.moves and self.clock > rules.settle_steps
        self.moment = Moment(
            q=setup.robot.posture(np.concatenate([_row(arm.q), _row(arm.opening)])),
            tool=tool,
            target=target,
            target_orientation=_row(goal.quaternion),
            distance=float(_row(errors.distance)),
            angle=_row(errors.angle).astype(float),
            error=float(_row(counted.distance)) if settled else None,
            reached=self._env.shown.reached(self.state),
            path=self._path.add(tool),
            trail=self._trail.add(target) if rules.moves else self._trail.points,
        )


def _row(rows: Array) -> Any:
    """The first of rows `[1, ...]`."""
    return np.asarray(rows)[0]


def _begun(env: Env, state: EnvState) -> tuple[Errors, Any]:
    """Errors now, and what the task remembers of an episode that begins with them."""
    arm, task, setup = state.arm, env.setup.task, env.setup
    now = env.situation(state)._replace(q=arm.q, qd=arm.qd, tool_position=arm.tool_position)
    errors = task.errors(setup, now._replace(tool_quaternion=arm.tool_quaternion, goal=state.goal))
    return errors, task.begin(setup, errors)


def played(player: Player, agent: str | Function, policy: Policy | None, stride: int) -> Iterator[None]:
    """Plays the episode that has begun, and stops at its begin, at every `stride`-th step and at its end."""
    yield
    while not player.over:
        player.step(agent, policy)
        if player.over or player.clock % stride == 0:
            yield


def make_advance(env: Env, agent: str | Function) -> Advance:
    """Function that gives state, transition and random key after a control step of an agent, which may follow.

    A joint command `[n]` that is a number is taken in place of the agent's.
    """
    act, rules = make_act(env, agent), env.setup.rules
    rests_there = not (rules.holds or rules.moves)

    def advance(
        policy: Policy | None, state: EnvState, key: Array, following: bool, command: np.ndarray
    ) -> tuple[EnvState, Transition, Array]:
        instead = jnp.asarray(command)[None]
        if rests_there:
            rests = env.setup.task.near(rules, state.errors) & (following | rules.rests_at_goal)
            instead = jnp.where(rests[:, None], state.command, instead)
        return act(policy, state, key, instead=instead)

    # What is no function of arrays alone is called outside of JAX's traces.
    traced = isinstance(agent, str) and not AGENTS[agent].remembers
    return env.compile_whole(advance) if traced else advance


def knows_home_alone(env: Env) -> bool:
    """Whether all episodes of a policy's training began at home, so that it knows no way from anywhere else."""
    rules = env.setup.rules
    return not (rules.holds or rules.start_noise or env.config.loop.chained_starts)
