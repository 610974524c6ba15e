"""Tests of how what compiled programs give is handed over."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reachlab.envs.packing import Apart, Computed, Packed, PackedResults, alike

COUNTS = (1, 2, 17)
"""Environments: packed, each array by itself, and packed again."""


def everything(keys: Any) -> tuple[dict[str, Any], tuple[Any, ...]]:
    """Two pytrees: of numbers of 32 bits, truths, keys and nothing; and of other numbers."""
    count = len(keys)
    whole = jnp.arange(count * 6, dtype=jnp.int32)
    plain = {
        "keys": keys,
        "numbers": jnp.sin(whole.astype(jnp.float32)).reshape(count, 3, 2),
        "counts": whole[:count] - 1,
        "truths": whole.reshape(count, 6) % 2 == 0,
        "nothing": jnp.zeros((count, 0, 3)),
    }
    return plain, (whole[:count].astype(jnp.int8), plain["numbers"][:, 0].astype(jnp.float16))


@pytest.mark.parametrize("count", COUNTS)
def test_what_is_packed_comes_out_as_it_was(count: int) -> None:
    keys = jax.random.split(jax.random.key(0), count)
    with jax.checking_leaks():
        handed = PackedResults(everything, count)
        packed = handed(keys)
    assert [type(one) for one in handed.packings] == [Apart if count == 2 else Packed, Apart]
    for packing, one, expected in zip(handed.packings, packed, everything(keys), strict=True):
        for found in (packing.in_jax(one), jax.jit(packing.unpack)(one)):
            assert jax.tree.all(jax.tree.map(lambda a, b: a.dtype == b.dtype and (a == b).all(), found, expected))
    plain = dict(everything(keys)[0], keys=jnp.zeros(count))  # keys are not taken by the host
    without_keys = PackedResults(lambda: (plain,), count)
    (one,) = without_keys()
    taken = without_keys.packings[0].taken(one, in_numpy=True)
    for name, leaf in taken.items():
        assert isinstance(leaf, np.ndarray)
        assert leaf.dtype == plain[name].dtype
        np.testing.assert_array_equal(leaf, plain[name])


@pytest.mark.parametrize("count", COUNTS)
def test_what_is_compiled_ahead_has_the_shapes_that_it_gives_and_is_compiled_once(count: int) -> None:
    traces: list[Any] = []

    def traced(keys: Any, held: Any) -> Any:
        traces.append(keys)
        return *everything(keys), held

    keys, held = jax.random.split(jax.random.key(0), count), np.arange(count, dtype=np.int32)
    handed, computed = PackedResults(traced, count), Computed(traced)
    for function in (handed, computed):
        shapes = function.ahead(jax.eval_shape(lambda: keys), alike(held))
        found = function(keys, held)
        same = jax.tree.map(lambda a, b: (a.shape, a.dtype) == (b.shape, b.dtype), shapes, found)
        assert jax.tree.all(same)
    assert len(traces) == 2
    assert computed(keys, held)[2] is held


@pytest.mark.parametrize("count", COUNTS)
def test_zeros_are_packed_like_what_they_stand_for(count: int) -> None:
    handed = PackedResults(everything, count)
    packed = handed(jax.random.split(jax.random.key(0), count))
    for packing, one in zip(handed.packings, packed, strict=True):
        alike = jax.tree.map(lambda a, b: (a.shape, a.dtype) == (b.shape, b.dtype), packing.zeros, one)
        assert jax.tree.all(alike)


def test_what_a_function_is_given_is_not_handed_over_again_and_any_librarys_arrays_share_a_program() -> None:
    traced = []

    def function(given: dict[str, Any], more: Any) -> tuple[Any, ...]:
        traced.append(given)
        return given, {"sum": given["x"] + more, "nothing": jnp.zeros((3, 0), jnp.int32)}, given["key"]

    computed, device = Computed(function), jax.devices()[0]
    plain = {"x": np.arange(3.0, dtype=np.float32), "key": jax.random.split(jax.random.key(1), 3)}
    for change in (np.asarray, jnp.asarray, lambda x: jax.device_put(x, device)):
        given = dict(plain, x=change(plain["x"]))
        same, new, key = computed(given, np.float32(2.0))
        assert same["x"] is given["x"]
        assert same["key"] is key is given["key"]
        np.testing.assert_array_equal(new["sum"], [2, 3, 4])
        assert (new["nothing"].shape, new["nothing"].dtype) == ((3, 0), np.int32)
    assert len(traced) == 1
    (_, new, _) = computed({"x": np.arange(3), "key": plain["key"]}, np.int32(1))
    assert new["sum"].dtype == np.int32
    np.testing.assert_array_equal(new["sum"], [1, 2, 3])
    assert len(traced) == 2
