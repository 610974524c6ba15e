"""The kinematic simulator: joints follow their commands exactly, as in the tutorial."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.robots.robot import Robot
from reachlab.settings.config import SimConfig
from reachlab.sims.rendering import Drawn
from reachlab.sims.simulator import BatchArray, Begin, Kind, Moved, SimState, chosen


class KinematicSimulator(Drawn):
    """Arithmetic in JAX: a step sets the joints."""

    kind: Kind = "traced"

    def __init__(self, robot: Robot, config: SimConfig, num_envs: int, **_: Any) -> None:
        """Simulator of `num_envs` arms, whatever others need beside; its functions take any batch."""
        super().__init__(robot, config, num_envs)
        self._period = config.control_period
        self.lag = (0.0,) * robot.chain.n

    def reset(self, state: SimState | None, begin: Begin, mask: BatchArray | None) -> SimState:
        """See `Simulator.reset`."""
        begun = jnp.asarray(begin.q), jnp.zeros_like(begin.q), begin.bodies
        q, qd, bodies = begun if state is None else chosen(mask, begun, (state.q, state.qd, state.bodies))
        return SimState(
            q, qd, *forward_kinematics(self._robot.chain, q), bodies, jnp.zeros((len(q), 0), bool), q[:, :0]
        )

    def step(self, state: SimState | Moved, command: BatchArray) -> Moved:
        """See `Simulator.step`."""
        q = jnp.asarray(command)[:, : self._robot.chain.n]
        return Moved(q, jnp.asarray((q - state.q) / self._period), state.bodies, state.contact, state.opening)
