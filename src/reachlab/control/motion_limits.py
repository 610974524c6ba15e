"""Joint commands within limits of position, speed, acceleration and jerk, from which the arm can always stop in time.

Everything here is plain arrays, of NumPy or, with `xp=jax.numpy`, of JAX: environments shape a batch of commands with
it in training, and a controller shapes those of one arm.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

Numbers = Any
"""An array, in JAX or NumPy."""

STOP_TIME = 0.18
"""Time in which an arm can come to rest from any motion that is commanded [s]."""

LONG, SMALL = 5, 1e-9
"""A motion that is told to stay rests after so many times that, or below so small a speed [rad/s or m/s]."""

INSIDE = 1.0 - 1e-9
"""Share of the limits that is used: what is left over is for rounding."""


class Motion(NamedTuple):
    """The motion that has been commanded, `[..., n]` each: its position, speed and acceleration after the last command.

    And the way to stop that is known to keep all limits: it begins with a speed and an acceleration, and so many of its
    steps have been taken.
    """

    position: Numbers
    speed: Numbers
    acceleration: Numbers
    stop_speed: Numbers
    stop_acceleration: Numbers
    stop_step: Numbers


class MotionLimits:
    """Limits of an arm's joints, and how commands are kept within them.

    Speed, acceleration and jerk are the differences of commands that are one control period apart. Each next command is
    chosen so that a way to stop from there, in `STOP_TIME` and within all limits, is known too. Where no command like
    that is found, the next step of the way that was known before is taken: limits are never left.

    The way to stop is linear in speed and acceleration: of all sequences of accelerations that end at rest the one with
    the least sum of squares of `acceleration / its limit` and `jerk / its limit`. All limits along it are then
    intervals of the next acceleration, and the commands that are allowed are their intersection.
    """

    def __init__(
        self, lower: Numbers, upper: Numbers, speed: Numbers, acceleration: Numbers, jerk: Numbers, period: float
    ) -> None:
        """Limits `[n]` [rad or m, and per s, s² and s³] of commands that are a `period` [s] apart."""
        lower, upper = np.asarray(lower, float), np.asarray(upper, float)
        self.lower, self.upper = lower, upper
        self.period, self.steps = period, max(int(STOP_TIME / period + 1e-6), 3)
        self.speed, self.jerk = INSIDE * np.asarray(speed, float), INSIDE * np.asarray(jerk, float)
        self.acceleration = INSIDE * np.asarray(acceleration, float)
        self.middle, self.n, self.joints = (lower + upper) / 2, len(lower), np.arange(len(lower))
        ramps = self.acceleration / (self.jerk * period)
        # Of a stop that begins with a speed of 1, and with an acceleration of 1, `[steps + 1, n]`; at its end nothing.
        ways = np.stack([_ways_to_stop(self.steps, period, ramp) for ramp in ramps], axis=-1)
        self.from_speed, self.from_acceleration = ways[:, 0], ways[:, 1]
        self._set_rows(INSIDE * (upper - lower) / 2)

    def _set_rows(self, play: np.ndarray) -> None:
        """Write every limit as an interval of the next acceleration, `[rows, n]`.

        Its middle is `by_speed · speed + by_place · (middle - position)`, and `half` of its width follows.
        """
        period, first = self.period, np.ones((1, self.n))
        # What the next speed and acceleration, in this order, come to in each step from then on.
        speeds, accelerations = [], []
        for start, way in ((1.0, self.from_speed), (0.0, self.from_acceleration)):
            acceleration = np.concatenate([(1.0 - start) * first, way[:-1]])
            accelerations.append(acceleration)
            speeds.append(start + period * (np.cumsum(acceleration, axis=0) - acceleration[:1]))
        jerks = [np.diff(acceleration, axis=0) / period for acceleration in accelerations]
        places = [period * (np.cumsum(speed, axis=0) - speed[:1]) for speed in speeds]
        kinds = ((speeds, self.speed, 0.0), (accelerations, self.acceleration, 0.0), (jerks, self.jerk, 0.0))
        rows = [(*(np.asarray(part) for part in parts), limit, share) for parts, limit, share in kinds]
        rows.append((places[0] + period, places[1], play, 1.0))  # the next speed is one of the period before
        by_speed, by_place, half = [], [], []
        for of_speed, of_acceleration, limit, share in rows:
            slope = of_speed * period + of_acceleration
            slope = np.where(np.abs(slope) < 1e-12, 1e-12, slope)
            by_speed.append(-of_speed / slope)
            by_place.append(np.broadcast_to(share / slope, slope.shape))
            half.append(np.abs(limit / slope))
        self.by_speed, self.by_place, self.half = map(np.concatenate, (by_speed, by_place, half))

    @property
    def fastest(self) -> np.ndarray:
        """Speeds `[n]` of steady motions [rad/s or m/s]: an arm can come to rest from them within all limits."""
        way = np.concatenate([np.zeros((1, self.n)), self.from_speed])
        hardest, jerk = np.abs(way).max(axis=0), np.abs(np.diff(way, axis=0)).max(axis=0) / self.period
        return np.minimum(self.speed, np.minimum(self.acceleration / hardest, self.jerk / jerk))

    def at_rest(self, q: Numbers, xp: Any = np) -> Motion:
        """The motion of an arm that rests at joints `q [..., n]`."""
        still = xp.zeros_like(q)
        return Motion(q, still, still, still, still, xp.full(q.shape, self.steps))

    def rest(self, motion: Motion) -> np.ndarray:
        """Joints `[n]` at which a motion comes to rest that is told in each step to stay where it is."""
        for _ in range(LONG * self.steps):
            if not (np.abs(motion.speed) > SMALL).any():
                break
            motion = self.advance(motion, motion.position)
        return motion.position

    def advance(self, motion: Motion, wanted: Numbers, brake: Numbers = False, xp: Any = np) -> Motion:
        """The motion after the next command, which is as near to `wanted [..., n]` as the limits allow.

        Where it is to `brake [...]`, it takes the next step of the way to stop.
        """
        period, speed, before = self.period, motion.speed, motion.acceleration
        place = (self.middle - motion.position)[..., None, :]
        middles = self.by_speed * speed[..., None, :] + self.by_place * place
        reach = self.jerk * period
        least = xp.maximum((middles - self.half).max(axis=-2), before - reach)
        most = xp.minimum((middles + self.half).min(axis=-2), before + reach)
        stop = xp.asarray(self.from_speed), xp.asarray(self.from_acceleration)
        place, joints = motion.stop_step, self.joints
        known = stop[0][place, joints] * motion.stop_speed + stop[1][place, joints] * motion.stop_acceleration
        free = (least <= most) & ~xp.asarray(brake)[..., None]
        towards = xp.minimum(xp.maximum(self._towards(motion, wanted, xp), least), most)  # NumPy's clip takes longer
        acceleration = xp.where(free, towards, known)
        speed = speed + period * acceleration
        return Motion(
            motion.position + period * speed,
            speed,
            acceleration,
            xp.where(free, speed, motion.stop_speed),
            xp.where(free, acceleration, motion.stop_acceleration),
            xp.where(free, 0, xp.minimum(place + 1, self.steps)),
        )

    def _towards(self, motion: Motion, wanted: Numbers, xp: Any) -> Numbers:
        """Acceleration `[..., n]` towards the speed that brings the command to `wanted`.

        It is what the next step takes or, where that is more, what the jerk can still bring back to nothing by then.
        """
        period, ramp = self.period, self.jerk * self.period / 2
        missing = xp.minimum(xp.maximum((wanted - motion.position) / period, -self.speed), self.speed) - motion.speed
        size = xp.abs(missing)
        bounded = xp.minimum(size / period, xp.sqrt(ramp**2 + 2 * self.jerk * size) - ramp)
        return xp.sign(missing) * bounded


def _ways_to_stop(steps: int, period: float, ramp: float) -> np.ndarray:
    """Accelerations `[steps + 1, 2]` that bring a speed of 1, and an acceleration of 1, to rest in so many steps.

    The limit of acceleration is `ramp` times what the jerk's limit changes it by in a step. The last but one is already
    zero, so that the jerk to it is within what is counted.
    """
    free = steps - 1
    differences = np.eye(steps, free) - np.eye(steps, free, -1)
    system = np.zeros((free + 1, free + 1))
    system[:free, :free] = np.eye(free) + ramp**2 * differences.T @ differences
    system[:free, free] = system[free, :free] = 1.0
    right = np.zeros((free + 1, 2))
    right[free, 0], right[0, 1] = -1.0 / period, ramp**2
    return np.concatenate([np.linalg.solve(system, right)[:free], np.zeros((2, 2))])
