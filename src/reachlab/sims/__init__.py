"""Who moves the arm: the table of simulators."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from reachlab.settings.tables import Lazy, Table


@dataclass(frozen=True)
class SimulatorEntry(Lazy):
    """A simulator of the table; its class, and with it the engine, is imported when it is loaded.

    Attributes:
        gives: `dynamics`, arms that can differ from each other, see `RunConfig.randomise`; `contacts` with bodies;
            the `wrench` at the wrist.
        settings: those of `SimConfig` that it alone uses, and `defaults` of any settings that go with it.
        most_envs: arms that it can hold; None for any number.
        draws_anything: its observation camera draws any goal, not only the one that lies beside an arm now.
    """

    gives: frozenset[str] = frozenset()
    settings: tuple[str, ...] = ()
    defaults: Mapping[str, Any] = field(default_factory=dict)
    most_envs: int | None = None
    draws_anything: bool = True


SIMULATORS: dict[str, SimulatorEntry] = Table(
    {
        "kinematic": SimulatorEntry(
            "joints follow their commands exactly; batched in JAX", "reachlab.sims.kinematic:KinematicSimulator"
        ),
        "mujoco": SimulatorEntry(
            "full dynamics: gravity, inertia, position servos with torque limits; batched on all cores",
            "reachlab.sims.mujoco:MujocoSimulator",
            gives=frozenset({"dynamics", "contacts", "objects", "wrench"}),
            settings=("physics_steps", "collisions", "gravity_compensation", "servo_lag"),
            # Where time is real a command takes longer to be followed.
            defaults={"control_period": 0.02, "validation_episodes": 1000},
        ),
        "pybullet": SimulatorEntry(
            "joints are set, or full dynamics with objects; at most 16 environments, needs the extra 'pybullet'",
            "reachlab.sims.pybullet:make_pybullet",
            gives=frozenset({"objects", "wrench"}),
            settings=("gui", "slow"),
            # Every environment is a client of its own.
            defaults={"num_envs": 16, "rollout_steps": 256, "validation_episodes": 200},
            most_envs=16,
            draws_anything=False,
        ),
    }
)
"""Simulators by name. Adding one takes its file and its line here."""
