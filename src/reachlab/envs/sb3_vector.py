"""Stable-Baselines3's interface to a batch of environments."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import load_env_creator
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvObs, VecEnvStepReturn

from reachlab.envs.gymnasium_shared import checked_seeds
from reachlab.settings.validation import InputError, choose

if TYPE_CHECKING:
    from reachlab.envs.gymnasium_vector import ReachVectorEnv

SHARED = ("compute_reward", "compute_terminated", "compute_truncated")
"""Methods that are the same function for every environment; hindsight replay asks for the first."""


class ReachVecEnv(VecEnv):
    """A batch of arms for Stable-Baselines3; environment i of seed s is `ReachEnv` with seed s + i.

    Infos hold what `ReachEnv` tells, and where an episode ended what `DummyVecEnv` and `Monitor` add.
    """

    def __init__(self, env_id: str = "reachlab/Reach-v0", num_envs: int = 1, **settings: Any) -> None:
        """Batch of environments of an id, whose settings are changed by those given; see `ReachEnv`.

        Raises:
            InputError: no id of this package, or arrays of JAX; or see `ReachEnv`.
        """
        if not isinstance(env_id, str):
            raise InputError(f"env_id must be the name of an environment, as reachlab/Reach-v0, got {env_id!r}.")
        if arrays := {"arrays", "autoreset_mode"} & settings.keys():
            raise InputError(
                f"Stable-Baselines3 takes arrays of NumPy, reset in the same step: leave {min(arrays)} out."
            )
        ours = [name for name, spec in gymnasium.registry.items() if spec.namespace == "reachlab"]
        spec = gymnasium.spec(choose("environment id", env_id.removeprefix("reachlab:"), ours))
        make_batch: Any = load_env_creator(spec.vector_entry_point)  # pyright: ignore[reportArgumentType]
        self.env: ReachVectorEnv = make_batch(
            num_envs=num_envs, autoreset_mode="SameStep", **{**spec.kwargs, **settings}
        )
        super().__init__(num_envs, self.env.single_observation_space, self.env.single_action_space)
        self.metadata = self.env.metadata
        self._actions = np.zeros(self.env.action_space.shape or (), np.float32)
        self._returns, self._lengths = np.zeros(num_envs), np.zeros(num_envs, int)
        self._began = time.time()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seeds of the next episodes, from this one on, or random ones.

        Raises:
            InputError: no whole number within the limits.
        """
        self._seeds = checked_seeds(super().seed()[0] if seed is None else seed, self.num_envs)
        return self._seeds

    def reset(self) -> VecEnvObs:
        """Observations of new episodes, with the seeds that `seed` has handed out."""
        observation, info = self.env.reset(seed=self._seeds)
        self._reset_seeds()
        self._reset_options()
        self._returns[:], self._lengths[:] = 0.0, 0
        self.reset_infos = _infos(info)
        return observation

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Take no options.

        Raises:
            InputError: there are some.
        """
        if options and options != [{}] * self.num_envs:
            raise InputError(
                "environments of Stable-Baselines3 take no options: `ReachEnv`, a single one, takes targets."
            )

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions `[B, a]` for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Observations, rewards `[B]` float32, ends `[B]` and infos; an episode that ended begins anew.

        Raises:
            InputError: an action is misshapen or not finite; nothing has moved.
        """
        observation, rewards, terminated, truncated, info = self.env.step(self._actions)
        done = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        infos = _infos({**info, "TimeLimit.truncated": truncated & ~terminated})
        ended = np.flatnonzero(done)
        if ended.size:
            final, seconds = _infos(info["final_info"]), round(time.time() - self._began, 6)
            for i in ended.tolist():
                self.reset_infos[i] = {name: infos[i][name] for name in final[i]}
                episode = {"r": float(self._returns[i]), "l": int(self._lengths[i]), "t": seconds}
                infos[i] |= {**final[i], "terminal_observation": info["final_obs"][i], "episode": episode}
            self._returns[ended], self._lengths[ended] = 0.0, 0
        return observation, rewards.astype(np.float32), done, infos

    def get_images(self) -> Sequence[np.ndarray | None]:
        """A picture of each environment, in render mode `rgb_array`."""
        return self.env.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The batch's attribute, as often as environments are asked for; of spaces that of one environment."""
        of_one = {"observation_space", "action_space"}
        value = getattr(self.env, f"single_{attr_name}" if attr_name in of_one else attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the batch.

        Raises:
            InputError: of some environments only.
        """
        if set(self._get_indices(indices)) != set(range(self.num_envs)):
            raise InputError(f"{attr_name} is one for all {self.num_envs} environments: leave out indices.")
        setattr(self.env, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Answer of a method of the batch, as often as environments are asked for.

        Raises:
            InputError: no method that is the same for every environment.
        """
        value = getattr(self.env, choose("method", method_name, SHARED))(*method_args, **method_kwargs)
        return [value for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Whether environments tell what a wrapper would: they tell what `Monitor` does."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]

    def close(self) -> None:
        """Close the simulator."""
        self.env.close()


def _infos(info: dict[str, Any]) -> list[dict[str, Any]]:
    """Infos of each environment, of Gymnasium's infos of a batch."""
    known = {name: rows for name, rows in info.items() if not name.startswith(("_", "final_"))}
    columns = {name: list(rows) if rows.ndim > 1 else rows.tolist() for name, rows in known.items()}
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
