"""Joints of an MJCF file that do not move by themselves."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

BY_ITSELF = "and every joint of a chain has to move by itself: choose a --tool before"
"""Why an arm is refused, and what helps."""


def check_uncoupled(model: mujoco.MjModel, chain: Sequence[int]) -> None:
    """Make sure that no joint of a chain, given by their numbers, follows another joint or shares a tendon with one.

    Raises:
        ValueError: one does.
    """
    own = {joint: repr(model.joint(joint).name) for joint in chain}
    for equality in range(model.neq):
        one, other = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
        if not model.eq_active0[equality]:
            continue
        if model.eq_type[equality] == int(mujoco.mjtEq.mjEQ_JOINT) and one in own:
            leads = f"follows joint {model.joint(other).name!r}" if other >= 0 else "is held in place"
            raise ValueError(f"joint {own[one]} of the arm {leads} by an equality constraint, {BY_ITSELF} it")
        if model.eq_type[equality] == int(mujoco.mjtEq.mjEQ_TENDON) and other >= 0:
            _check_tendons(model, (one, other), own)
    for tendon in range(model.ntendon):
        _check_tendons(model, (tendon,), own)


def _check_tendons(model: mujoco.MjModel, tendons: Sequence[int], own: dict[int, str]) -> None:
    """Refuse fixed tendons that together act on several joints of the arm."""
    joints = {
        int(model.wrap_objid[wrap])
        for tendon in tendons
        for wrap in range(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
        if model.wrap_type[wrap] == int(mujoco.mjtWrap.mjWRAP_JOINT)
    }
    coupled = [own[joint] for joint in sorted(joints & own.keys())]
    if len(coupled) > 1:
        names = " and ".join(repr(model.tendon(tendon).name) for tendon in tendons)
        raise ValueError(f"the tendon {names} couples the joints {', '.join(coupled)} of the arm, {BY_ITSELF} them")
