"""Policies in ONNX files: exports of ours, or of any other trainer with the same observations."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.deploy.check import read_facts
from reachlab.emit.behaviour import MEMORY
from reachlab.envs.core import Env
from reachlab.envs.earlier_configs import from_json
from reachlab.envs.presets import configure
from reachlab.settings.config import RunConfig
from reachlab.settings.reading import MOST_MODEL, MOST_TEXT, read_regular
from reachlab.settings.validation import InputError, needing
from reachlab.tasks.schema import Observed

FACTS = "policy.json"
"""File beside the graph that says what the policy observes and commands."""


class OnnxNetwork:
    """A policy in an ONNX file.

    Attributes:
        config: settings of the environment that it was trained in, from the file beside it; None without one.
        checkpoint: what names it in a report, `steps` and `sha256` of its file.
    """

    def __init__(self, path: Path) -> None:
        """Policy of a file, or of a folder with a `policy.onnx`.

        Raises:
            InputError: ONNX Runtime is not installed, or a file cannot be read.
        """
        with needing("a policy in ONNX needs the extra 'deploy': {}.", "deploy"):
            import onnxruntime
        self.file = path / "policy.onnx" if path.is_dir() else path
        try:
            content = read_regular(self.file, MOST_MODEL)[0]
            options = onnxruntime.SessionOptions()
            options.log_severity_level = 4
            self._session: Any = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # its own errors have no common class
            said = error.strerror if isinstance(error, OSError) else None
            why = said or " ".join(str(error).split())
            raise InputError(f"'{self.file}' cannot be read as a policy in ONNX: {why}.") from None
        self._inputs = {one.name: one for one in self._session.get_inputs()}
        self._remembers = int(self._inputs.pop(MEMORY).shape[1]) if MEMORY in self._inputs else 0
        self._kept = np.zeros((0, self._remembers), np.float32)
        self.config = _settings(self.file.with_name(FACTS))
        self.checkpoint: dict[str, Any] = {"steps": None, "sha256": hashlib.sha256(content).hexdigest()}

    @property
    def inputs(self) -> int:
        """Numbers that the only input of a graph with one takes."""
        return int(next(iter(self._inputs.values())).shape[1])

    def check(self, env: Env) -> None:
        """Make sure that it takes the observations of an environment.

        Raises:
            InputError: it does not.
        """
        given = {name: array.shape for name, array in self._named(env.schema.bounds[0]).items()}
        for name, shape in given.items():
            taken = self._inputs[name].shape[1:]
            if len(taken) != len(shape) or any(
                isinstance(t, int) and t != s for t, s in zip(taken, shape, strict=True)
            ):
                raise InputError(
                    f"input {name!r} of '{self.file}' takes {taken}, and the environment observes {list(shape)}: say"
                    f" what the policy observes in a '{FACTS}' beside it, as docs/deploy.md shows."
                )

    def onnx(self, observation: Observed, begins: np.ndarray | None = None) -> np.ndarray:
        """Actions `[B, a]` of observations with the batch in front.

        A policy that remembers begins anew where `begins [B]` says so, and in all where the batch has another size.
        """
        if begins is not None and len(begins) == len(self._kept):
            self._kept = np.where(begins[:, None], 0.0, self._kept)
        actions, self._kept = (*self.decide(observation, self._kept), self._kept)[:2]
        return actions

    def decide(self, observation: Observed, memory: Any) -> Sequence[np.ndarray]:
        """The same and, of a policy that remembers, what is remembered then `[B, M]`, of what was."""
        given = self._named(observation)
        count, batch = len(next(iter(given.values()))), self._inputs[next(iter(given))].shape[0]
        if self._remembers:
            kept = memory if len(memory) == count else np.zeros((count, self._remembers))
            given[MEMORY] = np.asarray(kept, np.float32)
        if batch == 1:  # a graph that was made for one observation at a time
            rows = [{name: part[i : i + 1] for name, part in given.items()} for i in range(count)]
            every = [self._session.run(None, row) for row in rows]
            results = [np.concatenate(parts) for parts in zip(*every, strict=True)]
        else:
            results = self._session.run(None, given)
        return results[: 2 if self._remembers else 1]

    act = onnx
    """Under the name by which policies of others are asked; reports call it by the first one."""

    def _named(self, observation: Observed) -> dict[str, np.ndarray]:
        """An observation by the names of the graph's inputs.

        Raises:
            InputError: they are not those of the observation.
        """
        parts = observation if isinstance(observation, Mapping) else {next(iter(self._inputs)): observation}
        if set(parts) != set(self._inputs):
            raise InputError(
                f"'{self.file}' has the inputs {', '.join(self._inputs)}, and the environment observes"
                f" {', '.join(parts)}."
            )
        kinds = {"tensor(uint8)": np.uint8, "tensor(double)": np.float64}
        return {name: np.asarray(part, kinds.get(self._inputs[name].type, np.float32)) for name, part in parts.items()}


def _settings(file: Path) -> RunConfig | None:
    """Settings of the file beside a graph: `settings` in full as an export has them, or flags of a task by name.

    Raises:
        InputError: it is no such file.
    """
    if not file.exists():
        return None
    try:
        facts = json.loads(read_regular(file, MOST_TEXT)[0])
        settings = facts["settings"]
        if "files" in facts:  # of an export, whose parts have to belong together
            read_facts(file.parent)
        if "rules" in settings:
            return from_json(settings)
        return configure(**settings)
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"'{file}' does not say what its policy was trained for: {error!r}.") from None
