"""Weights of a policy by name, and its network as an ONNX graph."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from reachlab.agents.encoder import CELL, CHANNELS, PATCH, SHARPNESS, WHITE, Encoder, Keypoints, middles
from reachlab.agents.policy import OBSERVATION_CLIP, SMALLEST_STD, Policy
from reachlab.emit.behaviour import AFTER, MEMORY
from reachlab.settings.validation import needing
from reachlab.tasks.schema import SIZE, Schema
from reachlab.tasks.task import Bounds

GATES = ("reset", "keep", "new")
"""Of a memory, see `memory.Cell`."""

OPSET, IR = 17, 8
"""Versions of the operators and of the file: old ones, that every runtime of recent years reads."""


def named_weights(policy: Policy, bounds: Bounds) -> dict[str, np.ndarray]:
    """Arrays of a policy that gives actions within bounds: what the controller and the graph compute with."""
    plain: Policy = jax.tree.map(np.asarray, policy)
    encoder, cell = plain.parameters.encoder, plain.parameters.memory
    layers = {"actor": plain.parameters.actor, "encoder": encoder.layers if encoder else []}
    weights: dict[str, Any] = {
        f"{name}.{i}.{part}": array
        for name, those in layers.items()
        for i, layer in enumerate(those)
        for part, array in zip(("weight", "bias"), layer, strict=True)
    }
    for name in GATES if cell else ():
        weights |= {f"memory.{name}.{part}": array for part, array in getattr(cell, name)._asdict().items()}
    weights |= {"memory.kept_bias": cell.kept_bias} if cell else {}
    return weights | {
        "normaliser.mean": np.asarray(plain.normaliser.mean, np.float32),
        "normaliser.scale": np.sqrt(plain.normaliser.variance, dtype=np.float32) + np.float32(SMALLEST_STD),
        "action.centre": np.asarray(plain.centre, np.float32),
        "action.half": np.asarray(plain.half, np.float32),
        "action.low": bounds[0],
        "action.high": bounds[1],
    }


def inputs(schema: Schema) -> list[tuple[str, list[int], bool]]:
    """Inputs of the graph, as an observation holds them: name, shape of one and whether it is a picture."""
    low, _ = schema.bounds
    named = low if isinstance(low, dict) else {schema.fields[0].name if schema.pictures else "observation": low}
    return [(name, list(part.shape), part.dtype == np.uint8) for name, part in named.items()]


def onnx_model(policy: Policy, bounds: Bounds, *, clips: bool) -> Any:
    """ONNX model of a policy: from observations with the batch in front to `action`, normalised and clipped inside.

    Raises:
        InputError: onnx is not installed.
    """
    with needing("an export to ONNX needs the extra 'deploy': {}.", "deploy"):
        from onnx import TensorProto, checker, helper, numpy_helper

    weights, nodes = named_weights(policy, bounds), []
    constants = {"clip.high": np.float32(OBSERVATION_CLIP), "clip.low": np.float32(-OBSERVATION_CLIP)}

    def add(kind: str, parts: list[str], name: str, **settings: Any) -> str:
        nodes.append(helper.make_node(kind, parts, [name], **settings))
        return name

    def dense(x: str, layer: str) -> str:
        return add("Gemm", [x, f"{layer}.weight", f"{layer}.bias"], f"{layer}.sum")

    given = inputs(policy.schema)
    vectors = [name for name, _, picture in given if not picture]
    encoder = jax.tree.map(np.asarray, policy.parameters.encoder)
    parts = [_encoded(encoder, name, add, constants) for name, _, picture in given if picture]
    if parts and policy.parameters.memory:
        parts = _known_to_have_come(parts[0], next(name for name, _, picture in given if picture), add, constants)
    if vectors:
        parts.append(_observed(policy, vectors, weights, add, constants))
    x = parts[0] if len(parts) == 1 else add("Concat", parts, "features", axis=1)
    more = [(MEMORY, [policy.parameters.memory.size], False)] if policy.parameters.memory else []
    x = add("Concat", [x, _remembered(x, add)], "known", axis=1) if more else x
    last = len(policy.parameters.actor) - 1
    for i in range(last):
        x = add("Tanh", [dense(x, f"actor.{i}")], f"hidden.{i}")
    x = add("Mul", [dense(x, f"actor.{last}"), "action.half"], "displaced")
    x = add("Add", [x, "action.centre"], "unclipped" if clips else "action")
    if clips:
        add("Min", [add("Max", [x, "action.low"], "raised"), "action.high"], "action")
    used = {name for node in nodes for name in node.input}
    arrays = [
        numpy_helper.from_array(np.asarray(value), name)
        for name, value in (weights | constants).items()
        if name in used
    ]
    kinds = {True: TensorProto.UINT8, False: TensorProto.FLOAT}

    def described(rows: Any) -> list[Any]:
        return [helper.make_tensor_value_info(name, kinds[picture], ["batch", *shape]) for name, shape, picture in rows]

    results = [("action", [len(bounds[0])], False), *((AFTER, size, False) for _, size, _ in more)]
    graph = helper.make_graph(nodes, "policy", described([*given, *more]), described(results), arrays)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="reachlab")
    model.ir_version = IR
    checker.check_model(model, full_check=True)
    return model


def _known_to_have_come(points: str, name: str, add: Any, constants: dict[str, Any]) -> list[str]:
    """Features of a picture, zero of a black one, and whether it came."""
    constants |= {"most": np.float32(1), "shape.one": np.array([-1, 1], np.int64)}
    whitest = add("ReduceMax", [add("Cast", [name], "picture.pixels", to=1)], "whitest", axes=[1, 2], keepdims=0)
    came = add("Reshape", [add("Min", [whitest, "most"], "came.flat"), "shape.one"], "came")
    return [add("Mul", [points, came], "features.came"), came]


def _remembered(x: str, add: Any) -> str:
    """What is remembered after features, see `memory.Cell`."""

    def gate(name: str, kept: str) -> str:
        given = add("Gemm", [x, f"memory.{name}.given", f"memory.{name}.bias"], f"memory.{name}.in")
        return add("Add", [given, kept], f"memory.{name}.sum")

    kept = {name: add("MatMul", [MEMORY, f"memory.{name}.kept"], f"memory.{name}.known") for name in GATES}
    reset, keep = (add("Sigmoid", [gate(name, kept[name])], f"memory.{name}.open") for name in GATES[:2])
    counts = add("Mul", [reset, add("Add", [kept["new"], "memory.kept_bias"], "memory.new.biased")], "memory.counts")
    new = add("Tanh", [gate("new", counts)], "memory.new.value")
    change = add("Mul", [keep, add("Sub", [MEMORY, new], "memory.old")], "memory.change")
    return add("Add", [new, change], AFTER)


def _observed(
    policy: Policy, vectors: list[str], weights: dict[str, np.ndarray], add: Any, constants: dict[str, Any]
) -> str:
    """The normalised vector; where rows end it, the features of both."""
    vector, rows, row = vectors[0], "", policy.schema.row
    if len(vectors) > 1:
        vector = add("Concat", vectors, "vector", axis=1)
    if row:
        ends = {
            "nought": 0,
            "rows.begin": policy.schema.vector_size,
            "rows.end": np.iinfo(np.int64).max,
            "rows.axis": 1,
        }
        constants |= {name: np.array([value], np.int64) for name, value in ends.items()}
        constants |= {"rows.shape": np.array([0, -1, row], np.int64)}
        first = np.split(weights["encoder.0.weight"], [row])
        constants |= dict(zip(("encoder.0.row", "encoder.0.beside"), first, strict=True))
        numbers = add("Slice", [vector, "rows.begin", "rows.end", "rows.axis"], "rows.numbers")
        rows = add("Reshape", [numbers, "rows.shape"], "rows")
        vector = add("Slice", [vector, "nought", "rows.begin", "rows.axis"], "vector.own")
    scaled = add("Div", [add("Sub", [vector, "normaliser.mean"], "shifted"), "normaliser.scale"], "scaled")
    normalised = add("Clip", [scaled, "clip.low", "clip.high"], "normalised")
    encoder = policy.parameters.encoder
    return _pooled(len(encoder.layers), normalised, rows, add) if encoder and rows else normalised


def _pooled(layers: int, vector: str, rows: str, add: Any) -> str:
    """Features of a vector and rows `[batch, K, row]`, see `encoder.Pooled`."""
    given = add("Gemm", [vector, "encoder.0.beside", "encoder.0.bias"], "rows.beside")
    given = add("Unsqueeze", [given, "rows.axis"], "rows.every")
    each = add("Add", [add("MatMul", [rows, "encoder.0.row"], "rows.given"), given], "rows.sum")
    each = add("MatMul", [add("Relu", [each], "rows.out"), "encoder.1.weight"], "rows.kept")
    each = add("Add", [each, "encoder.1.bias"], "rows.each")
    x = add("Tanh", [add("ReduceMax", [each], "rows.most", axes=[1], keepdims=0)], "rows.pooled")
    x = add("Concat", [vector, x], "encoder.joined", axis=1)
    for i in range(2, layers):
        x = add("Gemm", [x, f"encoder.{i}.weight", f"encoder.{i}.bias"], f"encoder.{i}.sum")
        x = add("Relu", [x], f"encoder.{i}.out")
    return x


def _encoded(encoder: Encoder, name: str, add: Any, constants: dict[str, Any]) -> str:
    """Features of a picture."""
    if isinstance(encoder, Keypoints):
        return _located(encoder, name, add, constants)
    side = SIZE // PATCH
    shapes = {"cut": [-1, side, PATCH, side, PATCH], "squares": [-1, PATCH**2], "whole": [-1, side**2 * CHANNELS]}
    constants |= {f"shape.{shape}": np.array(sizes, np.int64) for shape, sizes in shapes.items()}
    x = add("Reshape", [_centred(name, add, constants), "shape.cut"], "picture.cut")
    x = add("Transpose", [x], "picture.turned", perm=[0, 1, 3, 2, 4])
    x = add("Reshape", [x, "shape.squares"], "picture.squares")
    for i, shape in enumerate(("whole", "")):
        x = add("Gemm", [x, f"encoder.{i}.weight", f"encoder.{i}.bias"], f"encoder.{i}.sum")
        x = add("Relu", [x], f"encoder.{i}.out")
        x = add("Reshape", [x, f"shape.{shape}"], "encoder.joined") if shape else x
    return add("Gemm", [x, "encoder.2.weight", "encoder.2.bias"], "encoder.2.sum")


def _located(encoder: Keypoints, name: str, add: Any, constants: dict[str, Any]) -> str:
    """Where points are in a picture, see `encoder.Keypoints`."""
    sides = (CELL, *[3] * (len(encoder.layers) - 2), 1)
    points, cells = encoder.features // 2, (SIZE // CELL) ** 2
    shapes = {"whole": [-1, 1, SIZE, SIZE], "cells": [-1, points, 3, cells], "shares": [-1, points, 1, cells]}
    constants |= {f"shape.{shape}": np.array(sizes, np.int64) for shape, sizes in shapes.items()}
    constants |= {"shape.points": np.array([-1, 2 * points], np.int64), "middles": np.array(middles(SIZE).T)}
    constants |= {"sharpness": np.float32(SHARPNESS), "cell": np.float32(2 * CELL / SIZE), "last": np.array([3])}
    constants |= {"scored": np.array([2]), "first": np.array([0]), "second": np.array([1]), "third": np.array([3])}
    x = add("Reshape", [_centred(name, add, constants), "shape.whole"], "picture.whole")
    for i, ((weight, _), side) in enumerate(zip(encoder.layers, sides, strict=True)):
        kernel = weight.reshape(side, side, -1, weight.shape[1]).transpose(3, 2, 0, 1)
        constants[f"kernel.{i}"] = np.ascontiguousarray(kernel)
        settings = {"strides": [CELL, CELL]} if i == 0 else {"pads": [side // 2] * 4}
        x = add("Conv", [x, f"kernel.{i}", f"encoder.{i}.bias"], f"encoder.{i}.sum", **settings)
        x = add("Relu", [x], f"encoder.{i}.out") if i < len(sides) - 1 else x
    x = add("Reshape", [x, "shape.cells"], "cells")
    scores = add("Squeeze", [add("Slice", [x, "first", "second", "scored"], "scores"), "scored"], "scores.flat")
    shares = add("Softmax", [add("Mul", [scores, "sharpness"], "scores.sharp")], "shares", axis=-1)
    offsets = add("Mul", [add("Slice", [x, "second", "third", "scored"], "offsets"), "cell"], "offsets.far")
    places = add("Add", [offsets, "middles"], "places")
    weighted = add("Mul", [add("Reshape", [shares, "shape.shares"], "shares.each"), places], "places.weighted")
    return add("Reshape", [add("ReduceSum", [weighted, "last"], "points", keepdims=0), "shape.points"], "points.flat")


def _centred(name: str, add: Any, constants: dict[str, Any]) -> str:
    """Pixels in ±0.5."""
    constants |= {"white": np.float32(WHITE), "grey": np.float32(0.5)}
    scaled = add("Div", [add("Cast", [name], "picture.float", to=1), "white"], "picture.scaled")
    return add("Sub", [scaled, "grey"], "picture.centred")
