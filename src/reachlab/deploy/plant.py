"""A simulated arm that is driven in real time by a controller in another process, and judged as in an evaluation."""

from __future__ import annotations

import heapq
import itertools
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from reachlab.deploy.plant_faults import Faults
from reachlab.deploy.surroundings import step_arguments, surroundings
from reachlab.envs.core import Env
from reachlab.envs.random_streams import REPORT_STREAM, episode_keys
from reachlab.evaluation.intervals import wilson_interval
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import override

WARM_UP = 3
"""Steps of the plant before time counts: what they take is compiled then."""

RESTS = 1e-6
"""Joint speed of a command that rests [rad/s or m/s]."""


@dataclass(frozen=True)
class Measurement:
    """What the controller is told in a control period: joints and speeds `[n]`, and its goal, if that is seen.

    `beside` is what else is measured, by the names of `Controller.step`.
    """

    q: np.ndarray
    qd: np.ndarray
    goal: list[float] | None
    beside: dict[str, Any]


class Link(Protocol):
    """The way between a plant and a controller.

    Attributes:
        problem: what the controller said last is wrong; empty where nothing is, or where that cannot be known.
    """

    problem: str

    def begin(self, q: np.ndarray) -> None:
        """Wait until the controller is ready for an arm that rests at joints `[n]`, and has no goal."""
        ...

    def send(self, measurement: Measurement) -> None:
        """Tell the controller a measurement."""
        ...

    def receive(self) -> list[np.ndarray]:
        """The commands `[n]` that came since the last call, in their order. Never waits."""
        ...


@dataclass
class Outcome:
    """What became of the episodes.

    Attributes:
        episodes, successes: by the task's rules.
        cycles: control periods.
        in_time: those in which a command had come since the one before.
        broken: commands further from the last one that came than the limits of speed allow, or not finite.
        rest_s: longest time from the last measurement to rest, where measurements end [s].
        problems: how often the controller said what.
    """

    episodes: int = 0
    successes: int = 0
    cycles: int = 0
    in_time: int = 0
    broken: int = 0
    rest_s: float | None = None
    problems: Counter[str] = field(default_factory=Counter)

    def to_json(self) -> dict[str, Any]:
        """Plain form."""
        known = {name: one for name, one in vars(self).items() if name != "successes"}
        rate, interval = self.successes / self.episodes, wilson_interval(self.successes, self.episodes)
        return known | {"success_rate": rate, "success_interval": interval, "in_time": self.in_time / self.cycles}


class Plant:
    """One simulated arm on the held-out goals of a seed."""

    def __init__(self, config: RunConfig, seed: int) -> None:
        """Arm of a configuration, which follows every command as it comes."""
        self._env, self._seed = Env(override(config, shaping=False), 1), seed
        self.period, self.steps = config.physics.control_period, config.rules.max_steps
        self.speed = np.array(self._env.setup.robot.commands.speed)
        self._init, self._step = map(self._env.compile_whole, (self._env.init_held_out, self._env.step))
        self._objects = [None] * self._env.setup.task.scene(self._env.setup).objects
        self._idle = np.zeros((1, len(self._env.action_bounds[0])), np.float32)
        self.begin(0)
        for _ in range(WARM_UP):
            self.step(self.q)

    def begin(self, number: int) -> None:
        """Begin the episode of that number."""
        self._state = self._init(episode_keys(self._seed, REPORT_STREAM, number, 1))

    @property
    def q(self) -> np.ndarray:
        """Joints, and the opening of a gripper `[m]`."""
        return self._joined(self._state.arm.q, self._state.arm.opening)

    def step(self, command: np.ndarray) -> tuple[bool, bool]:
        """Move for a control period towards a command `[n]`; whether the episode has ended, and in success."""
        self._state, transition = self._step(self._state, self._idle, instead=np.asarray(command, np.float32)[None])
        return bool(transition.done[0]), bool(transition.terms["success"][0])

    def measure(self) -> Measurement:
        """What is measured and asked for now."""
        state, goal = self._state, self._state.goal
        parts = {"orientation": goal.quaternion.size > 0, "moves": goal.velocity.size > 0}
        beside = step_arguments({"goal": parts, "objects": self._objects}, surroundings(goal, state.arm.bodies)[0])
        place = beside.pop("goal")
        if state.arm.wrench is not None:
            beside["wrench"] = np.asarray(state.arm.wrench, float)[0].tolist()
        qd = self._joined(state.arm.qd, np.zeros(state.arm.opening.shape))
        return Measurement(self.q, qd, place if self._env.goal_seen(state.key, state.clock)[0] else None, beside)

    @staticmethod
    def _joined(joints: Any, opening: Any) -> np.ndarray:
        return np.concatenate([np.asarray(joints, float)[0], np.asarray(opening, float)[0]])

    def close(self) -> None:
        """Close the simulator."""
        self._env.close()


