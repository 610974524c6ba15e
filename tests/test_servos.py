"""Servos of arms whose file has motors: gains follow the arm's inertia, and hold it in MuJoCo."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from reachlab.robots.derive.arm import Arm, find_arm
from reachlab.robots.derive.isolation import apply
from reachlab.robots.derive.servos import (
    LAG,
    LARGEST_SAG,
    NATURAL_FREQUENCY,
    Loads,
    default_torques,
    find_loads,
    payload,
    servos,
    too_heavy,
    too_weak,
)
from reachlab.robots.files.model_file import read_model_file
from reachlab.robots.loading import load_robot
from reachlab.robots.robot import Robot

LIGHT, HEAVY = 1.0, 30.0
"""Masses of arms [kg]."""

STEP, LONGEST, OVERSHOOT, SAG = 0.2, 0.5, 0.1, 0.03
"""Step of the command [rad], time in which the arm has to be there [s], share by which it may go beyond, and what
gravity may displace it by [rad]."""

AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
LENGTHS = (0.1, 0.3, 0.25, 0.05, 0.05, 0.05)
SHARES = (0.3, 0.3, 0.2, 0.08, 0.07, 0.05)
"""Joint axes, lengths [share of a metre] and masses [share of the arm's] of its links."""


def arm_text(mass: float, size: float = 1.0) -> str:
    """An arm of six joints made of capsules, with no actuators."""
    text = '<site name="tcp" pos="0.05 0 0"/>'
    for number in range(5, -1, -1):
        to = "0 0 0.1" if number == 0 else f"{LENGTHS[number] * size} 0 0"
        at = "0 0 0.1" if number <= 1 else f"{LENGTHS[number - 1] * size} 0 0"
        text = (
            f'<body name="link{number}" pos="{at}"><joint name="joint{number}" axis="{AXES[number]}" range="-2.5 2.5"/>'
            f'<geom type="capsule" size="0.02" fromto="0 0 0 {to}" mass="{mass * SHARES[number]}"/>{text}</body>'
        )
    return f'<mujoco><compiler angle="radian"/><worldbody>{text}</worldbody></mujoco>'


@pytest.fixture(scope="module", params=[(LIGHT, 0.6), (HEAVY, 1.2)], ids=["1 kg", "30 kg"])
def robot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.xml").write_text(arm_text(*request.param))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        yield load_robot(str(folder / "arm.xml"))


def simulated(robot: Robot) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The arm at rest at its home, its servos commanded to be there."""
    model = robot.spec().compile()
    model.opt.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data = mujoco.MjData(model)
    data.qpos[:] = robot.home
    data.ctrl[:] = commands(model, np.array(robot.home))
    for _ in range(round(2.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return model, data


def commands(model: mujoco.MjModel, q: np.ndarray) -> np.ndarray:
    """Commands of the servos, in their order, for joints `q`."""
    return q[model.actuator_trnid[:, 0]]


def test_the_arm_hardly_sags_at_home(robot: Robot) -> None:
    model, data = simulated(robot)
    assert np.abs(data.qpos - robot.home).max() < SAG
    assert np.abs(data.qvel).max() < 1e-3
    assert model.opt.gravity[2] < -9


@pytest.mark.parametrize("joint", range(6))
def test_a_step_of_the_command_is_followed_without_much_overshoot(robot: Robot, joint: int) -> None:
    model, data = simulated(robot)
    start, wanted = data.qpos.copy(), np.array(robot.home)
    middle = (robot.chain.lower[joint] + robot.chain.upper[joint]) / 2
    step = STEP if wanted[joint] < middle else -STEP
    wanted[joint] += step
    data.ctrl[:] = commands(model, wanted)
    way = []
    for _ in range(round(LONGEST / model.opt.timestep)):
        mujoco.mj_step(model, data)
        way.append((data.qpos[joint] - start[joint]) / step)
    assert max(way) < 1 + OVERSHOOT
    assert way[-1] == pytest.approx(1.0, abs=0.1)
    others = np.delete(data.qpos - start, joint)
    assert np.abs(others).max() < SAG


def test_torque_that_nobody_states_holds_the_arm_three_times_over(robot: Robot) -> None:
    model, data = simulated(robot)
    random = np.random.default_rng(5)
    hardest = np.zeros(6)
    for _ in range(500):
        data.qpos[:], data.qvel[:] = random.uniform(robot.chain.lower, robot.chain.upper), 0.0
        mujoco.mj_forward(model, data)
        hardest = np.maximum(hardest, np.abs(data.qfrc_bias))
    assert robot.sources["torque"] == ("default",) * 6
    assert (np.array(robot.torque) > 2.5 * hardest).all()
    assert (np.array(robot.torque) > 0.0).all()


def loaded(tmp_path: Path, text: str) -> tuple[Arm, Loads]:
    """An arm, and what its joints have to move and to hold."""
    (tmp_path / "arm.xml").write_text(text)
    arm = find_arm(read_model_file(tmp_path / "arm.xml"), None, None)
    return arm, find_loads(arm.model, arm.tool)


def gains(tmp_path: Path, text: str, torque: float = 1e6, load: float = 0.0) -> np.ndarray:
    """Stiffnesses `[n]`, with as much torque as they take."""
    arm, loads = loaded(tmp_path, text)
    found = servos(loads, np.full(arm.chain.n, torque), load)
    np.testing.assert_allclose([one.damping / one.stiffness for one in found], LAG)
    return np.array([one.stiffness for one in found])


def test_stiffness_is_in_proportion_to_mass(tmp_path: Path) -> None:
    np.testing.assert_allclose(gains(tmp_path, arm_text(30.0)) / gains(tmp_path, arm_text(1.0)), 30.0, rtol=1e-6)


PENDULUM = """<mujoco><compiler angle="radian"/><option gravity="0 0 {gravity}"/><worldbody>
  <body name="tool"><joint name="swing" axis="0 1 0" range="-3 3"/>
  <inertial pos="0.5 0 0" mass="2" diaginertia="0.01 0.01 0.01"/></body></worldbody></mujoco>"""


def test_gains_of_a_pendulum_are_those_computed_by_hand(tmp_path: Path) -> None:
    weightless, heavy = PENDULUM.format(gravity=0), PENDULUM.format(gravity=-9.81)
    inertia = 2 * 0.5**2 + 0.01
    np.testing.assert_allclose(gains(tmp_path, weightless), inertia * NATURAL_FREQUENCY**2, rtol=1e-6)
    np.testing.assert_allclose(gains(tmp_path, heavy), 2 * 9.81 * 0.5 / LARGEST_SAG, rtol=1e-3)
    assert gains(tmp_path, heavy, torque=4.0) == pytest.approx(4.0 / 0.02)
    assert (gains(tmp_path, weightless, load=2.0) == gains(tmp_path, weightless, load=2.0)).all()


WRIST = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="tool"><joint name="turn" axis="0 0 1" range="-9 9" damping="{damping}" frictionloss="{friction}"/>
  <inertial pos="0 0 0" mass="0.2" diaginertia="1e-3 1e-3 1e-3"/></body></worldbody></mujoco>"""
"""A joint that moves next to nothing, against its own damping and friction."""


@pytest.mark.parametrize("friction", [0.0, 1.0])
@pytest.mark.parametrize("damping", [0.0, 0.01, 1.0, 10.0])
def test_a_moving_command_is_followed_in_time_whatever_the_joint_damps(
    tmp_path: Path, damping: float, friction: float
) -> None:
    arm, loads = loaded(tmp_path, WRIST.format(damping=damping, friction=friction))
    torque, speed = np.full(1, 50.0), np.full(1, 2.0)
    assert not too_weak(loads, torque, speed)
    spec = read_model_file(tmp_path / "arm.xml").spec()
    apply(spec, replace(arm.isolation, servos={0: servos(loads, torque, 0.0)[0]}))
    model = spec.compile()
    model.opt.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    data = mujoco.MjData(model)
    for _ in range(round(2.0 / model.opt.timestep)):
        data.ctrl[0] = speed[0] * data.time
        mujoco.mj_step(model, data)
    behind = data.ctrl[0] - data.qpos[0]
    assert speed[0] * LAG == pytest.approx(behind, abs=0.01 + (LARGEST_SAG if friction else 0.0))


def test_a_joint_without_the_torque_for_its_speed_is_found(tmp_path: Path) -> None:
    _, loads = loaded(tmp_path, WRIST.format(damping=3.0, friction=2.0))
    assert too_weak(loads, np.array([9.0]), np.array([2.5])) == {0: pytest.approx(9.5)}
    assert not too_weak(loads, np.array([9.0]), np.array([2.0]))
    assert default_torques(loads, np.array([2.5])) == pytest.approx(9.5 + 0.05)


def test_a_joint_without_the_torque_to_stop_is_found(tmp_path: Path) -> None:
    _, loads = loaded(tmp_path, WRIST.format(damping=0.0, friction=0.0))
    needed = 1e-3 * 2.5 / LAG
    assert too_heavy(loads, np.array([0.7 * needed]), np.array([2.5])) == {0: pytest.approx(needed, rel=0.01)}
    assert not too_heavy(loads, np.array([0.9 * needed]), np.array([2.5]))


def test_payload_and_torque_of_a_pendulum(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(
        PENDULUM.format(gravity=-9.81).replace("</body>", '<body name="tcp" pos="1 0 0"/></body>')
    )
    arm = find_arm(read_model_file(tmp_path / "arm.xml"), "tcp", None)
    loads = find_loads(arm.model, arm.tool)
    holding = 2 * 9.81 * 0.5
    np.testing.assert_allclose(default_torques(loads, np.ones(1)), 3 * holding, rtol=1e-3)
    assert payload(loads, np.array([1e3]), 100.0) == 2.0, "the largest that arms vary by"
    assert payload(loads, np.array([1e3]), 4.0) == pytest.approx(0.4), "a tenth of the arm"
    assert payload(loads, np.array([holding / 2]), 100.0) == pytest.approx(0.0, abs=0.2)
    some = [payload(loads, np.array([torque]), 100.0) for torque in (10.0, 15.0, 20.0)]
    assert some == sorted(some)
