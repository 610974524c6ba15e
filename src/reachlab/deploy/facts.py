"""What a controller has to know of a policy, its task and its arm: the content of `policy.json`."""

from __future__ import annotations

from typing import Any

import numpy as np

from reachlab.agents import encoder
from reachlab.agents.policy import OBSERVATION_CLIP, Policy
from reachlab.envs.core import Env
from reachlab.robots import inverse_kinematics
from reachlab.robots.chain import Chain
from reachlab.robots.robot import Robot
from reachlab.settings.json_form import to_json
from reachlab.sims import SIMULATORS
from reachlab.tasks import actions, avoidance, clutter, observations, obstacles, targets
from reachlab.tasks.schema import SIZE, Field
from reachlab.tasks.task import TaskSetup

FORMAT = 1
"""Of `policy.json`."""

CONSTANTS: dict[str, tuple[Any, ...]] = {
    "DAMPING": (inverse_kinematics,),
    "POINT_DAMPING": (inverse_kinematics,),
    "SUGIHARA": (inverse_kinematics,),
    "MAX_SOLVER_STEP": (inverse_kinematics,),
    "LIMIT_PASSES": (inverse_kinematics,),
    "MAX_TURN": (inverse_kinematics,),
    "MAX_JOINT_STEP": (inverse_kinematics,),
    **dict.fromkeys(
        (
            *("TINY", "NEAR_GAIN", "FAR_GAIN", "APPROACH", "TOOL_SPEED", "JOINT_NEAR", "JOINT_FAR", "APPROACH_ANGLE"),
            *("FORESIGHT", "LEAD", "CORRECTION", "CORRECTION_FADE", "POSE_CORRECTION", "CLUTTER_CORRECTION"),
            "MOVING_CORRECTION",
        ),
        (actions,),
    ),
    **dict.fromkeys(("NEAR", "CLOSE", "BASIS"), (observations,)),
    **dict.fromkeys(("STOP", "RATE", "SWEEPS"), (avoidance,)),
    "BISECTIONS": (obstacles,),
    **dict.fromkeys(("STARTS", "ITERATIONS", "POSITION_TOLERANCE", "ANGLE_TOLERANCE"), (targets,)),
    "POINT_ITERATIONS": (clutter, "ITERATIONS"),
    "POINT_NEAR": (clutter, "NEAR"),
    "LONGEST_STEP": (clutter,),
}
"""Constants of training that the controller needs, and the modules that have them, under another name where said."""


def describe(env: Env, policy: Policy) -> dict[str, Any]:
    """All that a controller needs beside the weights of a policy, in plain form."""
    setup, config = env.setup, env.config
    robot, rules = setup.robot, setup.rules
    design = observations.OBSERVATIONS[rules.observation]
    low, high = env.action_bounds
    scale = rules.tool_scale if actions.ACTIONS[rules.action].scale == "tool_scale" else actions.joint_scale(setup)
    return {
        "format": FORMAT,
        "task": config.task,
        "robot": robot.name,
        "control_period": setup.period,
        "real_time": SIMULATORS[config.sim].real_time,
        "joints": joints(robot),
        "goal": _goal(setup),
        "observation": {
            "name": rules.observation,
            "pictured": [SIZE, SIZE] if design.pictured else None,
            "fields": [_field(field) for field in policy.schema.fields],
        },
        "action": {
            "name": rules.action,
            "summary": actions.ACTIONS[rules.action].summary,
            "low": low.tolist(),
            "high": high.tolist(),
            "scale": np.asarray(scale, float).tolist(),
        },
        "network": {
            "clip_actions": rules.clip_actions,
            "observation_clip": OBSERVATION_CLIP,
            "patch": encoder.PATCH,
            "white": encoder.WHITE,
        },
        "arm": {
            **_chain(robot.chain),
            "home": list(robot.home),
            "speed": list(robot.speed),
            "lag": list(setup.lag),
            "held_quaternion": list(robot.held_quaternion),
        },
        "capsules": _capsules(robot) if setup.task.sample_obstacles is not None else None,
        "constants": {name: getattr(home[0], (*home, name)[1]) for name, home in CONSTANTS.items()},
        "settings": to_json(config),
    }


def joints(robot: Robot) -> list[dict[str, Any]]:
    """Names, kinds and limits of an arm's joints, and where each limit is from."""
    kinds = ("position", "speed", "torque", "acceleration", "jerk")
    rows = []
    for i, name in enumerate(robot.joint_names):
        torque = robot.torque[i]
        rows.append(
            {
                "name": name,
                "type": "slide" if robot.chain.slides[i] else "hinge",
                "unit": "m" if robot.chain.slides[i] else "rad",
                "lower": robot.chain.lower[i],
                "upper": robot.chain.upper[i],
                "speed": robot.speed[i],
                "torque": torque if np.isfinite(torque) else None,
                "acceleration": robot.acceleration[i],
                "jerk": robot.jerk[i],
                "sources": {kind: robot.sources[kind][i] for kind in kinds},
            }
        )
    return rows


def _goal(setup: TaskSetup) -> dict[str, Any]:
    rules = setup.rules
    low, high = setup.task.goal_box(setup)
    obstructed = setup.task.sample_obstacles is not None
    return {
        "low": low.tolist(),
        "high": high.tolist(),
        "frame": "base",
        "unit": "m; quaternion wxyz",
        "tool": setup.robot.tool,
        "orientation": rules.asks_orientation,
        "moves": setup.task.move is not None,
        "fastest": observations.FASTEST * rules.goal_speed[1],
        "joints": rules.asks_orientation or obstructed,
        "angle_weight": rules.angle_weight,
        "success_distance": rules.success_distance,
        "asks": setup.task.asks(rules, setup.period),
    }


def _field(field: Field) -> dict[str, Any]:
    return {
        "name": field.name,
        "unit": field.unit,
        "shape": list(field.shape),
        "low": list(field.low),
        "high": list(field.high),
        "picture": field.picture,
    }


def _chain(chain: Chain) -> dict[str, Any]:
    frames = []
    for rotation, offset in chain.frames:
        transform = np.eye(4)
        transform[:3, :3], transform[:3, 3] = np.array(rotation).T, offset
        frames.append(transform.tolist())
    return {
        "frames": frames,
        "slides": list(chain.slides),
        "lower": list(chain.lower),
        "upper": list(chain.upper),
        "approach": list(chain.approach),
    }


def link_capsules(robot: Robot) -> dict[str, Any]:
    """All capsules of an arm, by link, and which pairs of them may not meet; a floor as in `_capsules`."""
    capsules, floors = robot.capsules, iter(robot.floors)
    heights = [next(floors) if link else -np.inf for link in capsules.links]
    return {
        "links": list(capsules.links),
        "starts": [list(start) for start in capsules.starts],
        "ends": [list(end) for end in capsules.ends],
        "radii": list(capsules.radii),
        "floors": [floor if np.isfinite(floor) else None for floor in heights],
        "pairs": [list(pair) for pair in capsules.pairs],
    }


def _capsules(robot: Robot) -> dict[str, Any]:
    """The capsules that joints move; a floor of None is one that nothing is above."""
    capsules = robot.capsules
    rows = [row for row, link in enumerate(capsules.links) if link]
    return {
        "links": [capsules.links[row] for row in rows],
        "starts": [list(capsules.starts[row]) for row in rows],
        "ends": [list(capsules.ends[row]) for row in rows],
        "radii": [capsules.radii[row] for row in rows],
        "floors": [floor if np.isfinite(floor) else None for floor in robot.floors],
        "scale": robot.scale,
        "goal_box": [list(corner) for corner in robot.goal_box],
    }