class Disturbed:
    """A link on which measurements come late, damaged or not at all."""

    def __init__(self, link: Link, faults: Faults) -> None:
        """A link with faults, which are the same each time."""
        self._link, self._faults, self._random = link, faults, np.random.default_rng(0)
        self._late: list[tuple[float, int, Measurement]] = []
        self._numbers = itertools.count()

    def send(self, measurement: Measurement, since: float) -> bool:
        """Send a measurement that is made so long [s] after the episode began; whether any can still come."""
        faults, random = self._faults, self._random.random(3)
        if faults.dead_after is not None and since >= faults.dead_after:
            self._late.clear()
            return False
        if random[0] < faults.nan:
            q = measurement.q.copy()
            q[self._random.integers(len(q))] = np.nan
            measurement = replace(measurement, q=q)
        if random[1] >= faults.drop:
            due = time.perf_counter() + faults.delay + random[2] * faults.jitter
            heapq.heappush(self._late, (due, next(self._numbers), measurement))
        self.flush()
        return True

    def flush(self) -> None:
        """Hand over what is due."""
        while self._late and self._late[0][0] <= time.perf_counter():
            self._link.send(heapq.heappop(self._late)[2])

    def clear(self) -> None:
        """Forget what is on its way."""
        self._late.clear()


def drive(plant: Plant, link: Link, faults: Faults, episodes: int) -> Outcome:
    """Play so many episodes in real time, each from home on."""
    outcome, disturbed = Outcome(), Disturbed(link, faults)
    for number in range(episodes):
        plant.begin(number)
        disturbed.clear()
        link.begin(plant.q)
        outcome.successes += _episode(plant, link, disturbed, outcome)
        outcome.episodes += 1
    return outcome


def _episode(plant: Plant, link: Link, disturbed: Disturbed, outcome: Outcome) -> bool:
    """Whether an episode ends in success; its figures are added."""
    command, success, dead, missed = plant.q, False, None, 0
    most = plant.speed * plant.period * (1 + 1e-6)
    began = time.perf_counter()
    for step in range(plant.steps):
        if not disturbed.send(plant.measure(), step * plant.period) and dead is None:
            dead = step
        due = began + (step + 1) * plant.period
        _wait(due, disturbed)
        # After a pause of this process the next steps do not come in a burst.
        began += max(0.0, time.perf_counter() - due - plant.period)
        commands = link.receive()
        outcome.cycles += 1
        outcome.in_time += bool(commands)
        for came in commands:
            # Where a command was lost on its way, the next one is as far from the last as both together may go.
            far = np.abs(came - command) > most * (1 + missed)
            outcome.broken += not bool(np.isfinite(came).all()) or bool(far.any())
            if dead is not None and np.abs(came - command).max() > RESTS * plant.period:
                outcome.rest_s = max(outcome.rest_s or 0.0, (step - dead + 1) * plant.period)
            command, missed = came, 0
        missed += not commands
        if link.problem:
            outcome.problems[link.problem] += 1
        done, success = plant.step(command)
        if done:
            break
    return success


def _wait(end: float, disturbed: Disturbed) -> None:
    """Wait for a moment, and hand over what is due until then."""
    while (left := end - time.perf_counter()) > 0:
        time.sleep(min(left, 0.0005))
        disturbed.flush()
