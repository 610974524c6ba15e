"""Capsules around the links of any arm, checked against MuJoCo's own poses, shapes, distances and contacts."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from contacts import contacts, link_of
from foreign_arms import FILES
from params import tried
from reachlab.control.bodies import beside
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.evaluation.report import evaluate
from reachlab.jax_setup import jit
from reachlab.robots import loading
from reachlab.robots.catalogue import ROBOTS
from reachlab.robots.files.model_file import read_model_file
from reachlab.robots.loading import load_robot
from reachlab.robots.robot import Robot
from reachlab.robots.shapes.capsule_fit import capsule_volume, cut
from reachlab.robots.shapes.clearance import (
    APART,
    Segments,
    capsules_at,
    moving,
    pair_distances,
    segment_distance,
    self_distance,
    table_distance,
)
from reachlab.settings import cache
from reachlab.tasks import tabletop
from situations import swept

ARMS = [*ROBOTS, str(FILES["xarm6"])]
ROUNDING = 3e-6
"""Of positions up to 1.3 m in float32 [m]."""

LOOSEST = 2.2
"""Volume of an arm's capsules, in those of the convex hulls of its links."""

FOLDED = [0.0, -1.0, 2.9, 0.0, 0.0, 0.0]
"""Joints at which a UR5e's wrist is inside its own upper arm [rad]."""


def joints(robot: Robot, count: int) -> np.ndarray:
    """Random joint vectors `[count, n]`."""
    chain = robot.chain
    return np.random.default_rng(2).uniform(chain.lower, chain.upper, (count, chain.n)).astype(np.float32)


