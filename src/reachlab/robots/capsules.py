"""Capsules that contain the links of any arm, and which pairs of them may not meet."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from reachlab.robots.cache import kept
from reachlab.robots.capsule_fit import fit_capsules
from reachlab.robots.clearance import Segments, pair_distances
from reachlab.robots.robot import Robot
from reachlab.robots.self_contact import APART
from reachlab.robots.shapes import SEGMENTS, mesh_of, solid_geoms

VERSION = 2
"""Of the derivation: what an older one left in the cache is derived again."""

ROUND = 1 / np.cos(np.pi / SEGMENTS) ** 2
"""Round shapes are fitted so many times as large: their facets, in two directions, lie inside them."""

EXACT = (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_MESH)
"""Shapes that are their facets."""

SAMPLES = 1000
"""Random joint vectors that show which capsules overlap by design."""

ALWAYS = 0.18
"""Capsules that overlap in so large a share of them do: they are thicker than their links. What is drawn of any two
links of the catalogue's arms meets in a tenth of random joint vectors at most."""


@dataclass(frozen=True)
class Capsules:
    """Capsules of an arm: constants of the robot, known while tracing.

    Attributes:
        links: number of the link that carries each capsule, see `Chain.links_at`.
        starts, ends: ends of its axis, in the frame of its link [m].
        radii: its radius [m].
        pairs: numbers of the capsules, two by two, that may not meet.
    """

    links: tuple[int, ...]
    starts: tuple[tuple[float, ...], ...]
    ends: tuple[tuple[float, ...], ...]
    radii: tuple[float, ...]
    pairs: tuple[tuple[int, int], ...]


def find_capsules(robot: Robot) -> Capsules:
    """Capsules of an arm; from the cache if they were found before, see `Robot.capsules`.

    A pair counts if its links are at least `APART` joints apart, and if it overlaps neither at home nor in `ALWAYS` of
    `SAMPLES` random joint vectors. What stands still beside the arm in its file belongs to link 0.
    """
    model, chain = robot.model, robot.chain
    pictures = [(name, file.stat().st_size, file.stat().st_mtime_ns) for name, file in sorted(model.pictures.items())]
    asked = (VERSION, model.digest, pictures, robot.tool, robot.isolation, chain, robot.home)
    return kept("capsules", asked, lambda: _found(robot), Capsules, vars)


def find_floors(robot: Robot) -> tuple[float, ...]:
    """How high each moving capsule has to stay [m]: over the workspace's floor, or anywhere if it is in it at home."""
    frames, capsules, floor = robot.chain.links_at(robot.home), robot.capsules, robot.workspace[0][2]
    floors = []
    for link, start, end, radius in zip(capsules.links, capsules.starts, capsules.ends, capsules.radii, strict=True):
        bottom = min((frames[link] @ (*point, 1.0))[2] for point in (start, end)) - radius
        floors += [floor if bottom > floor else -np.inf] if link else []
    return tuple(floors)


def _found(robot: Robot) -> Capsules:
    fitted = [(link, one) for link, shape in enumerate(link_shapes(robot)) if len(shape) for one in fit_capsules(shape)]
    found = Capsules(
        links=tuple(link for link, _ in fitted),
        starts=tuple(tuple(one.start.tolist()) for _, one in fitted),
        ends=tuple(tuple(one.end.tolist()) for _, one in fitted),
        radii=tuple(one.radius for _, one in fitted),
        pairs=(),
    )
    return replace(found, pairs=_pairs(robot, found))


def link_shapes(robot: Robot) -> list[np.ndarray]:
    """Triangles `[F, 3, 3]` m of what is solid of each link, in its own frame; round shapes a hundredth too large."""
    model = robot.spec().compile()
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[: robot.chain.n]] = robot.home
    mujoco.mj_kinematics(model, data)
    to_links, shapes = np.linalg.inv(robot.chain.links_at(robot.home)), []
    for geoms, to_link in zip(solid_geoms(model, robot.chain.n), to_links, strict=True):
        parts = [_placed(model, data, geom) for geom in geoms]
        corners = np.concatenate(parts) if parts else np.zeros((0, 3, 3))
        shapes.append(corners @ to_link[:3, :3].T + to_link[:3, 3])
    return shapes


def _placed(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> np.ndarray:
    """Triangles `[F, 3, 3]` m of a geom in the world."""
    vertices, faces = mesh_of(model, geom)
    if mujoco.mjtGeom(model.geom_type[geom]) not in EXACT:
        vertices = model.geom_pos[geom] + ROUND * (vertices - model.geom_pos[geom])
    body = model.geom_bodyid[geom]
    return (vertices @ data.xmat[body].reshape(3, 3).T + data.xpos[body])[faces]


def _pairs(robot: Robot, capsules: Capsules) -> tuple[tuple[int, int], ...]:
    links, chain = capsules.links, robot.chain
    pairs = [(i, j) for i, j in itertools.combinations(range(len(links)), 2) if links[j] - links[i] >= APART]
    if not pairs:
        return ()
    random = np.random.default_rng(0).uniform(chain.lower, chain.upper, (SAMPLES, chain.n))
    frames = np.stack([chain.links_at(q) for q in (robot.home, *random)])[:, links]
    turns, places = frames[..., :3, :3], frames[..., :3, 3].transpose(2, 1, 0)
    sides = (np.einsum("bcij,cj->icb", turns, points) + places for points in (capsules.starts, capsules.ends))
    meet = pair_distances(capsules, Segments(*sides), pairs) < 0
    counted = ~meet[:, 0] & (meet[:, 1:].mean(axis=1) < ALWAYS)
    return tuple(pair for pair, counts in zip(pairs, counted.tolist(), strict=True) if counts)
