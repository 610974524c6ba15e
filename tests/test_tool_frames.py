"""Which frame of a model is taken for the arm's tool."""

from __future__ import annotations

import mujoco
import pytest

from reachlab.robots.derive.tool import TOOL_NAMES, find_tools, words


def body(name: str, inside: str = "", joint: str | None = None, kind: str = "hinge") -> str:
    moved = "" if joint is None else f'<joint name="{joint}" type="{kind}"/>' if joint else f'<joint type="{kind}"/>'
    return f'<body name="{name}" pos="0.1 0 0">{moved}<geom size="0.01"/>{inside}</body>'


def arm(end: str, joints: int = 4, prefix: str = "") -> str:
    """An arm whose last link holds `end`."""
    for number in range(joints, 0, -1):
        end = body(f"{prefix}link{number}", end, f"{prefix}joint{number}")
    return end


def site(name: str) -> str:
    return f'<site name="{name}"/>'


def compiled(world: str, more: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{world}</worldbody>{more}</mujoco>")


FINGERS = body("left_pad", "", "left_finger", "slide") + body("right_pad", "", "right_finger", "slide")
NAMELESS_FINGERS = body("a", "", "slide_a", "slide") + body("b", "", "slide_b", "slide")

FOUND = {
    "a site named like a tool": (arm(site("camera") + site("attachment_site")), "attachment_site"),
    "a fixed body named like a tool": (arm(body("cover") + body("tool0")), "tool0"),
    "a frame on a body fixed to a fixed body": (arm(body("cover", body("adapter", site("tcp")))), "tcp"),
    "the surest of several names, wherever it stands": (
        arm(site("gripper") + body("flange", body("hand", site("ee_site")))),
        "ee_site",
    ),
    "a site before a body of the same rank": (arm(body("tcp_body", site("tcp_site"))), "tcp_site"),
    "words in any writing": (arm(site("camera") + site("RobotEndEffector")), "RobotEndEffector"),
    "a word inside another is none": (arm(site("feeder") + site("handle")), "link4"),
    "the last moved body without such a name": (arm(body("cover") + site("camera")), "link4"),
    "before a gripper whose joints say so": (arm(body("palm", FINGERS)), "link4"),
    "the hand, not its fingers": (arm(body("hand", FINGERS)), "hand"),
    "before a gripper whose joints do not say so": (arm(body("palm", NAMELESS_FINGERS)), "link4"),
    "before a jaw with one joint that says so": (arm(body("moving", "", "gripper")), "link4"),
    "a frame of the last link but one, if the jaw does not say so": (
        arm(body("moving", "", "joint5") + site("gripper_frame")),
        "gripper_frame",
    ),
    "an arm on a turning base": (body("turret", arm(site("tcp")), "turn"), "tcp"),
    "an arm that floats": ('<body name="float"><freejoint/><geom size="1"/>' + arm(site("tcp")) + "</body>", "tcp"),
    "the arm, not a moving camera": (arm(site("tcp")) + body("mast", body("eye", "", "tilt"), "pan"), "tcp"),
    "a chain shorter than an arm": (arm(site("tip"), joints=2), "link2"),
}


@pytest.mark.parametrize(("world", "name"), FOUND.values(), ids=list(FOUND))
def test_the_tool_is(world: str, name: str) -> None:
    assert find_tools(compiled(world)) == [name]


@pytest.mark.parametrize("rank", range(len(TOOL_NAMES) - 1), ids=TOOL_NAMES.__getitem__)
def test_surer_names_come_first(rank: int) -> None:
    surer, other = (TOOL_NAMES[place].replace(" ", "_") for place in (rank, rank + 1))
    assert find_tools(compiled(arm(site(other) + site(surer)))) == [surer]


def test_of_two_arms_the_longer_is_taken_and_the_other_told() -> None:
    short, long = arm(site("right_tcp"), 4, "right_"), arm(site("left_tcp"), 6, "left_")
    assert find_tools(compiled(body("torso", short + long))) == ["left_tcp", "right_tcp"]
    model = compiled(body("torso", body("right", short) + body("left", long)))
    assert find_tools(model, base=int(model.body("right").id)) == ["right_tcp"]


def test_of_two_equal_arms_the_first_is_taken() -> None:
    arms = arm(site("one_tcp"), 4, "one_") + arm(site("two_tcp"), 4, "two_")
    assert find_tools(compiled(body("torso", arms, "waist"))) == ["one_tcp", "two_tcp"]


def test_joints_that_follow_others_are_a_grippers() -> None:
    model = compiled(arm(body("link5", body("link6", "", "follower"), "driver")))
    assert find_tools(model) == ["link6"]
    assert find_tools(model, mimics=["follower"]) == ["link5"]
    assert find_tools(model, mimics=["driver", "follower"]) == ["link4"]


def test_joints_without_names_move_an_arm() -> None:
    model = compiled(body("a", body("b", body("c", body("tool"), ""), ""), ""))
    assert find_tools(model) == ["tool"]


@pytest.mark.parametrize(
    "world", [body("base"), '<body><joint/><geom size="1"/></body>', arm("", joints=0) + body("lid", "", "gripper")]
)
def test_there_is_no_tool_where_no_named_body_is_moved_by_an_arms_joint(world: str) -> None:
    assert find_tools(compiled(world)) == []


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("Link7_toolPoint", ["link7", "tool", "point"]),
        ("TCP", ["tcp"]),
        ("robot0:grip", ["robot0", "grip"]),
        ("tool0", ["tool0"]),
        ("panda/EEFrame", ["panda", "ee", "frame"]),
        ("", []),
    ],
)
def test_words_of_a_name(name: str, wanted: list[str]) -> None:
    assert words(name) == wanted
