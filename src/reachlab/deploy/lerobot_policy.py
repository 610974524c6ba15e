"""Policies that LeRobot has trained, as they act in our environments."""

from __future__ import annotations

import contextlib
import hashlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
from jax import Array

from reachlab.agents.acting import Act, Driver
from reachlab.agents.policy import Policy
from reachlab.deploy.lerobot_form import LeRobotForm
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, Transition
from reachlab.envs.gymnasium_shared import checked_actions
from reachlab.settings.validation import InputError


class LeRobotPolicy:
    """A policy that LeRobot has saved in a folder.

    Attributes:
        config: None, for LeRobot does not know the environment that it was trained for.
        checkpoint: what names it in a report, `steps` and `sha256` of its weights.
        act: what drives arms in environments of the form of `LeRobotForm`.
    """

    config = None

    def __init__(self, folder: str | Path) -> None:
        """Policy of a folder, as `checkpoints/last/pretrained_model` of `lerobot-train`; one of LeRobot's own classes.

        Raises:
            InputError: LeRobot is not installed, the folder cannot be read, or the policy observes pictures.
        """
        self._folder = folder = Path(folder)
        try:
            from lerobot.configs import PreTrainedConfig  # pyright: ignore[reportMissingImports]
            from lerobot.policies import (  # pyright: ignore[reportMissingImports]
                get_policy_class,
                make_pre_post_processors,
            )
        except ModuleNotFoundError:
            raise InputError(
                f"'{folder}' is a policy of LeRobot: run the command where LeRobot is installed, see docs/lerobot.md."
            ) from None
        try:
            config: Any = PreTrainedConfig.from_pretrained(folder)
            with contextlib.redirect_stdout(sys.stderr):  # LeRobot prints, and our standard output may be JSON
                self._policy: Any = get_policy_class(config.type).from_pretrained(folder, config=config)
            self._before, self._after = make_pre_post_processors(
                config, str(folder), preprocessor_overrides={"device_processor": {"device": str(config.device)}}
            )
            weights = b"".join(file.read_bytes() for file in sorted(folder.glob("*.safetensors")))
        except Exception as error:  # its own errors have no common class
            why = " ".join(str(error).split())
            raise InputError(f"'{folder}' cannot be read as a policy of LeRobot: {why}.") from None
        if config.image_features:
            raise InputError("a policy that observes pictures is evaluated by `lerobot-eval`, see docs/lerobot.md.")
        self._shapes = {name: one.shape for name, one in (config.input_features | config.output_features).items()}
        self.checkpoint: dict[str, Any] = {"steps": None, "sha256": hashlib.sha256(weights).hexdigest()}
        self.act = Driver(config.type, self._act)

    def check(self, env: Env) -> None:
        """Nothing: it observes what `LeRobotForm` gives of any environment."""

    def _act(self, env: Env) -> Act:
        """Its step in an environment, in which all episodes begin together.

        Raises:
            InputError: it is of another arm, or of a task with other surroundings.
        """
        from lerobot.envs.utils import preprocess_observation  # pyright: ignore[reportMissingImports]
        from torch import inference_mode  # pyright: ignore[reportMissingImports]

        form, step = LeRobotForm(env), env.compile_whole(env.step)
        shape, task = (env.num_envs, len(form.motors.names)), env.setup.task.asks(env.setup.rules, env.setup.period)
        described = [task.partition(":")[0]] * env.num_envs

        def positions(state: EnvState) -> np.ndarray:
            if not np.asarray(state.clock).any():
                self._policy.reset()
            seen = preprocess_observation(form.seen(state))
            self._check_shapes({name: tuple(part.shape[1:]) for name, part in seen.items()} | {"action": shape[1:]})
            with inference_mode():
                action = self._after(self._policy.select_action(self._before(seen | {"task": described})))
            return checked_actions(action.numpy(force=True), shape)

        def act(
            _policy: Policy | None,
            state: EnvState,
            key: Array,
            _mask: Array | None = None,
            instead: Array | None = None,
        ) -> tuple[EnvState, Transition, Array]:
            command = form.command(state, positions(state))
            if instead is not None:
                command = np.where(np.isnan(instead), command, instead)
            state, transition = step(state, np.zeros_like(state.last_action), instead=command)
            return state, transition, key

        return act

    def _check_shapes(self, given: dict[str, tuple[int, ...]]) -> None:
        for name in given.keys() & self._shapes.keys():
            if given[name] != tuple(self._shapes[name]):
                raise InputError(
                    f"{name!r} of '{self._folder}' has {self._shapes[name][0]} numbers, and the environment has"
                    f" {given[name][0]}: name its own --task and --robot."
                )
