"""The model in a live page: read from its text and arrays, it moves as that of training does."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from faults.robot_parts import stl
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.settings.validation import InputError
from reachlab.sims.mujoco import MujocoSimulator
from reachlab.watch.page.physics import engine_of

AXES = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
"""Of the joints of an arm whose masses follow from its meshes."""


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its file."""
    folder = tmp_path_factory.mktemp("meshes")
    (folder / "link.stl").write_bytes(stl())
    links = "".join(
        f'<body name="link_{i}" pos="0 0 {0.1 if i == 0 else 0.2}"><joint name="joint_{i}" axis="{axis}"'
        ' range="-2.5 2.5"/><geom type="mesh" mesh="link" density="300"/>'
        for i, axis in enumerate(AXES)
    )
    (folder / "arm.xml").write_text(
        '<mujoco model="meshes"><compiler angle="radian"/>'
        '<asset><mesh name="link" file="link.stl" scale="0.1 0.1 0.2"/></asset>'
        f'<worldbody><body name="base">{links}<site name="tool" pos="0 0 0.2"/>{"</body>" * len(AXES)}</body>'
        "</worldbody></mujoco>"
    )
    return folder / "arm.xml"


@pytest.mark.parametrize(("task", "robot"), [("push", "so101"), ("lift", "panda"), ("clutter", "meshes")])
def test_the_model_of_a_page_moves_as_that_of_training(task: str, robot: str, request: pytest.FixtureRequest) -> None:
    arm = str(request.getfixturevalue(robot)) if robot == "meshes" else robot
    env = Env(configure(task, robot=arm, randomise=()), 1)
    env.init(env_keys(0, 1))
    facts, exact = engine_of(env)
    assert facts
    assert isinstance(env.simulator, MujocoSimulator)
    read, ours = mujoco.MjModel.from_xml_string(facts["xml"]), env.simulator.model()
    for name, values in exact.items():
        owner, field = (read.opt, name[4:]) if name.startswith("opt.") else (read, name)
        getattr(owner, field)[:] = values
    read.geom_type[facts["layout"]["fixed"]] = ours.geom_type[facts["layout"]["fixed"]]
    ways = []
    for model in (read, ours):
        data, home = mujoco.MjData(model), np.array(env.setup.robot.home)
        data.qpos[facts["layout"]["joints"]], data.ctrl[facts["layout"]["servos"]] = home, home + 0.2
        for k, place in enumerate(facts["layout"]["objects"]):
            data.qpos[place] = [0.4, 0.0, env.setup.robot.table_top + 0.05, 1.0, 0.0, 0.0, 0.0][k]
        for _ in range(200):
            mujoco.mj_step(model, data)
        ways.append(np.concatenate([data.qpos, data.qvel]))
    assert np.array_equal(*ways)
    assert np.abs(ways[0]).max() > 0.1
    assert "mesh" not in facts["xml"].replace('model="meshes"', "")
    env.close()


def test_an_arm_without_dynamics_has_no_engine_and_meshes_that_collide_are_refused() -> None:
    assert engine_of(Env(configure("tutorial"), 1)) == (None, {})
    with pytest.raises(InputError, match="a page does not hold the meshes that collide with the table"):
        engine_of(Env(configure("precise", collisions=True), 1))
