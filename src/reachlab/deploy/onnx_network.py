"""Policies in ONNX files: exports of ours, or of any other trainer with the same observations."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.deploy.check import read_facts
from reachlab.envs.formats import from_json
from reachlab.envs.presets import configure
from reachlab.settings.config import RunConfig
from reachlab.settings.reading import MOST_MODEL, MOST_TEXT, read_regular
from reachlab.settings.validation import InputError, installing
from reachlab.tasks.schema import Observed, Schema

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
        try:
            import onnxruntime
        except ModuleNotFoundError:
            raise InputError(f"a policy in ONNX needs the extra 'deploy': {installing('deploy')}.") from None
        self.file = path / "policy.onnx" if path.is_dir() else path
        try:
            content = read_regular(self.file, MOST_MODEL)[0]
            options = onnxruntime.SessionOptions()
            options.log_severity_level = 4
            self._session: Any = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # its own errors have no common class
            why = " ".join(str(error).split())
            raise InputError(f"'{self.file}' cannot be read as a policy in ONNX: {why}.") from None
        self._inputs = {one.name: one for one in self._session.get_inputs()}
        self.config = _settings(self.file.with_name(FACTS))
        self.checkpoint: dict[str, Any] = {"steps": None, "sha256": hashlib.sha256(content).hexdigest()}

    @property
    def inputs(self) -> int:
        """Numbers that the only input of a graph with one takes."""
        return int(next(iter(self._inputs.values())).shape[1])

    def check(self, schema: Schema) -> None:
        """Make sure that it takes the observations of a schema.

        Raises:
            InputError: it does not.
        """
        given = {name: array.shape for name, array in self._named(schema.bounds[0]).items()}
        for name, shape in given.items():
            taken = self._inputs[name].shape[1:]
            if len(taken) != len(shape) or any(
                isinstance(t, int) and t != s for t, s in zip(taken, shape, strict=True)
            ):
                raise InputError(
                    f"input {name!r} of '{self.file}' takes {taken}, and the environment observes {list(shape)}: say"
                    f" what the policy observes in a '{FACTS}' beside it, as docs/deploy.md shows."
                )

    def onnx(self, observation: Observed) -> np.ndarray:
        """Actions `[B, a]` of observations with the batch in front."""
        given = self._named(observation)
        batch = self._inputs[next(iter(given))].shape[0]
        if batch == 1:  # a graph that was made for one observation at a time
            count = len(next(iter(given.values())))
            rows = [{name: part[i : i + 1] for name, part in given.items()} for i in range(count)]
            return np.concatenate([self._session.run(None, row)[0] for row in rows])
        return self._session.run(None, given)[0]

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
