"""A batch of episodes under way, as the interfaces of other libraries step it: one call a step, resets included."""

from __future__ import annotations

import contextlib
import functools
import sys
from collections.abc import Callable
from typing import Any, Self

import cloudpickle
import jax
import numpy as np
from gymnasium.vector import AutoresetMode

from reachlab.control.situation import Goal
from reachlab.envs.core import Env
from reachlab.envs.episode_steps import HostSteps, Now, Result, Steps
from reachlab.envs.functions import EnvState
from reachlab.envs.packing import make_packing
from reachlab.envs.random_streams import env_keys
from reachlab.jax_setup import jit, refuse_fork
from reachlab.settings.config import RunConfig
from reachlab.sims.simulator import BatchArray
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.rewards import REWARDS

BY_NAME = ("reachlab", "builtins", "functools")
"""Packages whose functions are what they were."""


class EpisodeBatch:
    """Episodes under way in every environment of a batch; they begin anew as Gymnasium's autoreset mode says."""

    def __init__(self, env: Env, mode: AutoresetMode, *, in_numpy: bool) -> None:
        """Batch of an environment's episodes; it gives NumPy arrays of their own, or JAX arrays.

        Compiled programs are shared with batches that are settled alike.
        """
        if env.traced:
            self._steps: Steps = _compiled(env.config, env.num_envs, mode, _named(env))
        else:
            self._steps = Steps(env, mode) if env.pictured else HostSteps(env, mode)
        self._in_numpy, self._held = in_numpy, self._steps.nothing

    @property
    def state(self) -> EnvState:
        """State of the environment, after the first reset."""
        return self._steps.state(self._held)

    def reset(self, seeds: np.ndarray, seeded: np.ndarray, mask: np.ndarray, goal: Goal | None = None) -> Now:
        """Begin new episodes in the environments of `mask [B]`; the first time these are all.

        Those that are `seeded [B]` begin the first episode of their seed, `seeds [B]` uint32, the others the next one,
        all of them with the `goal` if one is given.
        """
        self._held, now = self._steps.reset(self._held, seeds, seeded, mask, goal)
        return self._steps.now.taken(now, in_numpy=self._in_numpy)

    def step(self, actions: BatchArray) -> Result:
        """Take a step with actions `[B, a]`, float32 and finite."""
        self._held, result = self._steps.step(self._held, actions)
        return self._steps.result.taken(result, in_numpy=self._in_numpy)


class Programs(Steps):
    """Resets and steps that are one compiled program each; what they take and give is packed, but for arguments."""

    def __init__(self, env: Env, mode: AutoresetMode) -> None:
        """Programs of an environment, compiled as they are first called.

        Raises:
            InputError: JAX cannot compute in this process.
        """
        refuse_fork()
        super().__init__(env, mode)
        actions = np.zeros((env.num_envs, len(env.action_bounds[0])), np.float32)
        held = jax.eval_shape(env.init, env_keys(0, env.num_envs)), self.nothing[1]
        packing = functools.partial(make_packing, num_envs=env.num_envs)
        self._held, self.now = packing(held), packing(jax.eval_shape(self._begun, held[0]))
        self.result = packing(jax.eval_shape(super().step, held, actions)[1])
        self.nothing = self._held.zeros
        self.reset = jit(functools.partial(self._packed, super().reset, self.now))
        self.step = jit(functools.partial(self._packed, super().step, self.result))

    def state(self, held: Any) -> EnvState:
        """See `Steps.state`."""
        return self._held.in_jax(held)[0]

    def __deepcopy__(self, _memo: dict[int, Any]) -> Self:
        """Itself: it holds nothing that changes."""
        return self

    def _packed(self, function: Callable[..., Any], packing: Any, packed: Any, *arguments: Any) -> Any:
        held, result = function(self._held.unpack(packed), *arguments)
        return self._held.pack(held), packing.pack(result)


def _named(env: Env) -> object:
    """What settings name, by its code and by the values that this uses; equal to nothing where these are not to be had.

    Who tries another reward may give it the same name, or change a number that it uses.
    """
    rules = env.setup.rules
    named = REWARDS[rules.reward], OBSERVATIONS[rules.observation], ACTIONS[rules.action], env.setup.task
    parts = [type(rules), *named, *(part for one in named for part in getattr(one, "__dict__", {}).values())]
    modules = {str(getattr(part, "__module__", None)) for part in parts} & sys.modules.keys() - {"__main__"}
    try:
        with contextlib.ExitStack() as by_name_again:
            for module in (sys.modules[name] for name in modules if name.partition(".")[0] not in BY_NAME):
                cloudpickle.register_pickle_by_value(module)
                by_name_again.callback(cloudpickle.unregister_pickle_by_value, module)
            return cloudpickle.dumps(named)
    except Exception:  # whatever is among those values
        return object()


@functools.lru_cache(maxsize=16)
def _compiled(config: RunConfig, num_envs: int, mode: AutoresetMode, _named: object) -> Programs:
    return Programs(Env(config, num_envs), mode)
