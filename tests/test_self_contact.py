"""Links that meet are told by their exact shapes: capsules, which are thicker, only say where to look."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import jax
import numpy as np
import pytest

from reachlab.evaluation.self_contact import make_meets
from reachlab.robots.derive.arm import find_arm
from reachlab.robots.files.model_file import read_model_file
from reachlab.robots.loading import load_robot
from reachlab.robots.robot import Robot

CYLINDER, BOX = '<cylinder radius="{}" length="{}"/>', '<box size="{} {} {}"/>'
LINKS = (
    (CYLINDER.format(0.06, 0.1), "0 0 0.05"),
    (CYLINDER.format(0.05, 0.2), "0 0 0.1"),
    (BOX.format(0.3, 0.06, 0.06), "0.15 0 0"),
    (BOX.format(0.3, 0.1, 0.1), "0.15 0 0"),
    (CYLINDER.format(0.02, 0.1), "0.05 0 0"),
    (CYLINDER.format(0.02, 0.06), "0 0.03 0"),
    (BOX.format(0.03, 0.03, 0.03), "0.02 0.03 0"),
)
"""Shape and middle of each link: base, shoulder, upper arm, forearm, three of the wrist."""

JOINTS = (
    ("0 0 0.1", "0 0 1"),
    ("0 0 0.25", "0 1 0"),
    ("0.34 0 0", "0 1 0"),
    ("0.3 0.045 0", "0 1 0"),
    ("0.24 0 0", "1 0 0"),
    ("0.03 0 0", "0 1 0"),
)
"""Place and axis of each joint: the wrist folds back beside the forearm, and turns about itself."""

STRAIGHT, BESIDE, INSIDE = [0.0, 0, 0, 0, 0, 0], [0.0, 0, 0, 3.1, 0, 0], [0.0, 0, 0, 3.1, 3.1, 0]
"""Joints at which the wrist is ahead of the forearm, beside it, and inside it [rad]."""


def boxes_and_cylinders() -> str:
    """URDF of an arm of six joints."""
    text = '<robot name="plain">'
    for number, (shape, middle) in enumerate(LINKS):
        solid = f'<origin xyz="{middle}"/><geometry>{shape}</geometry>'
        text += (
            f'<link name="link{number}"><inertial><mass value="1"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0"'
            f' ixz="0" iyz="0"/></inertial><visual>{solid}</visual><collision>{solid}</collision></link>'
        )
    for number, (place, axis) in enumerate(JOINTS):
        text += (
            f'<joint name="joint{number}" type="revolute"><parent link="link{number}"/><child link="link{number + 1}"/>'
            f'<origin xyz="{place}"/><axis xyz="{axis}"/><limit lower="-3.14" upper="3.14" effort="100" velocity="2"/>'
            "</joint>"
        )
    return f"{text}</robot>"


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """The arm, without a home and a workspace of its own."""
    path = tmp_path_factory.mktemp("arm") / "plain.urdf"
    path.write_text(boxes_and_cylinders())
    file = read_model_file(path)
    arm = find_arm(file, None, None)
    return replace(
        load_robot("ur5e"),
        model=file,
        tool=arm.tool,
        joint_names=arm.names,
        chain=arm.chain,
        isolation=arm.isolation,
        home=tuple(STRAIGHT),
    )


def test_links_meet_where_their_shapes_do_and_not_where_their_capsules_do(robot: Robot) -> None:
    setup, config = SimpleNamespace(robot=robot), SimpleNamespace(sim="mujoco")
    env: Any = SimpleNamespace(setup=setup, config=config, compile_part=lambda function, *_: jax.jit(function))
    meets = make_meets(env)
    assert meets is not None
    q = np.array([STRAIGHT, BESIDE, INSIDE, INSIDE], np.float32)
    told = meets(cast("Any", q), np.array([True, True, True, False]))
    assert told.tolist() == [False, False, True, False]
