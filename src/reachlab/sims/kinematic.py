"""The kinematic simulator: joints follow their commands exactly, as in the tutorial."""

from __future__ import annotations

import jax.numpy as jnp

from reachlab.robots.kinematics import forward_kinematics
from reachlab.robots.robot import Robot
from reachlab.settings.config import SimConfig
from reachlab.sims import ArmState, BatchArray, Kind, Moved
from reachlab.sims.rendering import Drawn
from reachlab.tasks.obstacles import Obstacles
from reachlab.tasks.task import Goal


class KinematicSimulator(Drawn):
    """Arithmetic in JAX: a step sets the joints."""

    kind: Kind = "traced"

    def __init__(
        self,
        robot: Robot,
        config: SimConfig,
        num_envs: int,
        *,
        threads: int = 0,
        randomise_dynamics: bool = False,
        obstacles: int = 0,
    ) -> None:
        """Simulator of `num_envs` arms; its functions take any batch."""
        super().__init__(robot, config, num_envs)
        del threads, randomise_dynamics, obstacles
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
        obstacles: Obstacles | None = None,
    ) -> ArmState:
        """See `Simulator.reset`."""
        del goal, dynamics, obstacles
        if state is not None and mask is not None:
            q = jnp.where(mask[:, None], q, state.q)
            qd = jnp.where(mask[:, None], 0.0, state.qd)
        else:
            qd = jnp.zeros_like(q)
        q, qd = jnp.asarray(q), jnp.asarray(qd)
        return ArmState(q, qd, *forward_kinematics(self._robot.chain, q))

    def step(self, state: ArmState | Moved, target_q: BatchArray) -> Moved:
        """See `Simulator.step`."""
        return Moved(jnp.asarray(target_q), jnp.asarray((target_q - state.q) / self._period))
