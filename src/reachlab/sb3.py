"""Environments for Stable-Baselines3."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from reachlab.settings.validation import InputError

if TYPE_CHECKING:
    from reachlab.envs.sb3_vector import ReachVecEnv

__all__ = ["make_vec_env"]


def make_vec_env(
    env_id: str = "reachlab/Reach-v0", n_envs: int = 1, seed: int | None = None, **settings: Any
) -> ReachVecEnv:
    """A `VecEnv` of so many environments of an id, with any field of the configuration, or `render_mode`, changed.

    As with Stable-Baselines3's function of that name its environments tell returns and lengths of episodes, as
    `Monitor` does, and environment i is seeded with seed + i at the next reset.

    Raises:
        InputError: Stable-Baselines3 is not installed; or see `ReachVecEnv`.
    """
    try:
        from reachlab.envs.sb3_vector import ReachVecEnv
    except ModuleNotFoundError:
        raise InputError("ReachVecEnv needs Stable-Baselines3: pip install 'reachlab[sb3]'.") from None
    env = ReachVecEnv(env_id, n_envs, **settings)
    env.seed(seed)
    return env
