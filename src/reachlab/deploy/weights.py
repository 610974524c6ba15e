"""Weights of a policy by name, and its network as an ONNX graph."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from reachlab.agents.encoder import CHANNELS, PATCH, WHITE
from reachlab.agents.policy import OBSERVATION_CLIP, SMALLEST_STD, Policy
from reachlab.settings.validation import InputError, installing
from reachlab.tasks.schema import GOALS, SIZE, Schema
from reachlab.tasks.task import Bounds

OPSET, IR = 17, 8
"""Versions of the operators and of the file: old ones, that every runtime of recent years reads."""


def named_weights(policy: Policy, bounds: Bounds) -> dict[str, np.ndarray]:
    """Arrays of a policy that gives actions within bounds: what the controller and the graph compute with."""
    plain: Policy = jax.tree.map(np.asarray, policy)
    layers = {"actor": plain.parameters.actor, "encoder": plain.parameters.encoder or []}
    weights: dict[str, Any] = {
        f"{name}.{i}.{part}": array
        for name, those in layers.items()
        for i, layer in enumerate(those)
        for part, array in zip(("weight", "bias"), layer, strict=True)
    }
    named: dict[str, np.ndarray] = weights | {
        "normaliser.mean": np.asarray(plain.normaliser.mean, np.float32),
        "normaliser.scale": np.sqrt(plain.normaliser.variance, dtype=np.float32) + np.float32(SMALLEST_STD),
        "action.centre": np.asarray(plain.centre, np.float32),
        "action.half": np.asarray(plain.half, np.float32),
        "action.low": bounds[0],
        "action.high": bounds[1],
    }
    return named


def inputs(schema: Schema) -> list[tuple[str, list[int], bool]]:
    """Inputs of the graph, as an observation holds them: name, shape of one and whether it is a picture."""
    if schema.pictures:
        return [(field.name, list(field.shape), field.picture) for field in schema.fields]
    if schema.has_goals:
        sizes = {field.name: field.shape[0] for field in schema.fields}
        goals = [(name, [sizes.pop(name)], False) for name in GOALS]
        return [("observation", [sum(sizes.values())], False), *goals]
    return [("observation", [schema.vector_size], False)]


def onnx_model(policy: Policy, bounds: Bounds, *, clips: bool) -> Any:
    """ONNX model of a policy: from observations with the batch in front to `action`, normalised and clipped inside.

    Raises:
        InputError: onnx is not installed.
    """
    try:
        from onnx import TensorProto, checker, helper, numpy_helper
    except ModuleNotFoundError:
        raise InputError(f"an export to ONNX needs the extra 'deploy': {installing('deploy')}.") from None

    weights, nodes = named_weights(policy, bounds), []
    constants = {"clip.high": np.float32(OBSERVATION_CLIP), "clip.low": np.float32(-OBSERVATION_CLIP)}

    def add(kind: str, parts: list[str], name: str, **settings: Any) -> str:
        nodes.append(helper.make_node(kind, parts, [name], **settings))
        return name

    def dense(x: str, layer: str) -> str:
        return add("Gemm", [x, f"{layer}.weight", f"{layer}.bias"], f"{layer}.sum")

    given = inputs(policy.schema)
    vectors = [name for name, _, picture in given if not picture]
    parts = [_encoded(name, add, dense, constants) for name, _, picture in given if picture]
    if vectors:
        vector = vectors[0] if len(vectors) == 1 else add("Concat", vectors, "vector", axis=1)
        scaled = add("Div", [add("Sub", [vector, "normaliser.mean"], "shifted"), "normaliser.scale"], "scaled")
        parts.append(add("Clip", [scaled, "clip.low", "clip.high"], "normalised"))
    x = parts[0] if len(parts) == 1 else add("Concat", parts, "features", axis=1)
    last = len(policy.parameters.actor) - 1
    for i in range(last):
        x = add("Tanh", [dense(x, f"actor.{i}")], f"hidden.{i}")
    x = add("Mul", [dense(x, f"actor.{last}"), "action.half"], "displaced")
    if clips:
        x = add("Add", [x, "action.centre"], "unclipped")
        x = add("Min", [add("Max", [x, "action.low"], "raised"), "action.high"], "action")
    else:
        add("Add", [x, "action.centre"], "action")
    used = {name for node in nodes for name in node.input}
    arrays = [
        numpy_helper.from_array(np.asarray(value), name)
        for name, value in (weights | constants).items()
        if name in used
    ]
    kinds = {True: TensorProto.UINT8, False: TensorProto.FLOAT}
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info(name, kinds[picture], ["batch", *shape]) for name, shape, picture in given],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["batch", len(bounds[0])])],
        arrays,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="reachlab")
    model.ir_version = IR
    checker.check_model(model, full_check=True)
    return model


def _encoded(name: str, add: Any, dense: Any, constants: dict[str, Any]) -> str:
    """Features of a picture, see `encoder.encode`."""
    side = SIZE // PATCH
    shapes = {"cut": [-1, side, PATCH, side, PATCH], "squares": [-1, PATCH**2], "whole": [-1, side**2 * CHANNELS]}
    constants |= {"white": np.float32(WHITE), "grey": np.float32(0.5)}
    constants |= {f"shape.{shape}": np.array(sizes, np.int64) for shape, sizes in shapes.items()}
    x = add("Reshape", [add("Cast", [name], "picture.float", to=1), "shape.cut"], "picture.cut")
    x = add("Transpose", [x], "picture.turned", perm=[0, 1, 3, 2, 4])
    x = add("Reshape", [x, "shape.squares"], "picture.squares")
    x = add("Sub", [add("Div", [x, "white"], "picture.scaled"), "grey"], "picture.centred")
    x = add("Relu", [dense(x, "encoder.0")], "encoder.0.out")
    x = add("Reshape", [x, "shape.whole"], "encoder.joined")
    x = add("Relu", [dense(x, "encoder.1")], "encoder.1.out")
    return dense(x, "encoder.2")
