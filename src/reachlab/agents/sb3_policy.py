"""Policies that Stable-Baselines3 has saved."""

from __future__ import annotations

import contextlib
import hashlib
import io
import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from reachlab.agents.acting import Function
from reachlab.envs.core import Env
from reachlab.envs.earlier_configs import from_json
from reachlab.envs.gymnasium_shared import SETTINGS
from reachlab.settings.config import RunConfig
from reachlab.settings.reading import MOST_MODEL, read_regular
from reachlab.settings.validation import InputError, needing

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SavedModel:
    """A model of Stable-Baselines3.

    Attributes:
        act: its deterministic actions `[B, a]` for observations.
        config: settings of the environment that it was trained in; None if it was not one of ours.
        checkpoint: its environment steps, and SHA-256 of its file.
        observations, actions: the spaces of Gymnasium that it was trained with.
        doubts: what is said once it is known that it acts in an environment.
    """

    act: Function
    config: RunConfig | None
    checkpoint: dict[str, Any]
    observations: Any
    actions: Any
    doubts: list[str]

    def check(self, env: Env) -> None:
        """Make sure that an environment's observations and actions are what the model expects.

        Raises:
            InputError: they are not.
        """
        expected, given = _shapes(self.observations), _shapes(env.schema.bounds[0])
        if given != expected:
            raise InputError(
                f"the model observes arrays of {expected}, and the environment gives {given}: evaluate it from"
                " Python in an environment with the settings that it was trained with, see `reachlab.evaluate`."
            )
        # Of a model that knows its settings the goals may be others; only a wrapper changes its actions.
        if not _same(self.actions, env.action_bounds) or not (self.config or self._observes(env.schema.bounds)):
            raise InputError(
                "the spaces of the model are not those of the environment: it was trained with other settings, or"
                " behind a wrapper, as RescaleAction, that no model holds: evaluate it from Python behind the same one."
            )
        for doubt in self.doubts:
            log.warning("reachlab: %s", doubt)
        self.doubts.clear()

    def _observes(self, bounds: tuple[Any, Any]) -> bool:
        """Whether observations within such bounds are what it was trained on."""
        low, high = bounds
        if not isinstance(low, Mapping):
            return _same(self.observations, bounds)
        return all(_same(self.observations[name], (low[name], high[name])) for name in low)


def load_model(file: Path, normaliser: Path | None = None) -> SavedModel:
    """A model that `model.save` has written, of any algorithm; one that remembers is told where episodes begin.

    Both files are unpickled, which runs whatever code they hold: load what you trust.

    Args:
        file: the model.
        normaliser: what `VecNormalize.save` has written, if the model was trained with one.

    Raises:
        InputError: Stable-Baselines3 is not installed, or a file cannot be read.
    """
    with needing("models of Stable-Baselines3 need it: {}.", "sb3"):
        from stable_baselines3.common.save_util import load_from_pkl, load_from_zip_file
    with _loading(file, "a model"):
        content = read_regular(file, MOST_MODEL)[0]
        digest = hashlib.sha256(content).hexdigest()
        data, parameters, _ = load_from_zip_file(io.BytesIO(content), device="cpu")
        data = data or {}
        policy = _policy(data, parameters)
    observations, normalise, doubts = policy.observation_space, None, []
    if normaliser is None and _was_normalised(data):
        doubts.append(
            f"'{file}' was trained on normalised observations, and gets plain ones: name what VecNormalize.save has"
            " written, --normaliser FILE."
        )
    if normaliser:
        with _loading(normaliser, "a normaliser"):
            saved = load_from_pkl(io.BytesIO(read_regular(normaliser, MOST_MODEL)[0]))
            normalise = saved.normalize_obs
            if _shapes(saved.observation_space) != _shapes(observations):
                raise ValueError("it is of other observations than the model")

    kept: Any = None

    def sb3(observation: Any, begins: np.ndarray | None = None) -> np.ndarray:
        nonlocal kept
        seen = normalise(observation) if normalise else observation
        actions, kept = policy.predict(seen, None if begins is None else kept, begins, deterministic=True)
        return actions

    settings = getattr(policy.action_space, SETTINGS, None)
    checkpoint = {"steps": data.get("num_timesteps"), "sha256": digest}
    config = from_json(settings) if settings else None
    return SavedModel(sb3, config, checkpoint, observations, policy.action_space, doubts)


def _was_normalised(data: Mapping[str, Any]) -> bool:
    """Whether a model's last observations in training lie outside their space, as those of `VecNormalize` do."""
    space, last = data.get("observation_space"), data.get("_last_obs")
    if space is None or last is None:
        return False
    parts = [(space[name], part) for name, part in last.items()] if isinstance(last, Mapping) else [(space, last)]
    boxes = [(box, part) for box, part in parts if isinstance(box, Box)]
    return any(bool(np.any((part < box.low) | (part > box.high))) for box, part in boxes)


@contextlib.contextmanager
def _loading(file: Path, what: str) -> Iterator[None]:
    """Say of whatever unpickling raises which file it is about."""
    try:
        yield
    except Exception as error:
        why = " ".join(str(error).split()) or "nothing more is known"
        raise InputError(f"'{file}' cannot be loaded as {what}: {type(error).__name__}, {why}.") from None


def _policy(data: dict[str, Any], parameters: dict[str, Any]) -> Any:
    """The policy alone, whatever algorithm trained it."""
    kind, spaces = data["policy_class"], (data["observation_space"], data["action_space"])
    asked = signature(kind).parameters  # of what an algorithm gives beside the policy's own options, where it has it
    given = {"lr_schedule": lambda _: 0.0, "use_sde": data.get("use_sde", False)}
    policy = kind(*spaces, **{name: given[name] for name in given if name in asked} | data["policy_kwargs"])
    policy.load_state_dict(parameters["policy"])
    policy.set_training_mode(False)
    return policy


def _same(space: Any, bounds: tuple[Any, Any]) -> bool:
    """Whether a space is the box of bounds."""
    if not isinstance(space, Box) or space.shape != np.shape(bounds[0]):
        return False
    return np.allclose(space.low, bounds[0]) and np.allclose(space.high, bounds[1])


def _shapes(observation: Any) -> Any:
    """Shapes of an observation or of a space of them."""
    if isinstance(observation, Mapping):
        return {name: part.shape for name, part in observation.items()}
    return observation.shape
