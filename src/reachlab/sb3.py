"""Environments for Stable-Baselines3."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from reachlab.settings.validation import InputError

if TYPE_CHECKING:
    from reachlab.envs.sb3_vector import ReachVecEnv

__all__ = ["make_vec_env"]


def make_vec_env(n_envs: int = 1, task: str = "tutorial", seed: int | None = None, **settings: Any) -> ReachVecEnv:
    """A `VecEnv` of so many environments of a task, with any field of the configuration, or `render_mode`, changed.

    As with Stable-Baselines3's function of that name its environments tell returns and lengths of episodes, as
    `Monitor` does, and environment i is seeded with seed + i at the next reset.

    Raises:
        InputError: Stable-Baselines3 is not installed; or see `ReachEnv`.
    """
    try:
        from reachlab.envs.sb3_vector import ReachVecEnv
    except ModuleNotFoundError:
        raise InputError("ReachVecEnv needs Stable-Baselines3: pip install 'reachlab[sb3]'.") from None
    env = ReachVecEnv(n_envs, task=task, **settings)
    env.seed(seed)
    return env
