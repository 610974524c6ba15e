"""The verb `robot`: what is known of an arm, and where each figure comes from."""

from __future__ import annotations

import json as jsonlib
import math
import shlex
from typing import TYPE_CHECKING, Any

from reachlab.cli.flags import ShowRobot
from reachlab.cli.preparation import prepare
from reachlab.envs.presets import preset
from reachlab.runs.files import check_place, written
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import override
from reachlab.settings.validation import InputError, choose
from reachlab.tasks import TASKS

if TYPE_CHECKING:
    from reachlab.robots.robot import Robot

LIMITS = ("position", "speed", "torque", "acceleration", "jerk")
"""Limits of a joint."""

MARKS = {"model file": "f", "catalogue": "c", "derived": "d", "default": "*"}
"""Where a figure of the table comes from, in a letter."""

PICTURE_WIDTH, PICTURE_HEIGHT = 960, 720
"""Size of the written picture [pixels]."""

MOST_FRAMES = 12
"""Tool frames that are named to a person."""


def robot(arguments: ShowRobot) -> None:
    """Run `reachlab robot`.

    Raises:
        InputError: no robot is named, it cannot be used, or the picture cannot be written.
    """
    prepare()
    from reachlab.robots.catalogue import ROBOTS

    if not arguments.robot:
        raise InputError(f"robot needs one: name {', '.join(ROBOTS)}, or the path of an MJCF or URDF file.")
    if arguments.task:
        choose("task", arguments.task, TASKS)
    if arguments.out:
        check_place("the picture", arguments.out, (".png",))
    from reachlab.cli.console import note, say
    from reachlab.robots.loading import load_robot

    kind = TASKS[arguments.task].load().task().tool if arguments.task else None
    arm = _arm(arguments)
    shown = load_robot(arguments.robot, arguments.tool, kind=kind, base=arguments.base, packages=arm.package)
    facts = _facts(arguments, arm, shown)
    if arguments.out:
        from PIL import Image

        from reachlab.render.offscreen import portrait

        with written("the picture", arguments.out) as part:
            Image.fromarray(portrait(shown, PICTURE_WIDTH, PICTURE_HEIGHT)).save(part)
    if arguments.json:
        print(jsonlib.dumps(facts))
        return
    _print(facts)
    if arguments.out:
        say(f"Written: {arguments.out}")
    note(f"Next: {facts['next']}")


def _arm(arguments: ShowRobot) -> RunConfig:
    """Settings of a run with the arm that the flags name."""
    named = {name: vars(arguments)[name] for name in ("robot", "tool", "base", "package")}
    return override(preset(arguments.task or "tutorial"), **{name: value for name, value in named.items() if value})


# --- facts ----------------------------------------------------------------------------------------


def _facts(arguments: ShowRobot, arm: RunConfig, robot: Robot) -> dict[str, Any]:
    """Everything that is known, as plain data; figures that are infinite are None."""
    from reachlab.robots.catalogue import ROBOTS
    from reachlab.robots.derive.frame import frame_of
    from reachlab.robots.derive.tool import like_a_tool

    known = ROBOTS.get(arguments.robot or "")
    found = "named like a tool" if like_a_tool(robot.tool) else "the arm's last body"
    boxes = {"workspace": robot.workspace, "goal_box": robot.goal_box}
    return {
        "name": robot.name,
        "file": str(robot.model.file),
        "kind": robot.model.kind,
        "tool": robot.tool,
        "tool_found": "told" if arguments.tool else "catalogue" if known else found,
        "catalogue_tools": dict(known.tools) if known else {},
        "tool_frames": _frames(robot),
        "joints": _joints(robot),
        "gripper": _gripper(arguments, arm, robot),
        "mass": robot.mass,
        "payload": robot.payload,
        "scale": robot.scale,
        "notices": robot.notices,
        "frame": frame_of(robot)._asdict(),
        **{
            name: {"low": low, "high": high, "source": robot.sources[name], "share": robot.shares.get(name)}
            for name, (low, high) in boxes.items()
        },
        "tasks": _tasks(arguments, arm),
        "next": _next(arguments),
    }


def _frames(robot: Robot) -> list[str]:
    """Sites and bodies that all of the arm's joints move, but the tool."""
    model = robot.spec(pictures=False).compile()
    last = {int(model.jnt_bodyid[robot.chain.n - 1])}
    for body in range(1, model.nbody):  # bodies follow those that hold them
        if int(model.body_parentid[body]) in last:
            last.add(body)
    names = [model.site(site).name for site in range(model.nsite) if int(model.site_bodyid[site]) in last]
    names += [model.body(body).name for body in sorted(last)]
    return [str(name) for name in dict.fromkeys(names) if name not in ("", robot.tool)]


