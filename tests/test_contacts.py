"""Bodies and contacts in MuJoCo, checked against distances computed apart from it."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest

from params import tried
from reachlab.control.bodies import FAR, Bodies, absent
from reachlab.control.contact_model import shapes_of
from reachlab.control.planning.collision import CAPSULE
from reachlab.control.situation import Situation
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvFunctions
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.robots.files.model_file import read_model_file
from reachlab.robots.loading import load_robot
from reachlab.robots.robot import Robot
from reachlab.robots.shapes.clearance import capsules_at
from reachlab.settings.validation import InputError
from reachlab.sims.mujoco_model import physics_model
from reachlab.sims.simulator import Moved, SimState, Simulator, make_simulator
from reachlab.tasks.task import Scene
from situations import begin as episodes
from situations import swept
from test_capsules import ARMS, FOLDED, ROUNDING, joints

PHYSICS = configure("precise").physics
COUNT = 3
"""Bodies around each arm."""

NEAR = 1e-3
"""Distance within which the engine may tell either [m]."""


def simulator(robot: Robot, num_envs: int, count: int = COUNT, randomise: Sequence[str] = ()) -> Simulator:
    """MuJoCo with obstacles around each arm."""
    scene = Scene(count, contacts=count > 0)
    return make_simulator("mujoco", robot, PHYSICS, num_envs, randomise=randomise, scene=scene)


def begin(sim: Simulator, q: np.ndarray, obstacles: Bodies | None = None, count: int = COUNT) -> SimState:
    """State of all arms at `q [B, n]` among obstacles."""
    bodies = absent(len(q), count) if obstacles is None else obstacles
    return sim.reset(None, episodes(np.asarray(q, np.float32), bodies=bodies), None)


def touching(state: SimState | Moved) -> np.ndarray:
    """Whether each arm touches something `[B]`."""
    return np.asarray(state.contact)


def bits(state: SimState | Moved) -> np.ndarray:
    """All that the engine knows of each arm `[B, m]`."""
    return np.asarray(state.engine)


def at_home(robot: Robot, num_envs: int) -> np.ndarray:
    """Joints `[B, n]` of arms at home."""
    return np.tile(np.array(robot.home, np.float32), (num_envs, 1))


def scene(num_envs: int, seed: int = 0, count: int = COUNT) -> Bodies:
    """Random balls, capsules and boxes before the arm, of which one in five is absent."""
    random, shape = np.random.default_rng(seed), (num_envs, count)
    kind, absent = random.integers(3, size=shape), random.random(shape) < 0.2
    half, radius = random.uniform(0.02, 0.15, (*shape, 3)), random.uniform(0.03, 0.15, shape)
    half[kind == 0] = 0
    half[kind == 1, :2] = 0
    radius[kind == 2] = 0
    position = random.uniform((-0.1, -0.4, 0.1), (0.6, 0.4, 0.9), (*shape, 3))
    position[absent] = FAR
    turn = random.normal(size=(*shape, 4))
    turn /= np.linalg.norm(turn, axis=-1, keepdims=True)
    return swept(position, turn, half, radius)


# --- distances by NumPy alone ---------------------------------------------------------------------


def capsule_ends(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Ends `[2, B, C, 3]` of the arm's capsules at joints `q [B, n]` [m]."""
    capsules = robot.capsules
    frames = np.stack([robot.chain.links_at(one) for one in q])[:, list(capsules.links)]
    return np.stack(
        [
            np.einsum("bcij,cj->bci", frames[..., :3, :3], np.array(points)) + frames[..., :3, 3]
            for points in (capsules.starts, capsules.ends)
        ]
    )


