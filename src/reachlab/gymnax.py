"""Environments for gymnax, and for trainers written for it: `env, params = reachlab.gymnax.make("tutorial")`.

On the CPU compile what uses them with `reachlab.gymnax.jit` in place of `jax.jit`: with XLA's own options a step of
2,048 environments takes 15 times as long. A trainer that calls `jax.jit` itself is as fast where the process is started
with `XLA_FLAGS=--xla_disable_hlo_passes=cse_barrier_expander`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from reachlab.jax_setup import jit
from reachlab.settings.validation import InputError, installing

if TYPE_CHECKING:
    from gymnax.environments.environment import EnvParams  # pyright: ignore[reportMissingImports]

    from reachlab.envs.gymnax_env import GymnaxEnv

__all__ = ["jit", "make"]


def make(task: str = "tutorial", **settings: Any) -> tuple[GymnaxEnv, EnvParams]:
    """Environment of a task preset, with any field of the configuration as a keyword, and its default parameters.

    Raises:
        InputError: gymnax is not installed, a task or setting that does not exist, a value that is not allowed, or what
            JAX cannot trace.
    """
    try:
        from reachlab.envs.gymnax_env import GymnaxEnv
    except ModuleNotFoundError as error:
        raise InputError(f"reachlab.gymnax needs gymnax ({error.name} is missing): {installing('gymnax')}.") from None
    env = GymnaxEnv(task, **settings)
    return env, env.default_params