def _joints(robot: Robot) -> list[dict[str, Any]]:
    """Each joint's limits [rad or m], servo and home."""
    import numpy as np

    from reachlab.robots.derive.servos import find_loads, largest_inertia
    from reachlab.robots.kinematics.limits import own_servos

    model, chain = robot.spec(pictures=False).compile(), robot.chain
    actuators = own_servos(model)
    inertia = largest_inertia(find_loads(model, robot.tool), robot.payload)
    columns = {"lower": chain.lower, "upper": chain.upper, "home": robot.home, "speed": robot.speed}
    columns |= {"torque": robot.torque, "acceleration": robot.acceleration, "jerk": robot.jerk}
    facts = []
    for joint, name in enumerate(robot.joint_names):
        stiffness, of_servo = model.actuator_gainprm[actuators[joint], 0], model.actuator_biasprm[actuators[joint], 2]
        damping = float(model.dof_damping[model.jnt_dofadr[joint]] - of_servo)
        own = robot.isolation.joints[joint] not in robot.isolation.servos
        sources = {limit: robot.sources[limit][joint] for limit in LIMITS}
        sources |= {"servo": "model file" if own else "derived", "home": robot.sources["home"]}
        numbers = {what: values[joint] for what, values in columns.items()}
        servo = {
            "stiffness": float(stiffness),
            "damping": damping,
            "frequency": float(np.sqrt(stiffness / inertia[joint])),
            "lag": damping / float(stiffness),
        }
        facts.append(
            {"name": name, "type": "slide" if chain.slides[joint] else "hinge"}
            | {what: value if math.isfinite(value) else None for what, value in (numbers | servo).items()}
            | {"sources": sources}
        )
    return facts


def _gripper(arguments: ShowRobot, arm: RunConfig, shown: Robot) -> dict[str, Any]:
    """The gripper that tasks with an object use: joints [rad or m], opening [m], speed, force, and where it grasps."""
    import mujoco

    from reachlab.robots.loading import OWN, load_robot

    robot = load_robot(
        arguments.robot or "", arguments.tool, base=arm.base, packages=arm.package, gripper=OWN, grips=True
    )
    hand, model = robot.gripper, robot.spec(pictures=False).compile()
    assert hand is not None  # noqa: S101  # grips
    first, site = robot.chain.n, model.site(robot.tool)
    return {
        "mounted": robot.model.own is None,
        "joints": [
            {"name": model.joint(first + i).name, "type": kind, "closed": low, "open": high}
            for i, (low, high) in enumerate(zip(hand.closed, hand.open, strict=True))
            for kind in ["slide" if model.jnt_type[first + i] == int(mujoco.mjtJoint.mjJNT_SLIDE) else "hinge"]
        ],
        "widest": hand.widest,
        "speed": hand.speed,
        "force": hand.force,
        "grasp": {"body": model.body(int(site.bodyid[0])).name, "position": site.pos.tolist()},
        "notices": [notice for notice in robot.notices if notice not in shown.notices],
    }


def _tasks(arguments: ShowRobot, arm: RunConfig) -> dict[str, dict[str, Any]]:
    """Requirements of the tasks, in words, and the lengths that follow from its size."""
    from reachlab.envs.setup import make_setup

    tasks = {}
    for name in (arguments.task,) if arguments.task else TASKS:
        named = {"robot": arm.robot, "tool": arm.rules.tool, "base": arm.base, "package": arm.package}
        try:
            setup = make_setup(override(preset(name), **named))
        except InputError as error:
            if arguments.task:
                raise
            tasks[name] = {"refused": str(error)}
            continue
        tasks[name] = {
            "tool": setup.robot.tool,
            "asks": setup.task.asks(setup.rules, setup.period),
            "success_distance": setup.rules.success_distance,
            "tool_scale": setup.rules.tool_scale,
        }
    return tasks


def _next(arguments: ShowRobot) -> str:
    """The command that trains a policy for this arm."""
    words = ["reachlab", "train"]
    for flag in ("robot", "task", "tool", "base"):
        words += [f"--{flag}", value] if (value := vars(arguments)[flag]) else []
    return shlex.join([*words, *(["--package", *arguments.package] if arguments.package else [])])


