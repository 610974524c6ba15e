"""The policy's network in NumPy, and its weights from a file in the form of safetensors."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.deploy.onboard.folder import content_of

KINDS = {"F32": np.float32, "F64": np.float64}
"""Types of numbers in the file."""


def read_weights(file: Path) -> dict[str, np.ndarray]:
    """Arrays by name.

    Raises:
        ValueError: the file is not whole, or not in that form.
    """
    try:
        content = content_of(file)
        (size,) = struct.unpack("<Q", content[:8])
        header, data = json.loads(content[8 : 8 + size]), content[8 + size :]
        header.pop("__metadata__", None)
        arrays = {}
        for name, entry in header.items():
            first, end = entry["data_offsets"]
            arrays[name] = np.frombuffer(data[first:end], KINDS[entry["dtype"]]).reshape(entry["shape"])
    except (OSError, KeyError, ValueError, struct.error) as error:
        raise ValueError(f"'{file}' does not hold the weights of a policy: {error}") from None
    return arrays


class Network:
    """Actions of observations: a normaliser, layers with tanh between them, and for a picture an encoder before them.

    It computes as in training, in single precision.
    """

    def __init__(self, weights: dict[str, np.ndarray], facts: dict[str, Any]) -> None:
        """The network of a policy's weights and facts."""
        self._layers, self._encoder = (_layers(weights, name) for name in ("actor", "encoder"))
        self._mean, self._scale = weights["normaliser.mean"], weights["normaliser.scale"]
        self._centre, self._half = weights["action.centre"], weights["action.half"]
        self._clip, self._bounds = np.float32(facts["observation_clip"]), None
        self._patch, self._white = int(facts["patch"]), np.float32(facts["white"])
        if facts["clip_actions"]:
            self._bounds = weights["action.low"], weights["action.high"]

    def act(self, vector: np.ndarray | None, picture: np.ndarray | None = None) -> np.ndarray:
        """Actions `[..., a]` of vectors `[..., k]` and pictures `[..., h, w]` uint8, of which one may be None."""
        parts = []
        if picture is not None:
            parts.append(self._encode(picture))
        if vector is not None:
            scaled = (vector.astype(np.float32) - self._mean) / self._scale
            parts.append(np.minimum(np.maximum(scaled, -self._clip), self._clip))
        x = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)
        for weight, bias in self._layers[:-1]:
            x = np.tanh(x @ weight + bias)
        weight, bias = self._layers[-1]
        action = self._centre + self._half * (x @ weight + bias)
        return action if self._bounds is None else np.minimum(np.maximum(action, self._bounds[0]), self._bounds[1])

    def _encode(self, picture: np.ndarray) -> np.ndarray:
        """Features `[..., f]`: of squares of the picture, then of all of them."""
        (patches, bias), (gather, bias_2), (output, bias_3) = self._encoder
        *batch, height, width = picture.shape
        side = self._patch
        x = picture.reshape(-1, height // side, side, width // side, side).transpose(0, 1, 3, 2, 4)
        x = x.reshape(-1, side**2).astype(np.float32) / self._white - np.float32(0.5)
        x = np.maximum(x @ patches + bias, 0).reshape(-1, gather.shape[0])
        x = np.maximum(x @ gather + bias_2, 0)
        return (x @ output + bias_3).reshape(*batch, -1)


def _layers(weights: dict[str, np.ndarray], name: str) -> list[tuple[np.ndarray, np.ndarray]]:
    count = sum(key.startswith(f"{name}.") and key.endswith(".weight") for key in weights)
    return [(weights[f"{name}.{i}.weight"], weights[f"{name}.{i}.bias"]) for i in range(count)]


def onnx_network(file: Path) -> Any:
    """The same function of one observation, by ONNX Runtime.

    Raises:
        ModuleNotFoundError: it is not installed.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session: Any = onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    inputs = session.get_inputs()
    vectors = [one for one in inputs if one.type == "tensor(float)"]
    ends = np.cumsum([one.shape[1] for one in vectors])[:-1]

    def act(vector: np.ndarray | None, picture: np.ndarray | None = None) -> np.ndarray:
        given = {one.name: picture[None] for one in inputs if one not in vectors and picture is not None}
        if vector is not None:
            parts = np.split(vector.astype(np.float32), ends)
            given.update({one.name: part[None] for one, part in zip(vectors, parts)})
        return session.run(None, given)[0][0]

    return act
