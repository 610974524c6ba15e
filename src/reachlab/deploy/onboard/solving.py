"""Joints of a goal, found a few steps of a solver at a time, so that no control step waits for them."""

from __future__ import annotations

import numpy as np

from reachlab.deploy.onboard.arm import Arm


class Solver:
    """Looks for joints at which the tool is at a goal.

    Of a pose the nearest of ten solutions; of a point the one next to home.

    Attributes:
        joints: those that were found `[n]`; None as long as, or where, none are.
        ended: it has ended.
    """

    def __init__(self, arm: Arm, position: np.ndarray, rotation: np.ndarray | None, near: np.ndarray) -> None:
        """For a position `[3]` m and an orientation `[3, 3]`, or any, next to joints `[n]`."""
        self._arm, self._position, self._rotation, self._near = arm, position, rotation, near
        self.joints: np.ndarray | None = None
        self.ended, self._steps = False, 0
        self._q = arm.home.copy()
        if rotation is not None:
            random = np.random.default_rng(0).uniform(arm.lower, arm.upper, (int(arm.constants["STARTS"]), arm.n))
            self._q = np.concatenate([near[None], arm.home[None], random])

    def advance(self, steps: int) -> None:
        """Take so many steps of the solver."""
        for _ in range(steps):
            if not self.ended:
                self._steps += 1
                (self._step_to_point if self._rotation is None else self._step_to_pose)()

    def _step_to_point(self) -> None:
        arm, k = self._arm, self._arm.constants
        frames = arm.frames(self._q)
        way = self._position - frames.position
        distance = np.sqrt(way @ way)
        if self._steps > k["POINT_ITERATIONS"]:
            self.joints, self.ended = (self._q if distance < k["POINT_NEAR"] else None), True
            return
        self._q = self._q + arm.point_step(
            frames, self._q, way * min(k["LONGEST_STEP"] / (distance + k["POINT_NEAR"]), 1.0)
        )

    def _step_to_pose(self) -> None:
        arm, k = self._arm, self._arm.constants
        frames = arm.frames(self._q)
        turn, columns = arm.turn_to(frames, np.asarray(self._rotation))
        error = np.concatenate([self._position - frames.position, turn], axis=-1)
        distance, angle = (np.sqrt((part**2).sum(axis=-1)) for part in (error[:, :3], turn))
        reached = (distance <= k["POSITION_TOLERANCE"]) & (angle <= k["ANGLE_TOLERANCE"])
        if reached.all() or self._steps > k["ITERATIONS"]:
            self._choose(reached)
            return
        damping = k["DAMPING"] + k["SUGIHARA"] * (distance**2 + angle**2)
        moved = arm.bounded_step(self._q, columns, error, damping, k["MAX_SOLVER_STEP"])
        self._q = np.where(reached[:, None], self._q, moved)

    def _choose(self, reached: np.ndarray) -> None:
        """Take the solution that is soonest reached; a hinge with more than a turn of play may be a turn away."""
        self.ended, arm = True, self._arm
        turns = np.where(arm.slides, 0.0, 2 * np.pi)
        back = self._q - turns * np.round((self._q - self._near) / (2 * np.pi))
        q = np.where((back >= arm.lower) & (back <= arm.upper), back, self._q)
        duration = np.where(reached, (np.abs(q - self._near) / arm.speed).max(axis=-1), np.inf)
        if reached.any():
            self.joints = q[duration.argmin()]
