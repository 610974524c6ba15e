"""Traced functions that are kept: read by who comes later, made anew where they do not fit, and never of effect."""

from __future__ import annotations

import errno
import hashlib
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import reachlab
from reachlab import traced
from reachlab.jax_setup import CACHE, use_compilation_cache
from reachlab.settings import extensions


class Pair(NamedTuple):
    """A node of a pytree."""

    one: jax.Array
    other: Any


class Empty(NamedTuple):
    """A node without parts, as optimisers have."""


@pytest.fixture(name="folder")
def _folder(tmp_path: Path) -> Iterator[Path]:
    """Folder in which traces are kept while the test lasts."""
    traced.keep_in(tmp_path)
    yield tmp_path
    traced.keep_in(None)


class Counted:
    """A function that counts how often it is traced."""

    def __init__(self) -> None:
        """Function that was not traced yet."""
        self.traces = 0

    def __call__(self, x: jax.Array, more: dict[str, jax.Array]) -> tuple[Pair, list[jax.Array], Empty, None]:
        """Some nodes of all kinds."""
        self.traces += 1
        return Pair(jnp.sin(x) + more["b"], {"a": (x * 2, None), "given": more["b"]}), [x.sum(), x], Empty(), None


X, MORE = jnp.arange(4.0), {"b": jnp.array(3.0)}


def run(function: Any, *settings: object) -> Any:
    """What a function gives, by a program of its own, as in a process of its own."""
    jax.clear_caches()
    return jax.jit(traced.kept(function, "test", *settings))(X, MORE)


def test_a_function_is_traced_once_and_gives_the_same(folder: Path) -> None:
    function, plain = Counted(), Counted()(X, MORE)
    first, second = run(function), run(function)
    assert function.traces == 1
    assert len(list(folder.glob("*.traced"))) == 1
    assert jax.tree.structure(second) == jax.tree.structure(plain)
    for one, other in ((first, second), (first, plain)):
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
            np.testing.assert_array_equal(a, b)


def test_other_settings_and_shapes_have_entries_of_their_own(folder: Path) -> None:
    function = Counted()
    run(function, "panda")
    run(function, "ur5e")
    jax.jit(traced.kept(function, "test", "panda"))(X[:2], MORE)
    assert function.traces == 3
    assert len(list(folder.glob("*.traced"))) == 3


def cut(content: bytes) -> bytes:
    return content[: len(content) // 2]


def flipped(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


def foreign(content: bytes) -> bytes:
    """An entry whose checksum is right and whose rest is not."""
    rest = b'{"type": ["nowhere", "Nothing"], "parts": {}}\n' + content[-40:]
    return hashlib.sha256(rest).digest() + rest


@pytest.mark.parametrize("damage", [cut, flipped, foreign, lambda _: b"", lambda _: b"{}\n"])
def test_what_is_damaged_is_made_anew(folder: Path, damage: Any) -> None:
    function = Counted()
    expected = run(function)
    (entry,) = folder.glob("*.traced")
    whole = entry.read_bytes()
    entry.write_bytes(damage(whole))
    np.testing.assert_array_equal(run(function)[0].one, expected[0].one)
    assert function.traces == 2
    run(function)
    assert function.traces == 2


def test_where_there_is_no_room_nothing_is_left(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_path: Path, _target: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "replace", full)
    run(Counted())
    assert not list(folder.iterdir())


def test_programs_that_a_full_disk_left_empty_are_removed(folder: Path) -> None:
    before = jax.config.values[CACHE]
    (folder / "jit_left-cache").touch()
    (folder / "jit_whole-cache").write_text("whole")
    jax.config.update(CACHE, str(folder))
    try:
        use_compilation_cache()
    finally:
        jax.config.update(CACHE, before)
        use_compilation_cache()
    assert [one.name for one in folder.glob("*-cache")] == ["jit_whole-cache"]


def test_what_names_an_object_of_this_process_is_not_kept(folder: Path) -> None:
    function = Counted()
    run(function, object())
    run(function, object())
    assert function.traces == 2
    assert not list(folder.iterdir())


def test_what_calls_a_function_of_this_process_is_not_kept(folder: Path) -> None:
    def calling(x: jax.Array, more: dict[str, jax.Array]) -> jax.Array:
        jax.debug.callback(lambda _: None, more["b"])
        return x + more["b"]

    np.testing.assert_array_equal(run(calling), X + 3)
    assert not list(folder.glob("*.traced"))


def test_with_an_extension_nothing_is_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extensions, "IMPORTED", ["mine.py"])
    run(Counted())
    assert not list(folder.iterdir())


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    traced.keep_in(tmp_path / "file" / "below")
    try:
        assert run(Counted())[3] is None
    finally:
        traced.keep_in(None)


def test_old_entries_go(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(traced, "MOST", 3)
    for number in range(5):
        run(Counted(), number)
    assert len(list(folder.glob("*.traced"))) == 3


def test_what_is_static_is_that_of_the_arguments(folder: Path) -> None:
    policy = reachlab.load("iiwa14/tutorial").policy
    for _ in range(2):
        given = jax.jit(traced.kept(lambda policy: replace(policy, centre=policy.centre + 1), "test"))(policy)
        assert given.schema is policy.schema
        np.testing.assert_array_equal(given.centre, policy.centre + 1)
        jax.clear_caches()
    assert len(list(folder.iterdir())) == 1


@pytest.mark.slow
@pytest.mark.parametrize("task", ["tutorial", "precise"])
def test_weights_are_the_same_to_the_last_bit(tmp_path: Path, task: str) -> None:
    weights = []
    library = "import sys, reachlab; reachlab.train(reachlab.configure(sys.argv[1], total_steps=20000), sys.argv[2])"
    command = [sys.executable, "-m", "reachlab", "train", "--task", task, "--total-steps", "20000", "--out"]
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    for number, called in enumerate([command, command, [sys.executable, "-c", library, task]]):
        out = tmp_path / str(number)
        subprocess.run([*called, str(out)], env=environment, check=True, capture_output=True)
        weights.append(next(out.glob("checkpoints/*/state.safetensors")).read_bytes())
    assert list((tmp_path / "cache").rglob("*.traced"))
    assert weights[0] == weights[1] == weights[2]


CACHED = (
    "import jax, sys, reachlab; sys.argv[1:] and jax.config.update('jax_compilation_cache_dir', sys.argv[1]);"
    " reachlab.Env(reachlab.configure(), 1); print(jax.config.values['jax_compilation_cache_dir'])"
)
"""Prints where programs are kept once there is an environment."""


@pytest.mark.parametrize("kept", ["by default", "elsewhere", "nowhere"])
def test_from_python_programs_are_kept_where_nobody_says_otherwise(tmp_path: Path, kept: str) -> None:
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    own, words = tmp_path / "reachlab" / "jax", [str(tmp_path / "mine")] if kept == "elsewhere" else []
    if kept == "nowhere":  # a file stands where the folder would be
        own.parent.mkdir()
        own.write_text("")
    done = subprocess.run(
        [sys.executable, "-c", CACHED, *words], env=environment, check=True, capture_output=True, text=True
    )
    expected = {"by default": str(own), "elsewhere": str(tmp_path / "mine"), "nowhere": "None"}[kept]
    assert done.stdout.split()[-1] == expected
