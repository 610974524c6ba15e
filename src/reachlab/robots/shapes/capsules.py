"""Capsules that contain the links of any arm, and which pairs of them may not meet."""

from __future__ import annotations

import itertools
from dataclasses import replace

import mujoco
import numpy as np

from reachlab.robots.derive.isolation import Isolation, apply
from reachlab.robots.files.model_file import ModelFile
from reachlab.robots.kinematics.chain import Chain
from reachlab.robots.shapes.capsule_fit import fit_capsules
from reachlab.robots.shapes.clearance import APART, Capsules, Segments, pair_distances
from reachlab.robots.shapes.solids import SEGMENTS, mesh_of, solid_geoms
from reachlab.settings.cache import kept

VERSION = 3
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


def find_capsules(
    model: ModelFile, isolation: Isolation, chain: Chain, tool: str, home: tuple[float, ...], floor: float
) -> Capsules:
    """Capsules of an arm; from the cache if they were found before.

    A pair counts if its links are at least `APART` joints apart, and if it overlaps neither at home nor in `ALWAYS` of
    `SAMPLES` random joint vectors. What stands still beside the arm in its file belongs to link 0.

    Args:
        model: its file.
        isolation: how it is cut out of it.
        chain: its joints.
        tool: its tool frame.
        home: joints `[n]` in which it touches nothing but by design [rad or m].
        floor: height of the table [m].
    """
    pictures = [(name, file.stat().st_size, file.stat().st_mtime_ns) for name, file in sorted(model.pictures.items())]
    asked = (VERSION, model.digest, pictures, tool, isolation, chain, home)

    def find() -> Capsules:
        spec = model.spec()
        apply(spec, isolation)
        shapes = link_shapes(spec.compile(), chain, home)
        fitted = [(link, one) for link, shape in enumerate(shapes) if len(shape) for one in fit_capsules(shape)]
        capsules = Capsules(
            links=tuple(link for link, _ in fitted),
            starts=tuple(tuple(one.start.tolist()) for _, one in fitted),
            ends=tuple(tuple(one.end.tolist()) for _, one in fitted),
            radii=tuple(one.radius for _, one in fitted),
            pairs=(),
        )
        return replace(capsules, pairs=_pairs(capsules, chain, home))

    found = kept("capsules", asked, find, Capsules, lambda found: {**vars(found), "floors": ()})
    frames, floors = chain.links_at(home), []
    for link, start, end, radius in zip(found.links, found.starts, found.ends, found.radii, strict=True):
        bottom = min((frames[link] @ (*point, 1.0))[2] for point in (start, end)) - radius
        floors += [floor if bottom > floor else -np.inf] if link else []
    return replace(found, floors=tuple(floors))


def link_shapes(model: mujoco.MjModel, chain: Chain, home: tuple[float, ...]) -> list[np.ndarray]:
    """Triangles `[F, 3, 3]` m of what is solid of each link, in its own frame; round shapes a hundredth too large."""
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[: chain.n]] = home
    mujoco.mj_kinematics(model, data)
    to_links, shapes = np.linalg.inv(chain.links_at(home)), []
    for geoms, to_link in zip(solid_geoms(model, chain.n), to_links, strict=True):
        corners = np.concatenate([np.zeros((0, 3, 3)), *(_placed(model, data, geom) for geom in geoms)])
        shapes.append(corners @ to_link[:3, :3].T + to_link[:3, 3])
    return shapes


def _placed(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> np.ndarray:
    """Triangles `[F, 3, 3]` m of a geom in the world."""
    vertices, faces = mesh_of(model, geom)
    if mujoco.mjtGeom(model.geom_type[geom]) not in EXACT:
        vertices = model.geom_pos[geom] + ROUND * (vertices - model.geom_pos[geom])
    body = model.geom_bodyid[geom]
    return (vertices @ data.xmat[body].reshape(3, 3).T + data.xpos[body])[faces]


def _pairs(capsules: Capsules, chain: Chain, home: tuple[float, ...]) -> tuple[tuple[int, int], ...]:
    links = capsules.links
    pairs = [(i, j) for i, j in itertools.combinations(range(len(links)), 2) if links[j] - links[i] >= APART]
    if not pairs:
        return ()
    random = np.random.default_rng(0).uniform(chain.lower, chain.upper, (SAMPLES, chain.n))
    frames = chain.links_at(np.vstack([home, random]))[:, links]
    turns, places = frames[..., :3, :3], frames[..., :3, 3].transpose(2, 1, 0)
    sides = (np.einsum("bcij,cj->icb", turns, points) + places for points in (capsules.starts, capsules.ends))
    meet = pair_distances(capsules, Segments(*sides), pairs) < 0
    counted = ~meet[:, 0] & (meet[:, 1:].mean(axis=1) < ALWAYS)
    return tuple(pair for pair, counts in zip(pairs, counted.tolist(), strict=True) if counts)
