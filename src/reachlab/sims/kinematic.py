"""The kinematic simulator: joints follow their commands exactly, as in the tutorial."""

from __future__ import annotations

import jax.numpy as jnp

from reachlab.config import SimConfig
from reachlab.kinematics import forward_kinematics
from reachlab.robots import Robot
from reachlab.sims import ArmState, Lanes
from reachlab.sims.drawn import Drawn


class KinematicSimulator(Drawn):
    """Arithmetic in JAX: a step sets the joints and computes where the tool is."""

    pure = True

    def __init__(self, robot: Robot, config: SimConfig, batch_size: int) -> None:
        """Simulator of `batch_size` arms; its functions take any batch."""
        super().__init__(robot, config, batch_size)
        self._robot = robot
        self._period = config.control_period
        self.lag = (0.0,) * robot.chain.n

    def reset(
        self, state: ArmState | None, q: Lanes, target: Lanes, mask: Lanes | None, chance: Lanes | None = None
    ) -> ArmState:
        """See `Simulator.reset`."""
        del target, chance
        if state is not None and mask is not None:
            q = jnp.where(mask[:, None], q, state.q)
            qd = jnp.where(mask[:, None], 0.0, state.qd)
        else:
            qd = jnp.zeros_like(q)
        return self._arm(q, qd)

    def step(self, state: ArmState, target_q: Lanes) -> ArmState:
        """See `Simulator.step`."""
        return self._arm(target_q, (target_q - state.q) / self._period)

    def _arm(self, q: Lanes, qd: Lanes) -> ArmState:
        q, qd = jnp.asarray(q), jnp.asarray(qd)
        pose = forward_kinematics(self._robot.chain, q)
        return ArmState(q, qd, pose.position, pose.quaternion)
