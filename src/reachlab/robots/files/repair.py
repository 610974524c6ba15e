"""Masses and inertias of bodies that MuJoCo refuses, replaced by possible ones."""

from __future__ import annotations

import mujoco
import numpy as np

from reachlab.robots.files.picture_files import some
from reachlab.robots.files.pictures import weighs

SMALL_MASS, SMALL_RADIUS = 0.01, 0.03
"""Mass [kg] and radius of gyration [m] of a moving body that has none."""
LEAST_INERTIA = 1e-12
"""Least principal moment of inertia [kg m²]; MuJoCo refuses those below 1e-15."""
LEAST_SHARE = 1e-5
"""Least share of the largest moment that another one is: of a smaller one MuJoCo's solver may find a negative one."""
ROUNDING = 1e-9
"""Relative margin by which moments of inertia satisfy A + B >= C."""
NOTED = 1e-6
"""Relative change of an inertia from which it is noted."""

ROWS, COLUMNS = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
"""Places of a full inertia's six numbers in its matrix, as MuJoCo orders them."""


def repair(spec: mujoco.MjSpec) -> list[str]:
    """Give moving bodies a mass and all of them a possible inertia, in place; one sentence on each change."""
    massless, balanced = [], []
    for body in spec.bodies[1:]:
        if body.explicitinertial:
            if _balance_body(body):
                balanced.append(body.name)
        elif body.joints and not any(weighs(spec, geom) for geom in body.geoms):
            body.explicitinertial, body.mass, body.inertia = True, SMALL_MASS, [SMALL_MASS * SMALL_RADIUS**2] * 3
            massless.append(body.name)
    noted = {
        f"Moving bodies without a mass get {SMALL_MASS:g} kg": massless,
        "Inertias that no rigid body has are replaced by the nearest possible": balanced,
    }
    return [f"{what}: {some(names)}." for what, names in noted.items() if names]


def _balance_body(body: mujoco.MjsBody) -> bool:
    """Replace the inertia of a body unless it is possible; whether it differed by more than rounding."""
    full = not np.isnan(body.fullinertia[0])
    given = np.diag(body.inertia)
    if full:
        given[ROWS, COLUMNS] = given[COLUMNS, ROWS] = body.fullinertia
    possible = balance(given, body.mass)
    if full:
        body.fullinertia = possible[ROWS, COLUMNS]
    else:
        body.inertia = possible.diagonal()
    return bool(np.abs(given - possible).max() > NOTED * np.abs(given).max())


def balance(inertia: np.ndarray, mass: float) -> np.ndarray:
    """The nearest inertia `[3, 3]` that a rigid body can have: positive moments with A + B >= C [kg m²]."""
    moments, axes = np.linalg.eigh(inertia)
    if moments[2] < LEAST_INERTIA:
        return mass * SMALL_RADIUS**2 * np.eye(3)
    possible = moments
    if moments[0] < LEAST_INERTIA:
        possible = np.maximum(moments, max(LEAST_INERTIA, LEAST_SHARE * moments[2]))
    lack = possible[2] * (1 + ROUNDING) - possible[0] - possible[1]
    if lack > 0.0:
        even = possible + lack / 3 * np.array([1.0, 1.0, -1.0])
        # Where that makes another moment the largest, as of a rod, the smallest gets all that lacks.
        possible = even if even[1] <= even[2] else possible + lack * np.array([1.0, 0.0, 0.0])
    return inertia if np.array_equal(moments, possible) else axes @ np.diag(possible) @ axes.T
