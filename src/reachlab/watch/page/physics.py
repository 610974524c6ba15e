"""What a page needs to move an arm as MuJoCo does in training: the model, and where in its arrays things are."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS

from reachlab.envs.core import Env
from reachlab.settings.validation import InputError
from reachlab.sims.mujoco import MujocoSimulator
from reachlab.sims.mujoco_model import physics_spec
from reachlab.sims.mujoco_objects import OBJECT

NEWER = ' input="pos"'
"""Written by MuJoCo 4, whose WebAssembly is of version 3 and knows no other input of these actuators."""

POINT = 1e-6
"""Radius of what stands for a mesh, which touches nothing [m]."""


def engine_of(env: Env) -> tuple[dict[str, Any] | None, dict[str, np.ndarray]]:
    """Facts of an environment's engine, None without one, and arrays by name that XML holds in too few digits.

    Raises:
        InputError: shapes of the robot's file collide, which a page does not hold.
    """
    simulator, config, robot = env.simulator, env.config.physics, env.setup.robot
    if not isinstance(simulator, MujocoSimulator):
        return None, {}
    if config.collisions:
        raise InputError("a page does not hold the meshes that collide with the table: leave --collisions out.")
    model, spec = simulator.model(), physics_spec(robot, config, env.setup.task.scene(env.setup))
    if model.nmesh:
        _weigh(spec, model)
    text = spec.to_xml().replace(NEWER, "")
    read, layout = mujoco.MjModel.from_xml_string(text), simulator.layout
    places = {name: np.asarray(part).ravel().tolist() for name, part in layout._asdict().items()}
    n, fingers = robot.chain.n, len(layout.fingers)
    places["finger_bodies"] = model.jnt_bodyid[n : n + fingers].tolist()
    places["object_bodies"] = objects = [i for i in range(model.nbody) if model.body(i).name.startswith(OBJECT)]
    paired = np.isin(model.geom_bodyid[np.stack([model.pair_geom1, model.pair_geom2])], objects).any(axis=0)
    places["object_pairs"] = np.flatnonzero(paired).tolist()
    facts = {
        "xml": text,
        "substeps": config.physics_steps,
        "layout": places,
        "gripper": asdict(robot.gripper) if robot.gripper else None,
    }
    return facts, {name: _numbers(model, name) for name in MODEL_FIELDS if _differs(model, read, name)}


def _weigh(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Give bodies the mass and inertia that follow from their meshes, and put points in place of these."""
    spec.compile()  # from then on bodies know their numbers
    for body in spec.bodies[1:]:
        i = body.id
        body.explicitinertial, body.mass, body.inertia = True, model.body_mass[i], model.body_inertia[i]
        body.ipos, body.iquat = model.body_ipos[i], model.body_iquat[i]
    for geom in [one for one in spec.geoms if one.type == mujoco.mjtGeom.mjGEOM_MESH]:
        geom.type, geom.meshname, geom.size, geom.mass = mujoco.mjtGeom.mjGEOM_SPHERE, "", [POINT] * 3, 0.0
        geom.contype = geom.conaffinity = 0
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    spec.compile()


def _differs(model: mujoco.MjModel, read: mujoco.MjModel, name: str) -> bool:
    one, other = _numbers(model, name), _numbers(read, name)
    return one.dtype == np.float64 and one.shape == other.shape and not np.array_equal(one, other)


def _numbers(model: mujoco.MjModel, name: str) -> np.ndarray:
    return np.asarray(getattr(model.opt, name[4:]) if name.startswith("opt.") else getattr(model, name))
