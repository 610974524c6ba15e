"""Environments for Stable-Baselines3."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from reachlab.settings.validation import InputError, needing

if TYPE_CHECKING:
    from reachlab.envs.sb3_vector import ReachVecEnv

__all__ = ["make_vec_env"]


OF_SINGLE = (
    *("start_index", "monitor_dir", "wrapper_class", "vec_env_cls"),
    *("vec_env_kwargs", "monitor_kwargs", "wrapper_kwargs"),
)
"""What Stable-Baselines3's function takes for the single environments that it makes."""


def make_vec_env(
    env_id: str = "reachlab/Reach-v0",
    n_envs: int = 1,
    seed: int | None = None,
    env_kwargs: dict[str, Any] | None = None,
    **settings: Any,
) -> ReachVecEnv:
    """A `VecEnv` of so many environments of an id, with any field of the configuration, or `render_mode`, changed.

    As with Stable-Baselines3's function of that name its environments tell returns and lengths of episodes, as
    `Monitor` does, and environment i is seeded with seed + i at the next reset. Settings are keywords, or `env_kwargs`
    as there; what that function takes for single environments is refused, for these are one batch.

    Raises:
        InputError: Stable-Baselines3 is not installed, an argument for single environments; or see `ReachVecEnv`.
    """
    given = {name: settings.pop(name, None) for name in OF_SINGLE}
    if foreign := [name for name, value in given.items() if value]:
        raise InputError(
            f"{foreign[0]} is for single environments, and these are one batch: leave it out, and put a VecEnvWrapper"
            " around the batch, as VecMonitor(env, FILE), VecNormalize or VecFrameStack."
        )
    if "num_envs" in settings:
        raise InputError(
            "the number of environments is n_envs here, as in Stable-Baselines3: say it in place of num_envs."
        )
    if not isinstance(env_kwargs, dict | None):
        raise InputError(f"env_kwargs must be a dict of settings, got {env_kwargs!r}.")
    with needing("ReachVecEnv needs Stable-Baselines3: {}.", "sb3"):
        from reachlab.envs.sb3_vector import ReachVecEnv
    env = ReachVecEnv(env_id, n_envs, **{**(env_kwargs or {}), **settings})
    env.seed(seed)
    return env