def least(ends: np.ndarray, distance: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Least of a convex `distance` along segments `[2, ..., 3]`, by thirds."""
    low, high = np.zeros(ends.shape[1:-1]), np.ones(ends.shape[1:-1])

    def at(share: np.ndarray) -> np.ndarray:
        return distance(ends[0] + share[..., None] * (ends[1] - ends[0]))

    for _ in range(60):
        one, other = low + (high - low) / 3, high - (high - low) / 3
        left = at(one) < at(other)
        low, high = np.where(left, low, one), np.where(left, other, high)
    return at((low + high) / 2)


def to_segment(ends: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Distance of points from segments `[2, ..., 3]`."""
    way = ends[1] - ends[0]
    square = np.maximum((way**2).sum(-1), 1e-12)

    def distance(point: np.ndarray) -> np.ndarray:
        share = (((point - ends[0]) * way).sum(-1) / square).clip(0, 1)
        return np.linalg.norm(point - ends[0] - share[..., None] * way, axis=-1)

    return distance


def to_obstacles(robot: Robot, q: np.ndarray, obstacles: Bodies) -> np.ndarray:
    """Least distance `[B]` m of moving capsules from obstacles, each a box that is swept by a ball."""
    moving = np.flatnonzero(robot.capsules.links)
    ends, radii = capsule_ends(robot, q)[:, :, moving, None], np.array(robot.capsules.radii)[moving, None]
    w, x, y, z = np.moveaxis(np.asarray(obstacles.quaternion, float), -1, 0)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    inside = np.einsum("ijbk,ebcki->ebckj", turn, ends - np.asarray(obstacles.position, float)[:, None])
    half = np.asarray(obstacles.half, float)[:, None]
    beside = least(inside, lambda point: np.linalg.norm(np.maximum(np.abs(point) - half, 0), axis=-1))
    return (beside - radii - np.asarray(obstacles.radius, float)[:, None]).min(axis=(1, 2))


def to_itself(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Least distance `[B]` m between capsules that may not meet."""
    (one, other), radii = np.array(robot.capsules.pairs).T, np.array(robot.capsules.radii)
    ends = capsule_ends(robot, q)
    return (least(ends[:, :, one], to_segment(ends[:, :, other])) - radii[one] - radii[other]).min(axis=1)


def to_table(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Least height `[B]` m of moving capsules above the table."""
    moving = np.flatnonzero(robot.capsules.links)
    heights = capsule_ends(robot, q)[..., 2].min(axis=0) - np.array(robot.capsules.radii)
    return heights[:, moving].min(axis=1) - robot.table_top


# --- the model ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ARMS)
def test_capsules_are_where_they_belong_and_weigh_nothing(name: str) -> None:
    robot = load_robot(name)
    model, plain = physics_model(robot, PHYSICS, Scene(COUNT, contacts=True)), physics_model(robot, PHYSICS)
    for field in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_armature", "dof_damping", "jnt_range"):
        assert np.array_equal(getattr(model, field), getattr(plain, field)), field
    data, geoms = mujoco.MjData(model), [model.geom(f"{CAPSULE}{i}").id for i in range(len(robot.capsules.links))]
    q = joints(robot, 5)
    ours = capsule_ends(robot, q)
    placed = np.array([np.array(end).transpose(2, 1, 0) for end in capsules_at(robot.chain, robot.capsules, q)])
    assert np.abs(placed - ours).max() < ROUNDING
    for i in range(len(q)):
        data.qpos[:] = q[i]
        mujoco.mj_kinematics(model, data)
        half = data.geom_xmat[geoms].reshape(-1, 3, 3)[:, :, 2] * model.geom_size[geoms, 1:2]
        theirs = np.array([data.geom_xpos[geoms] + half, data.geom_xpos[geoms] - half])
        either = (np.abs(ours[:, i] - one).max(axis=(0, 2)) for one in (theirs, theirs[::-1]))  # which end is the first
        assert np.minimum(*either).max() < 1e-6
    assert np.array_equal(model.geom_size[geoms, 0], robot.capsules.radii)


def test_an_arm_that_touches_nothing_moves_as_one_without_obstacles() -> None:
    robot = load_robot("iiwa14")
    home = at_home(robot, 4)
    bare, among = simulator(robot, 4, count=0), simulator(robot, 4)
    one, other = begin(bare, home, count=0), begin(among, home)
    for step in np.random.default_rng(1).uniform(-0.03, 0.03, (40, 4, 7)).astype(np.float32):
        home += step
        one, other = bare.step(one, home), among.step(other, home)
        assert np.array_equal(one.q, other.q)
        assert not np.any(one.contact)
        assert not np.any(other.contact)


# --- what is told ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", tried(["iiwa14", "ur5e"], ["ur5e"]))
def test_contact_is_told_where_distances_say_so(name: str) -> None:
    robot, num_envs = load_robot(name), 1000
    obstacles, sim, alone = scene(num_envs), simulator(robot, num_envs), np.zeros(3, int)
    anywhere = joints(robot, num_envs)
    nearby = robot.home + np.random.default_rng(3).uniform(-0.7, 0.7, anywhere.shape).astype(np.float32)
    for q in (anywhere, nearby.clip(robot.chain.lower, robot.chain.upper)):
        apart = np.array([to_obstacles(robot, q, obstacles), to_itself(robot, q), to_table(robot, q)])
        alone += ((apart < 0) & ((apart < 0).sum(axis=0) == 1)).sum(axis=1)
        clear = np.abs(apart.min(axis=0)) > NEAR
        told = touching(begin(sim, q, obstacles))
        assert np.array_equal(told[clear], apart.min(axis=0)[clear] < 0)
    assert (alone > 2).all()  # of obstacles, the arm and the table each decides where the others do not


@pytest.mark.parametrize("kind", ["ball", "capsule", "box"])
def test_a_shape_is_as_large_as_it_says(kind: str) -> None:
    robot, num_envs = load_robot("iiwa14"), 400
    every = scene(num_envs, seed=5, count=1)
    half, radius = np.array(every.half), np.array(every.radius)
    long = 0.02 + 0.1 * np.random.default_rng(6).random((num_envs, 1, 3), np.float32)
    half[:] = {"ball": 0 * long, "capsule": long * np.array([0, 0, 1]), "box": long}[kind]
    radius[:] = 0 if kind == "box" else 0.1
    obstacles = swept(np.asarray(every.position), np.asarray(every.quaternion), half, radius)
    home = at_home(robot, num_envs)
    apart = to_obstacles(robot, home, obstacles)
    told = touching(begin(simulator(robot, num_envs, count=1), home, obstacles))
    clear = np.abs(apart) > NEAR
    assert np.array_equal(told[clear], apart[clear] < 0)
    assert 20 < told.sum() < 300


def test_home_is_free_and_a_folded_arm_is_not() -> None:
    robot = load_robot("ur5e")
    told = touching(begin(simulator(robot, 2), np.array([robot.home, FOLDED])))
    assert np.array_equal(told, [False, True])


def test_a_touch_in_any_step_of_the_engine_is_told_and_the_arm_stops() -> None:
    robot, num_envs = load_robot("iiwa14"), 1
    start = at_home(robot, num_envs)
    lowered = capsule_ends(robot, start)[0, 0, -1]
    place = np.array([[[lowered[0], lowered[1], 0.15]]])
    shelf = swept(place, np.array([[[1, 0, 0, 0]]]), np.array([[[0.3, 0.3, 0.05]]]), np.zeros((1, 1)))
    sim, target = simulator(robot, num_envs, count=1), start.copy()
    state, deepest, first = begin(sim, start, shelf), 0.0, None
    assert not np.any(touching(state))
    for step in range(120):
        target[:, 1] = min(target[0, 1] + 0.02, start[0, 1] + 1.0)
        before = to_obstacles(robot, np.asarray(state.q, float), shelf)[0]
        state = sim.step(state, target)
        after = to_obstacles(robot, np.asarray(state.q, float), shelf)[0]
        deepest = min(deepest, after)
        if first is None and bool(touching(state)[0]):
            first = step
            assert min(before, after) < NEAR
        elif first is None:
            assert before > -NEAR
    assert first is not None
    assert to_obstacles(robot, target.astype(float), shelf)[0] < -0.05
    assert deepest > -0.02


def test_arms_that_start_inside_obstacles_do_not_break_the_engine() -> None:
    robot, num_envs = load_robot("iiwa14"), 100
    q = joints(robot, num_envs)
    sim, state = (made := simulator(robot, num_envs)), begin(made, q, scene(num_envs, seed=7))
    assert np.mean(touching(state)) > 0.3
    for _ in range(50):
        state = sim.step(state, q)
    assert np.isfinite(np.asarray(state.q)).all()


# --- each environment has its own -----------------------------------------------------------------


def test_a_reset_changes_only_the_environments_of_its_mask() -> None:
    robot, num_envs = load_robot("iiwa14"), 40
    sim, q = simulator(robot, num_envs), joints(load_robot("iiwa14"), num_envs)
    first, second = scene(num_envs, 1), scene(num_envs, 2)
    one, two = begin(sim, q, first), begin(sim, q, second)
    assert np.any(touching(one) != touching(two))
    mask = np.arange(num_envs) % 3 == 0
    mixed = sim.reset(one, episodes(q, bodies=second), mask)
    assert np.array_equal(bits(mixed), np.where(mask[:, None], bits(two), bits(one)))
    positions = (np.asarray(bodies.position) for bodies in (second, first, mixed.bodies))
    assert np.array_equal(np.where(mask[:, None, None], next(positions), next(positions)), next(positions))
    assert np.array_equal(touching(mixed), np.where(mask, touching(two), touching(one)))
    for _ in range(5):
        one, two, mixed = sim.step(one, q), sim.step(two, q), sim.step(mixed, q)
    assert np.array_equal(touching(mixed), np.where(mask, touching(two), touching(one)))
    assert np.array_equal(mixed.q, np.where(mask[:, None], two.q, one.q))


@pytest.mark.parametrize("varied", [(), ("dynamics",), ("lag", "dynamics")])
@pytest.mark.compiled
def test_any_state_is_continued_from_bit_for_bit(varied: tuple[str, ...]) -> None:
    robot, num_envs = load_robot("iiwa14"), 6
    whole, other = (simulator(robot, num_envs, randomise=varied) for _ in range(2))
    home, random = at_home(robot, num_envs), np.random.default_rng(0)
    arms = random.uniform(-1, 1, (num_envs, 14 + len(varied))) if varied else None
    state = whole.reset(None, episodes(home, bodies=scene(num_envs, 3), dynamics=arms), None)
    commands = home + np.cumsum(random.uniform(-0.1, 0.1, (60, num_envs, 7)), axis=0).astype(np.float32)
    saved, told = state, []
    for number, command in enumerate(commands):
        if number == 20:
            saved = jax.tree.map(np.array, state)
        state = whole.step(state, command)
        told.append(touching(state))
    others = None if arms is None else -arms
    other.reset(None, episodes(home + 0.1, bodies=scene(num_envs, 4), dynamics=others), None)
    again = saved
    for number, command in enumerate(commands[20:], 20):
        again = other.step(again, command)
        assert np.array_equal(touching(again), told[number])
    assert np.any(told)
    assert np.array_equal(bits(again), bits(state))


def test_arms_that_vary_still_do_among_obstacles() -> None:
    robot = load_robot("iiwa14")
    sim, home = simulator(robot, 2, randomise=("dynamics",)), at_home(robot, 2)
    arms = np.array([[-1.0] * 15, [1.0] * 15])
    state = sim.reset(None, episodes(home, bodies=absent(2, COUNT), dynamics=arms), None)
    for _ in range(50):
        state = sim.step(state, home)
    sag = np.abs(np.asarray(state.q) - home).max(axis=1)
    assert not np.isclose(*sag, rtol=0.02)


# --- around the simulator -------------------------------------------------------------------------


def test_tasks_and_observations_are_given_contacts() -> None:
    env = Env(configure("precise", randomise=()), 4)
    state = env.init(env_keys(0, 4))
    assert not np.any(state.arm.contact)
    seen: list[Situation] = []
    errors = env.setup.task.errors
    task = replace(env.setup.task, errors=lambda setup, now: (seen.append(now), errors(setup, now))[1])
    functions = EnvFunctions(replace(env.setup, task=task), (), real_time=True, pictured=False)
    sim = simulator(env.setup.robot, 4, count=1)
    size, place = np.full((4, 1), 0.1), np.array(state.arm.tool_position)[:, None]
    place[2:] = FAR
    ball = swept(place, np.tile([1, 0, 0, 0], (4, 1, 1)), np.zeros((4, 1, 3)), size)
    arm = begin(sim, np.asarray(state.arm.q), ball)
    inside = replace(state, arm=arm)
    assert np.array_equal(np.asarray(env.situation(inside).contact), [True, True, False, False])
    functions.judge(inside, sim.step(arm, arm.q), arm.q, state.last_action, None)
    assert np.array_equal(np.asarray(seen[0].contact), [True, True, False, False])


@pytest.mark.parametrize("name", ["kinematic", "pybullet"])
def test_other_simulators_refuse_obstacles(name: str) -> None:
    with pytest.raises(InputError, match=f"simulator '{name}' judges no contacts: use --sim mujoco"):
        make_simulator(name, load_robot("iiwa14"), PHYSICS, 1, scene=Scene(1, contacts=True))


def told_of(caplog: pytest.LogCaptureFixture, text: str, file: Path) -> str:
    """What is said of the contacts of an arm by a file."""
    file.write_text(text)
    robot = load_robot(str(file))
    caplog.clear()
    shapes_of(robot)
    return caplog.text


def test_what_is_not_known_of_an_arms_shapes_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    text = load_robot("so101").model.file.read_text()
    assert told_of(caplog, text, tmp_path / "arm.xml") == ""
    first = text.index('<body name="upper_arm"')
    end = text.index("<body", first + 5)
    bare = text[:first] + re.sub(r"<geom [^>]*/>", "", text[first:end]) + text[end:]
    assert "the link that joint 'shoulder_lift' moves has no shapes" in told_of(caplog, bare, tmp_path / "bare.xml")
    stood = text.replace('<body name="base"', '<geom type="box" size="0.4 0.4 0.4"/><body name="base"', 1)
    assert "m thick, and that the arm touches its base is not noticed" in told_of(caplog, stood, tmp_path / "stood.xml")
    huge = re.sub(r'(<geom [^>]*size=")', r"\g<1>9", bare)
    with pytest.raises(InputError, match=r"has a link that is \S+ m thick by its shapes.*in millimetres"):
        told_of(caplog, huge, tmp_path / "huge.xml")


def test_an_arm_without_shapes_is_refused(tmp_path: Path) -> None:
    robot = load_robot("so101")
    file = tmp_path / "bare.xml"
    file.write_text(re.sub(r"<geom [^>]*/>", "", robot.model.file.read_text()))
    with pytest.raises(InputError, match=r"has no shapes that could be read, .*: give its links shapes"):
        physics_model(replace(robot, model=read_model_file(file)), PHYSICS, Scene(1, contacts=True))
