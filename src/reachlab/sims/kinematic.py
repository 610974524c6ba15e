"""The kinematic simulator: joints follow their commands exactly, as in the tutorial."""

from __future__ import annotations

import jax.numpy as jnp

from reachlab.robots.kinematics import forward_kinematics
from reachlab.robots.robot import Robot
from reachlab.settings.config import SimConfig
from reachlab.sims import ArmState, BatchArray, Kind
from reachlab.sims.rendering import Drawn
from reachlab.tasks.task import Goal


class KinematicSimulator(Drawn):
    """Arithmetic in JAX: a step sets the joints and computes where the tool is."""

    kind: Kind = "traced"

    def __init__(self, robot: Robot, config: SimConfig, num_envs: int, *, randomise_dynamics: bool = False) -> None:
        """Simulator of `num_envs` arms; its functions take any batch."""
        super().__init__(robot, config, num_envs)
        del randomise_dynamics
        self._robot = robot
        self._period = config.control_period
        self.lag = (0.0,) * robot.chain.n

    def reset(
        self,
        state: ArmState | None,
        q: BatchArray,
        goal: Goal,
        mask: BatchArray | None,
        dynamics: BatchArray | None = None,
    ) -> ArmState:
        """See `Simulator.reset`."""
        del goal, dynamics
        if state is not None and mask is not None:
            q = jnp.where(mask[:, None], q, state.q)
            qd = jnp.where(mask[:, None], 0.0, state.qd)
        else:
            qd = jnp.zeros_like(q)
        return self._arm(q, qd)

    def step(self, state: ArmState, target_q: BatchArray) -> ArmState:
        """See `Simulator.step`."""
        return self._arm(target_q, (target_q - state.q) / self._period)

    def _arm(self, q: BatchArray, qd: BatchArray) -> ArmState:
        q, qd = jnp.asarray(q), jnp.asarray(qd)
        pose = forward_kinematics(self._robot.chain, q)
        return ArmState(q, qd, pose.position, pose.quaternion)