def _print(facts: dict[str, Any]) -> None:
    from reachlab.cli.console import note, print_table, say
    from reachlab.robots.derive.frame import Frame
    from reachlab.robots.files.picture_files import some

    say(f"{facts['name']}: {facts['kind']}, {facts['file']}")
    tools = facts["catalogue_tools"] if len(facts["catalogue_tools"]) > 1 else {}
    kinds = ", ".join(f"{tool} ({kind})" for kind, tool in tools.items())
    say(f"Tool frame: {facts['tool']} ({facts['tool_found']}){f', of {kinds}' if kinds else ''}.")
    if facts["tool_frames"]:
        say(f"Other frames for --tool: {some(facts['tool_frames'], MOST_FRAMES)}.")
    headings = ("joint", "limits", "speed, ramp", "torque", "stiffness, damping", "frequency, lag", "home")
    print_table("", headings, [_row(joint) for joint in facts["joints"]])
    say(
        "f model file, c catalogue, d derived, * a default: check it. Servos: stiffness [Nm/rad or N/m], damping"
        " [Nm s/rad or N s/m],\nnatural frequency at the largest inertia, and lag behind a moving command. Ramp: to"
        " that speed in shaped commands."
    )
    _print_gripper(facts["gripper"])
    say(f"Moved mass {facts['mass']:.3g} kg; payload up to {facts['payload']:.2g} kg, which is derived.")
    say(f"Places are in {Frame(**facts['frame']).in_words()}.")
    for name, box in (("Workspace", facts["workspace"]), ("Box of goals", facts["goal_box"])):
        share = "" if box["share"] is None else f"; {100 * box['share']:.4g} % of it can be reached"
        say(f"{name}: {_point(box['low'])} to {_point(box['high'])} m, {box['source']}{share}.")
    say(f"Size: {facts['scale']:.3g} times the tutorial's arm, and so are the lengths of its task.")
    for name, task in facts["tasks"].items():
        if "refused" in task:
            say(f"Task {name} is not for it: {task['refused']}")
            continue
        say(f"Task {name}, with {task['tool']}: {task['asks']}.")
        if name == "tutorial":
            say(f"  An action of 1 displaces the tool by {1000 * task['tool_scale']:.3g} mm.")
    for notice in facts["notices"]:
        note(f"Note: {notice}")


def _print_gripper(hand: dict[str, Any]) -> None:
    from reachlab.cli.console import note, say

    kind = "mounted" if hand["mounted"] else "the file's own; --gripper parallel mounts one"
    grasp = f"at {_point(hand['grasp']['position'])} m of {hand['grasp']['body']}"
    force = f"{1000 * hand['speed']:.3g} mm/s, {hand['force']:.3g} N"
    say(f"Gripper, {kind}: opens {1000 * hand['widest']:.3g} mm, {force}, grasps {grasp}.")
    if not hand["mounted"]:
        ways = [f"{joint['name']} {joint['closed']:.3g} to {joint['open']:.3g}" for joint in hand["joints"]]
        say(f"  Its joints, closed to open [rad or m]: {', '.join(ways)}.")
    for notice in hand["notices"]:
        note(f"Note, with the gripper: {notice}")


def _row(joint: dict[str, Any]) -> tuple[str, ...]:
    slide, marks = joint["type"] == "slide", {what: MARKS[source] for what, source in joint["sources"].items()}
    ramp = f"{joint['speed'] / joint['acceleration']:.2g} s {marks['acceleration']}"
    turn, unit, digits = (1.0, " m", 3) if slide else (180 / math.pi, "°", 1)

    def place(value: float) -> str:
        return f"{round(turn * value, digits) + 0.0:.{digits}f}"  # never "-0.0"

    force = "none" if joint["torque"] is None else f"{joint['torque']:.4g} {'N' if slide else 'Nm'}"
    return (
        joint["name"],
        f"{place(joint['lower'])} to {place(joint['upper'])}{unit} {marks['position']}",
        f"{turn * joint['speed']:.3g}{unit}/s {marks['speed']}, in {ramp}",
        f"{force} {marks['torque']}",
        f"{joint['stiffness']:,.4g}, {joint['damping']:,.4g} {marks['servo']}",
        f"{joint['frequency']:.3g} rad/s, {joint['lag']:.2g} s",
        f"{place(joint['home'])}{unit} {marks['home']}",
    )


def _point(corner: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in corner) + ")"
