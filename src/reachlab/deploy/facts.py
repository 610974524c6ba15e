"""What a controller has to know of a policy, its task and its arm: the content of `policy.json`."""

from __future__ import annotations

from typing import Any

import numpy as np

from reachlab.agents import encoder
from reachlab.agents.policy import OBSERVATION_CLIP, Policy
from reachlab.deploy.onboard.deciding import COMMANDED, OBSERVED
from reachlab.deploy.onboard.folder import FORMAT, LIMITS
from reachlab.envs.core import Env
from reachlab.robots import inverse_kinematics
from reachlab.robots.chain import Chain
from reachlab.robots.robot import Robot
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import to_json
from reachlab.settings.validation import InputError
from reachlab.sims import SIMULATORS
from reachlab.tasks import actions, avoidance, clutter, observations, obstacles, targets
from reachlab.tasks.schema import SIZE, Field
from reachlab.tasks.task import TaskSetup

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


TERMS = (*observations.POSE, *observations.TRACK, *observations.CLUTTER, *observations.ACHIEVED_AND_DESIRED)
TERMS += (observations.IMAGE,)
"""Terms that the controller knows. Observations that users add may have others, also under the same names."""


def refuse_unknown(config: RunConfig) -> None:
    """Refuse settings with an observation or an action that the controller does not know.

    Raises:
        InputError: they have one.
    """
    observation, action = config.rules.observation, config.rules.action
    terms = observations.OBSERVATIONS[observation].terms
    if unknown := [term.name for term in terms if term not in TERMS]:
        raise InputError(
            f"observation {observation!r} cannot be exported: its term {unknown[0]!r} is not one of reachlab's, which"
            f" alone the controller computes. They are: {', '.join(OBSERVED)}."
        )
    if actions.ACTIONS[action] is not actions.OWN.get(action):
        raise InputError(
            f"action {action!r} cannot be exported: it is not one of reachlab's, which alone the controller commands."
            f" They are: {', '.join(COMMANDED)}."
        )


def describe(env: Env, policy: Policy) -> dict[str, Any]:
    """All that a controller needs beside the weights of a policy, in plain form."""
    setup, config = env.setup, env.config
    robot, rules = setup.robot, setup.rules
    design = observations.OBSERVATIONS[rules.observation]
    low, high = env.action_bounds
    rows = joints(robot)
    scale = rules.tool_scale if actions.ACTIONS[rules.action].scale == "tool_scale" else actions.joint_scale(setup)
    return {
        "format": FORMAT,
        "limits": {joint["name"]: dict(joint["widest"]) for joint in rows},
        "task": config.task,
        "robot": robot.name,
        "control_period": setup.period,
        "real_time": SIMULATORS[config.sim].real_time,
        "joints": rows,
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
            "lag": list(setup.lag),
            "held_quaternion": list(robot.held_quaternion),
        },
        "capsules": _capsules(robot) if setup.task.sample_obstacles is not None else None,
        "constants": {name: getattr(home[0], (*home, name)[1]) for name, home in CONSTANTS.items()},
        "settings": to_json(config),
    }


def joints(robot: Robot) -> list[dict[str, Any]]:
    """Names, kinds and widest limits of an arm's joints, and where each limit is from."""
    kinds = ("position", "speed", "torque", "acceleration", "jerk")
    limits = (robot.chain.lower, robot.chain.upper, robot.speed, robot.acceleration, robot.jerk)
    rows = []
    for i, name in enumerate(robot.joint_names):
        torque = robot.torque[i]
        rows.append(
            {
                "name": name,
                "type": "slide" if robot.chain.slides[i] else "hinge",
                "unit": "m" if robot.chain.slides[i] else "rad",
                "widest": dict(zip(LIMITS, (part[i] for part in limits), strict=True)),
                "torque": torque if np.isfinite(torque) else None,
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