def surface(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Points `[m, 3]` m on a geom's surface, in its own frame; of a mesh all vertices, and points of its faces."""
    random, size = np.random.default_rng(geom), model.geom_size[geom]
    directions = random.normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    side = np.sign(directions)
    kind = mujoco.mjtGeom(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        vertices = model.mesh_vert[first : first + count].astype(float)
        first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        corners = vertices[model.mesh_face[first : first + count]]
        inside = np.einsum("fc,fci->fi", random.dirichlet(np.ones(3), count), corners)
        return np.concatenate([vertices, inside])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        rim = directions[:, :2] / np.linalg.norm(directions[:, :2], axis=1, keepdims=True)
        return np.column_stack([size[0] * rim, size[1] * side[:, 2]])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return size[0] * directions + np.outer(side[:, 2] * size[1], [0, 0, 1])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return np.concatenate([side * size, size * directions / np.abs(directions).max(axis=1, keepdims=True)])
    return directions * (size[0] if kind == mujoco.mjtGeom.mjGEOM_SPHERE else size)


def points_of_links(robot: Robot, q: np.ndarray) -> list[np.ndarray]:
    """Points in the world on all that is drawn of each link, at joints `q [n]` [m]."""
    model = robot.spec().compile()
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    points: list[list[np.ndarray]] = [[] for _ in range(robot.chain.n + 1)]
    for geom in np.flatnonzero(model.geom_contype + model.geom_conaffinity == 0):
        turned = surface(model, int(geom)) @ data.geom_xmat[geom].reshape(3, 3).T
        points[link_of(model, model.geom_bodyid[geom])].append(turned + data.geom_xpos[geom])
    return [np.concatenate(parts) if parts else np.zeros((0, 3)) for parts in points]


@pytest.mark.parametrize("name", tried(ARMS, ["iiwa14", "so101"]))
def test_capsules_contain_what_is_drawn_and_little_more(name: str) -> None:
    robot = load_robot(name)
    capsules = robot.capsules
    assert hash(capsules) == hash(load_robot(name).capsules)
    q = joints(robot, 1)
    at = capsules_at(robot.chain, capsules, q)
    starts, ends = (np.asarray(end, float)[..., 0] for end in at)
    hulls = 0.0
    for link, points in enumerate(points_of_links(robot, q[0])):
        own = np.flatnonzero(np.array(capsules.links) == link)
        assert 1 <= len(own) <= 3
        beside = [
            segment_distance(Segments(starts[:, i, None], ends[:, i, None]), Segments(points.T, points.T))
            - capsules.radii[i]
            for i in own
        ]
        assert np.min(beside, axis=0).max() < ROUNDING, f"link {link}"
        hulls += ConvexHull(points).volume
    lengths = np.linalg.norm(ends - starts, axis=0)
    assert hulls < capsule_volume(lengths, np.array(capsules.radii)).sum() < LOOSEST * hulls


def with_capsules(robot: Robot) -> tuple[mujoco.MjModel, list[int]]:
    """The robot with its capsules as geoms of its bodies, and a ball and a capsule in the world; their numbers."""
    plain = robot.spec(pictures=False).compile()
    data = mujoco.MjData(plain)
    data.qpos[:] = robot.home
    mujoco.mj_forward(plain, data)
    spec, frames, capsules = robot.spec(pictures=False), robot.chain.links_at(robot.home), robot.capsules
    for number, link in enumerate(capsules.links):
        body = int(plain.jnt_bodyid[link - 1]) if link else 0
        ends = [frames[link] @ (*end, 1.0) for end in (capsules.starts[number], capsules.ends[number])]
        low, high = ((end[:3] - data.xpos[body]) @ data.xmat[body].reshape(3, 3) for end in ends)
        geom = spec.bodies[body].add_geom(name=f"capsule {number}", size=[capsules.radii[number], 0, 0])
        if not np.array_equal(low, high):  # else it is a ball
            geom.type, geom.fromto = mujoco.mjtGeom.mjGEOM_CAPSULE, np.concatenate([low, high])
        else:
            geom.pos = low
    spec.worldbody.add_geom(name="ball", size=[0.07, 0, 0], pos=[0.4, 0.1, 0.3])
    spec.worldbody.add_geom(
        name="rod", type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.05, 0, 0], fromto=[0.3, -0.4, 0.1, 0.3, -0.2, 0.6]
    )
    model = spec.compile()
    return model, [model.geom(f"capsule {number}").id for number in range(len(capsules.links))]


@pytest.mark.parametrize("name", ["iiwa14", "ur5e", "so101"])
def test_poses_and_distances_are_mujocos(name: str) -> None:
    robot, count = load_robot(name), 40
    capsules, (model, geoms) = robot.capsules, with_capsules(robot)
    data, q = mujoco.MjData(model), joints(robot, count)
    at = jit(lambda q: capsules_at(robot.chain, capsules, q))(q)
    distances = np.asarray(pair_distances(capsules, at, capsules.pairs))
    turn = Rotation.align_vectors([[0.0, 0.2, 0.5]], [[0.0, 0.0, 1.0]])[0]
    obstacles = swept(
        position=[[0.4, 0.1, 0.3], [0.3, -0.3, 0.35]],
        quaternion=[[1.0, 0.0, 0.0, 0.0], turn.as_quat(scalar_first=True)],
        half=[[0.0, 0.0, 0.0], [0.0, 0.0, np.hypot(0.2, 0.5) / 2]],
        radius=[0.07, 0.05],
    )
    start, end, radius = moving(capsules, at)
    each = [jax.tree.map(lambda x, k=k: x[k], obstacles) for k in range(2)]
    near = [np.asarray((beside(start, end, one).distance - radius).min(axis=0)) for one in each]
    above, nearest = np.asarray(table_distance(robot.capsules, at)), np.asarray(self_distance(capsules, at))
    starts, ends = (np.asarray(end).T for end in at)
    moved = [geom for geom, link in zip(geoms, capsules.links, strict=True) if link]
    for i in range(count):
        data.qpos[:] = q[i]
        mujoco.mj_forward(model, data)
        half = data.geom_xmat[geoms].reshape(-1, 3, 3)[:, :, 2] * model.geom_size[geoms, 1:2]
        middle = data.geom_xpos[geoms]
        assert np.abs(np.sort([starts[i], ends[i]], 0) - np.sort([middle - half, middle + half], 0)).max() < ROUNDING

        def distance(one: int, other: int) -> float:
            return mujoco.mj_geomDistance(model, data, one, other, 10.0, None)

        theirs = [distance(geoms[a], geoms[b]) for a, b in capsules.pairs]
        assert distances[:, i] == pytest.approx(theirs, abs=2e-5)
        assert nearest[i] == pytest.approx(min(theirs), abs=2e-5)
        for row, obstacle in enumerate(("ball", "rod")):
            number = model.geom(obstacle).id
            assert near[row][i] == pytest.approx(min(distance(geom, number) for geom in moved), abs=5e-4)
        bottoms = data.geom_xpos[moved, 2] - np.abs(half[-len(moved) :, 2]) - model.geom_size[moved, 0]
        heights = bottoms - robot.capsules.floors
        assert above[i] == pytest.approx(heights.min(), abs=ROUNDING)


def test_segments_that_are_parallel_cross_or_are_points() -> None:
    def segment(start: tuple[float, ...], end: tuple[float, ...]) -> Segments:
        return Segments(np.array(start, np.float32), np.array(end, np.float32))

    along_x, point = segment((0, 0, 0), (1, 0, 0)), segment((0.5, 3, 4), (0.5, 3, 4))
    for other, distance in (
        (segment((0.5, 0.2, 0), (2, 0.2, 0)), 0.2),
        (segment((4, 4, 0), (3, 4, 0)), np.hypot(2, 4)),
        (segment((-3, 0, 0), (-1, 0, 0)), 1.0),
        (segment((0.5, -1, 0.3), (0.5, 1, 0.3)), 0.3),
        (segment((0.5, 1, 0), (0.5, 2, 0)), 1.0),
        (along_x, 0.0),
        (point, 5.0),
    ):
        assert segment_distance(along_x, other) == pytest.approx(distance, abs=1e-6)
        assert segment_distance(other, along_x) == pytest.approx(distance, abs=1e-6)
    assert segment_distance(point, point) == 0


def test_a_cut_keeps_the_surface() -> None:
    random = np.random.default_rng(0)
    triangles, normal = random.normal(size=(200, 3, 3)), np.array([0.6, 0.0, 0.8])
    parts = cut(triangles, normal, 0.1)
    area = [np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum() for t in (triangles, *parts)]
    assert area[1] + area[2] == pytest.approx(area[0])
    assert (parts[0] @ normal).max() <= 0.1 + 1e-9
    assert (parts[1] @ normal).min() >= 0.1 - 1e-9


# --- which pairs count ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ROBOTS)
def test_home_is_free_and_what_touches_is_found(name: str) -> None:
    robot = load_robot(name)
    capsules = robot.capsules
    near = jit(lambda q: self_distance(capsules, capsules_at(robot.chain, capsules, q)))
    assert near(np.array([robot.home], np.float32))[0] > 0
    assert all(capsules.links[b] - capsules.links[a] >= APART for a, b in capsules.pairs)
    every = itertools.combinations(range(len(capsules.links)), 2)
    left_out = {(capsules.links[a], capsules.links[b]) for a, b in every if (a, b) not in capsules.pairs}
    q = joints(robot, 300)
    touch = np.array([bool(pairs - left_out) for pairs in contacts(robot, q)])
    told = np.asarray(near(q)) < 0
    assert told[touch].all()
    assert told.mean() < touch.mean() + 0.1


def test_a_wrist_inside_the_upper_arm_is_in_contact() -> None:
    robot = load_robot("ur5e")
    at = capsules_at(robot.chain, robot.capsules, np.array([FOLDED], np.float32))
    assert float(self_distance(robot.capsules, at)[0]) < 0
    assert contacts(robot, np.array([FOLDED]))[0] >= {(2, 4)}


def test_an_arm_without_shapes_has_no_capsules_and_no_share(tmp_path: Path) -> None:
    robot = load_robot("so101")
    file = tmp_path / "bare.xml"
    file.write_text(re.sub(r"<geom [^>]*/>", "", robot.model.file.read_text()))
    bare = replace(robot, model=read_model_file(file))
    assert bare.capsules.links == bare.capsules.pairs == ()


def _forget() -> None:
    """Nothing that was derived in this process is known any more."""
    for known in (loading._load, tabletop._found, tabletop._reach, cache._shipped):
        known.cache_clear()


def test_they_are_found_when_they_are_asked_for_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(cache, "SHIPPED", tmp_path / "nothing")
    _forget()
    robot = load_robot("so101")
    assert not list(tmp_path.rglob("*.json"))
    (file,) = (robot.capsules, list(tmp_path.rglob("*.json")))[1]
    _forget()
    written = file.stat().st_mtime_ns
    assert load_robot("so101").capsules == robot.capsules
    assert file.stat().st_mtime_ns == written
    monkeypatch.undo()
    _forget()


# --- reports --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_reports_under_dynamics_tell_the_share_and_others_do_not() -> None:
    env = Env(configure("precise", robot="ur5e", action="joint_delta"), 50)
    still = evaluate(env, lambda _: np.zeros((50, 6)), seed=1, episodes=60)
    folding = evaluate(env, lambda _: np.tile([0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (50, 1)), seed=1, episodes=60)
    assert (still.self_contact, folding.self_contact) == (0.0, 1.0)
    assert evaluate(Env(configure("precise"), 50), "ik", seed=1, episodes=50).self_contact == 0.0
    kinematic = Env(configure("precise", sim="kinematic", max_steps=20), 1000)
    assert evaluate(kinematic, "zero", seed=1, episodes=10).self_contact is None


# --- what is shipped ------------------------------------------------------------------------------


def test_of_the_catalogues_arms_nothing_is_derived_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    _forget()
    for robot, task in itertools.product(ROBOTS, ("clutter", "push", "slide")):
        Env(configure(task, robot=robot), 1).close()
    assert not list(tmp_path.rglob("*.json")), "run `python -m benchmarks.derived`"


@pytest.mark.parametrize("robot", tried(sorted(ROBOTS), ["so101"]))
def test_what_is_shipped_is_what_is_derived(robot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    _forget()
    shipped = load_robot(robot).capsules
    table = tabletop.working_box(load_robot(robot))
    _forget()
    monkeypatch.setattr(cache, "SHIPPED", tmp_path / "nothing")
    assert load_robot(robot).capsules == shipped
    np.testing.assert_array_equal(tabletop.working_box(load_robot(robot)), table)
    assert {path.parent.name for path in tmp_path.rglob("*.json")} == {"capsules", "tables"}
    monkeypatch.undo()
    _forget()
