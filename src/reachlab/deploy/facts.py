"""What a controller has to know of a policy, its task and its arm: the content of `policy.json`."""

from __future__ import annotations

from typing import Any

import numpy as np

from reachlab.agents.policy import Policy
from reachlab.deploy.onboard.folder import FORMAT, LIMITS
from reachlab.emit.behaviour import BODIES, Behaviour
from reachlab.envs.core import Env
from reachlab.robots.derive.frame import frame_of
from reachlab.robots.robot import CATALOGUE, DERIVED, GRIPPER, Robot
from reachlab.settings.json_form import to_json
from reachlab.sims.mujoco import LEAST_LAG, MOST_LAG
from reachlab.tasks import actions, observations, terms
from reachlab.tasks.schema import SIZE
from reachlab.tasks.task import TaskSetup

FIELD = ("name", "unit", "shape", "low", "high", "picture")
"""What is said of a field of the observation."""


def describe(env: Env, policy: Policy, step: Behaviour) -> dict[str, Any]:
    """All that a controller needs beside the weights of a policy, in plain form."""
    setup, config = env.setup, env.config
    robot, rules = setup.robot, setup.rules
    design = observations.OBSERVATIONS[rules.observation]
    low, high = env.action_bounds
    rows, scene = joints(robot), setup.task.scene(setup)
    return {
        "format": FORMAT,
        "limits": {joint["name"]: dict(joint["widest"]) for joint in rows},
        "task": config.task,
        "robot": robot.name,
        "control_period": setup.period,
        "real_time": max(setup.lag) > 0,
        "joints": rows,
        "inputs": step.inputs,
        "objects": [int(scene.shape)] * scene.objects * (BODIES + "kind" in step.inputs),
        "object_size": list(scene.size),
        "object_velocity": scene.objects > 0 and step.decide.reads(BODIES + "velocity"),
        "obstacle_velocity": scene.moved > 0 and step.decide.reads(BODIES + "velocity"),
        "goal": _goal(setup)
        | {"placed": [one.name.removeprefix("placed_") for one in step.place.outputs] if step.place else []},
        "observation": {
            "name": rules.observation,
            "pictured": [SIZE, SIZE] if design.pictured else None,
            "fields": [{name: getattr(field, name) for name in FIELD} for field in policy.schema.fields],
        },
        "action": {
            "name": rules.action,
            "summary": actions.ACTIONS[rules.action].summary,
            "low": low.tolist(),
            "high": high.tolist(),
        },
        "judge": step.judge
        and {
            "inputs": [one.name for one in step.judge.inputs],
            "outputs": [one.name for one in step.judge.outputs],
            "begun": step.begun,
        },
        "arm": {
            "home": list(robot.at_home),
            "lag": [*setup.lag, *[0.0] * (len(rows) - robot.chain.n)],
            "lag_range": [LEAST_LAG, MOST_LAG] if "lag" in config.randomise else [1.0, 1.0],
            "held_quaternion": list(robot.held_quaternion),
        },
        "settings": to_json(config),
    } | ({"wrench": _wrench(robot)} if rules.wrench else {})


def joints(robot: Robot) -> list[dict[str, Any]]:
    """Names, kinds and widest limits of an arm's joints and of its gripper, and where each limit is from."""
    kinds = ("position", "speed", "torque", "acceleration", "jerk")
    rows = []
    for i, name in enumerate(robot.joint_names):
        torque = robot.torque[i]
        rows.append(
            {
                "name": name,
                "type": "slide" if robot.chain.slides[i] else "hinge",
                "unit": "m" if robot.chain.slides[i] else "rad",
                "widest": dict(zip(LIMITS, (part[i] for part in robot.commands), strict=True)),
                "torque": torque if np.isfinite(torque) else None,
                "sources": {kind: robot.sources[kind][i] for kind in kinds},
            }
        )
    if robot.gripper:
        widest = dict(zip(LIMITS, (part[-1] for part in robot.commands), strict=True))
        sources = dict.fromkeys(kinds, DERIVED if robot.model.own else CATALOGUE)
        hand = {"name": GRIPPER, "type": "opening", "unit": "m", "widest": widest, "torque": robot.gripper.force}
        rows.append(hand | {"sources": sources})
    return rows


def _wrench(robot: Robot) -> dict[str, Any]:
    spec = robot.spec(pictures=False)  # which its parts do not keep alive
    return {
        "frame": spec.joints[robot.chain.n - 1].parent.name,
        "unit": "N; Nm",
        "sign": "what the last joint holds acts on the arm",
    }


def _goal(setup: TaskSetup) -> dict[str, Any]:
    rules = setup.rules
    low, high = setup.task.goal_box(setup)
    frame = frame_of(setup.robot)
    return {
        "low": low.tolist(),
        "high": high.tolist(),
        "frame": frame.name,
        "base": frame._asdict(),
        "unit": "m; quaternion wxyz",
        "tool": setup.robot.tool,
        "orientation": rules.asks_orientation,
        "moves": rules.moves,
        "fastest": terms.FASTEST * rules.goal_speed[1] if rules.moves else 0.0,
        "joints": "joints" in rules.gives,
        "hidden": rules.hides_goal,
        "success_distance": rules.success_distance,
        "success_turn": rules.success_distance / rules.success_angle if rules.asks_orientation else 0.0,
        "asks": setup.task.asks(rules, setup.period),
    }
