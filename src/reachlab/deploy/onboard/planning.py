"""The planner of an exported policy: it reads requests, a line of JSON each, and writes its answers.

It is started by the controller beside it, and needs MuJoCo, OMPL and TOPP-RA.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from reachlab.control.motion_limits import MotionLimits
from reachlab.control.planning.arm import Arm
from reachlab.control.planning.following import PATIENCE, PROGRESS, Trajectory, gap, longest_way
from reachlab.control.planning.plans import Plans
from reachlab.deploy.onboard.folder import limits_of, read_folder
from reachlab.deploy.onboard.step import load_step


class Bodies(NamedTuple):
    """Bodies `[K]`, see `collision.geoms_of`."""

    kind: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    size: np.ndarray


class Foresight:
    """Where a policy leads an arm whose joints follow late."""

    def __init__(self, folder: Path, facts: dict[str, Any], arm: Arm, limits: MotionLimits) -> None:
        """Of an exported policy, whose commands are kept within limits."""
        step = load_step(folder)
        self._decide, self._tool, self._inputs = step["decide"], step["tool"], facts["inputs"]
        self._arm, self._limits = arm, limits
        self._near, self._turn = facts["goal"]["success_distance"], facts["goal"].get("success_turn", 0.0)

    def leads(self, plans: Plans, bodies: Bodies, start: np.ndarray, goal: np.ndarray) -> bool:
        """Whether it comes from rest at joints `start [n]` to where the tool is at `goal [n]`, freely and soon.

        Nor does it where it comes no nearer for so long that it would be taken over from.
        """
        there = self._tool(goal.tolist())
        q, qd, motion, way = start, np.zeros_like(start), self._limits.at_rest(start), [start]
        given: dict[str, Any] = {f"bodies_{name}": part.ravel().tolist() for name, part in bodies._asdict().items()}
        given |= {"bodies_velocity": [0.0] * (6 * len(bodies.kind)), "goal_joints": goal.tolist()}
        given |= dict(zip(("goal_position", "goal_quaternion"), there))
        given |= {"last_action": [0.0] * self._inputs["last_action"][0]}
        given |= {"memory": [0.0] * self._inputs.get("memory", [0])[0]}
        nearest, came, patience = np.inf, 0, round(PATIENCE / self._arm.period)
        for step in range(int(longest_way(start, goal, self._arm.speed) / self._arm.period)):
            given |= {"q": q.tolist(), "qd": qd.tolist(), "command": motion.position.tolist()}
            given["last_action"], wanted, *memory = self._decide(**{name: given[name] for name in self._inputs})
            given["memory"] = memory[0] if memory else []
            motion = self._limits.advance(motion, np.array(wanted))
            moved = self._arm.share * (motion.position - q)
            q, qd = q + moved, moved / self._arm.period
            way.append(q)
            distance = gap(self._tool(q.tolist()), there, self._turn)
            if distance < self._near:
                return plans.free(np.array(way), bodies)
            if distance < nearest - PROGRESS:
                nearest, came = distance, step
            elif step - came > patience:  # it would be taken over from
                return False
        return False


class Answers:
    """Answers requests of a controller."""

    def __init__(self, folder: Path) -> None:
        """For the policy in a folder."""
        facts = read_folder(folder)
        known = facts["planner"]
        numbers: dict[str, Any] = {name: np.array(part) for name, part in known["arm"].items()}
        limits = MotionLimits(**limits_of(facts), period=float(numbers["period"]))
        arm = Arm(**numbers).within(limits)
        self._plans = Plans(arm, known["bodies"], turns=known["turns"])
        self._foresight = Foresight(folder, facts, arm, limits)
        self._motion: Trajectory | None = None

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """A `policy` to trust, a motion as `q` and `command`, or nothing; of the last motion, if it still `leads`."""
        rows = {name: np.reshape(numbers, (-1, *SHAPE[name])) for name, numbers in request["bodies"].items()}
        bodies = Bodies(**rows)
        if "step" in request:
            return {"leads": self._motion is not None and self._plans.leads(self._motion, request["step"], bodies)}
        start, goal = np.array(request["start"]), np.array(request["goal"])
        if request["policy"] and self._foresight.leads(self._plans, bodies, start, goal):
            return {"policy": True}
        self._motion = motion = self._plans.plan(bodies, start, goal)
        return {} if motion is None else {"q": motion.q.tolist(), "command": motion.command.tolist()}


SHAPE: dict[str, tuple[int, ...]] = {"kind": (), "position": (3,), "quaternion": (4,), "size": (3,)}
"""Of what a body is made of."""


def main() -> None:
    """Answer what comes on standard input, until it ends."""
    answers = Answers(Path(sys.argv[1]))
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    print(json.dumps({"ready": True}), file=out, flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        print(json.dumps({**answers.answer(request), "number": request["number"]}), file=out, flush=True)


if __name__ == "__main__":
    main()
