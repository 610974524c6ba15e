"""Functions printed as straight code: they compute what JAX does, in Python and in C, and take any input."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import ShapeDtypeStruct

from faults.c_sources import SANITIZED, hostile_inputs, same_decisions
from faults.controllers import written
from reachlab.deploy import c_source
from reachlab.deploy.c_library import FLAGS, compiler
from reachlab.deploy.onboard.controller import Controller
from reachlab.emit.braced import c_declarations, c_function
from reachlab.emit.program import Program, constants_of
from reachlab.emit.python import to_python
from reachlab.emit.tracing import trace
from reachlab.settings.validation import InputError

SIZES = (3, 40)
"""Numbers of an input: of few each is a variable, of many they are an array."""

MATRIX = np.random.default_rng(0).normal(size=(40, 20)).astype(np.float32)


def powers(a: Any, b: Any) -> Any:
    return jnp.abs(a) ** b + a**3 + 1 / (2 + a**2) + jnp.exp(a) - jnp.log1p(0.0) + jnp.log(jnp.abs(b) + 0.1)


def angles(a: Any, b: Any) -> Any:
    waves = jnp.sin(a) * jnp.cos(b) + jnp.tan(0.3 * a) + jnp.arctan2(a, b) + jnp.arctan(b)
    return waves + jnp.arcsin(jnp.clip(a, -1, 1)) + jnp.arccos(jnp.clip(b, -0.9, 0.9)) + jnp.tanh(a)


def choices(a: Any, b: Any) -> Any:
    inside = (a > b) & (a != 0.5) | ~(b >= 0.2)
    return jnp.where(inside, jnp.maximum(a, b), jnp.minimum(a, b)) + jnp.sign(a) + jnp.isfinite(b) * jnp.floor(3 * a)


def wholes(a: Any, b: Any) -> Any:
    number = jnp.round(4 * a).astype(jnp.int32)
    return number % 3 + number // 2 + jnp.ceil(b) + jnp.mod(a, 0.7) + jax.nn.sigmoid(a)


def places(a: Any, b: Any) -> Any:
    chosen = jnp.argmax(a)
    there = jax.lax.dynamic_slice(b, (chosen,), (2,))
    return jnp.concatenate([there, a[jnp.argmin(b)][None], a[::-1][:2], b.at[1].set(7.0)[:2], jnp.cumsum(a)[-1:]])


def loops(a: Any, b: Any) -> Any:
    def halve(_: int, limits: Any) -> Any:
        low, high = limits
        middle = (low + high) / 2
        return jnp.where(middle < b, middle, low), jnp.where(middle < b, high, middle)

    low, high = jax.lax.fori_loop(0, 5, halve, (a, a + 1.0))
    count, total = jax.lax.while_loop(
        lambda carry: (carry[0] < 9) & (carry[1].sum() < 20.0),
        lambda carry: (carry[0] + 1, carry[1] + jnp.abs(a)),
        (jnp.zeros((), jnp.int32), jnp.abs(b)),
    )
    sums, kept = jax.lax.scan(lambda total, x: (total + x, total * x), jnp.zeros(()), a)
    return low + high + total + count + sums + kept.sum() + jax.lax.cond(a[0] > 0, jnp.sin, jnp.cos, b)


def products(a: Any, b: Any) -> Any:
    layer = jnp.tanh(jnp.concatenate([a, b, jnp.zeros(80)])[:40] @ MATRIX)
    small = jnp.einsum("bij,bj->bi", jnp.stack([jnp.outer(a[:2], b[:2])] * 2), jnp.stack([a[:2], b[:2]]))
    return jnp.concatenate([layer, small.ravel()])


def gradients(a: Any, b: Any) -> Any:
    def value(a: Any) -> Any:
        return jnp.stack([a[0] * a[1:3], a[::2][:2], jnp.sin(a[:2])]).min(axis=0).sum()

    return jnp.pad(jax.grad(value)(a), (1, 2)) + jax.lax.pad(b, 0.5, ((2, 1, 0),))


def numbers_and_places(a: Any, b: Any) -> Any:
    """Whole numbers that are places, and others, chosen at once."""
    choices = (a < b, b, a), (a < 0, a, b), (b < 0, a, b), (a < 1, b, a), (b < 1, b, a)
    numbers = [jnp.where(*one) for one in choices]
    places = jnp.where(a < b, 2, jnp.arange(a.size) % 3)
    return sum(numbers) * numbers[0][places[1]] + places


def random_of_a_key(a: Any, b: Any) -> Any:
    return a * jax.random.uniform(jax.random.key(3), a.shape) + b


def kinds(a: Any, b: Any) -> Any:
    """Constants whose kind Python's numbers do not say."""
    mask = ~(a > 0).at[1].set(True)
    steps = jnp.where(a > 0, 0.5, jnp.arange(float(a.size)))
    signs = jnp.where(b > 0, 2.5, jnp.sign(jnp.full(a.size, 3.0)))
    return jnp.where(mask, a, b) + steps / 3 + signs / 2 + a[jnp.array([1, 2])[b[:1].astype(jnp.int32) * 0] ** 2 % 3]


def nothing(a: Any, b: Any) -> Any:
    """Sums, products and choices of no numbers."""
    none, no_row = b[:0], jnp.zeros((0, a.size))
    some = none.sum() + none.prod() + jnp.cumsum(none).size + jnp.any(none > 0) + jnp.all(none > 0)
    kept = jax.lax.scan(lambda total, x: (total + x, 2 * x), 0.0, none)
    return a + some + none @ no_row + (no_row @ b).size + kept[0] + kept[1].size + jnp.min(none, initial=2.0)


def takes(a: Any, b: Any) -> Any:
    """Places beyond an array, which are NaN by `take` and the nearest by an index."""
    here = jnp.round(3 * a[:3]).astype(jnp.int32)
    return jnp.concatenate([jnp.take(b, here), jnp.take(b, jnp.array([1, 99])), b[here], jnp.take(here, here) > 0])


FUNCTIONS: dict[str, Callable[[Any, Any], Any]] = {
    one.__name__: one
    for one in (
        powers,
        angles,
        choices,
        wholes,
        places,
        loops,
        products,
        gradients,
        numbers_and_places,
        random_of_a_key,
        kinds,
        nothing,
        takes,
    )
}


def program_of(name: str, size: int) -> Program:
    shape = ShapeDtypeStruct((size,), jnp.float32)
    return trace(
        "f", lambda a, b: {"result": jnp.asarray(FUNCTIONS[name](a, b), jnp.float32)}, {"a": shape, "b": shape}
    )


def in_python(program: Program) -> Callable[..., Any]:
    constants = {name: array.ravel() for name, array in constants_of([program]).items()}
    names: dict[str, Any] = {
        "CONSTANTS": {k: v.astype(float) if v.dtype.kind == "f" else v for k, v in constants.items()}
    }
    exec(to_python([program]), names)
    return names["f"]


def in_c(program: Program, build: Path) -> Callable[..., Any]:
    frame = (Path(c_source.__file__).parent / "c" / "reachlab_policy.c").read_text()
    head = frame[frame.index("#include <limits.h>") : frame.index("{{functions}}")].replace("reachlab_real", "double")
    given = ", ".join(f"const {one}" for one in c_declarations(program.inputs))
    size = len(program.outputs[0].atoms)
    call = f"void call({given}, real result[{size}]) {{ f(a, b, result); }}"
    (build / "f.c").write_text(f"{head}\n{c_function(program)}\nvoid call({given}, real result[{size}]);\n{call}\n")
    library = build / "f.so"
    subprocess.run([str(compiler()), *FLAGS, "-O2", "-o", str(library), str(build / "f.c"), "-lm"], check=True)
    called = ctypes.CDLL(str(library)).call

    def function(a: list[float], b: list[float]) -> tuple[list[float]]:
        result = (ctypes.c_double * size)()
        called((ctypes.c_double * len(a))(*a), (ctypes.c_double * len(b))(*b), result)
        return (list(result),)

    return function


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_is_printed_computes_what_jax_does(name: str, size: int, tmp_path: Path) -> None:
    program, random = program_of(name, size), np.random.default_rng(1)
    printed = [in_python(program), *([in_c(program, tmp_path)] if compiler() else [])]
    for _ in range(20):
        a, b = random.normal(size=(2, size)).astype(np.float32)
        expected = np.asarray(FUNCTIONS[name](jnp.asarray(a), jnp.asarray(b)))
        results = [np.array(one(a.tolist(), b.tolist())[0]) for one in printed]
        assert results[0] == pytest.approx(expected, rel=2e-5, abs=2e-5, nan_ok=True)
        for other in results[1:]:
            assert other == pytest.approx(results[0], rel=1e-12, abs=1e-12, nan_ok=True)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("number", [np.inf, -np.inf, np.nan])
def test_what_is_not_finite_raises_nothing(size: int, number: float) -> None:
    a = np.full(size, number)
    functions = jnp.sin, jnp.cos, jnp.tan, jnp.floor, jnp.ceil, jnp.round, lambda a: jnp.mod(a, 2.0)
    functions += (lambda a: a.astype(jnp.int32).astype(float) * 1e-6,)
    for function in functions:
        shape = ShapeDtypeStruct((size,), jnp.float32)
        program = trace("f", lambda a, function=function: {"result": function(a)}, {"a": shape})
        with np.errstate(invalid="ignore"):
            found = in_python(program)(a)
        np.testing.assert_allclose(np.ravel(found), function(jnp.asarray(a, jnp.float32)), rtol=1e-6)


def test_small_whole_numbers_of_real_ones_are_refused() -> None:
    with pytest.raises(InputError, match=r"makes uint8 of real numbers, which cannot be printed: use int32 there"):
        trace("f", lambda a: {"result": (40 * a).astype(jnp.uint8)}, {"a": ShapeDtypeStruct((3,), jnp.float32)})


def test_what_a_result_does_not_need_is_not_printed() -> None:
    shape = ShapeDtypeStruct((3,), jnp.float32)
    whole = trace("f", lambda a, b: {"result": a + 0.0 * jnp.exp(b)}, {"a": shape, "b": shape})
    assert len(whole.body) == 0
    twice = trace("f", lambda a, b: {"result": jnp.sin(a) * jnp.sin(a) + b}, {"a": shape, "b": shape})
    assert to_python([twice]).count("= sin(") == 3


def test_names_that_are_read_no_more_are_given_again() -> None:
    def waves(a: Any, b: Any) -> dict[str, Any]:
        for _ in range(50):
            a, b = jnp.sin(a) + b, a
        return {"result": a}

    shape = ShapeDtypeStruct((3,), jnp.float32)
    text = to_python([trace("f", waves, {"a": shape, "b": shape})])
    assert text.count("= sin(") == 150
    assert len(set(re.findall(r"\bv\d+", text))) < 15


# --- the C sources of an export -------------------------------------------------------------------

needs_compiler = pytest.mark.skipif(compiler() is None, reason="needs a C compiler")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("precise") / "policy", "precise")


@needs_compiler
def test_c_decides_as_python_does_and_keeps_every_limit_whatever_it_is_given(folder: Path) -> None:
    assert same_decisions(folder, 1500).wrong == []
    assert hostile_inputs(folder, 3000).wrong == []


@needs_compiler
@pytest.mark.parametrize("flags", [SANITIZED, ["-O2"]], ids=["sanitized", "as_its_head_says"])
def test_the_example_in_c_prints_the_commands_of_a_log(folder: Path, tmp_path: Path, flags: list[str]) -> None:
    controller = Controller(folder)  # without a reset it begins at home
    q, qd, commands = controller.home, 0 * controller.home, []
    for number in range(160):
        if number == 70:
            controller.stop()
        if number == 100:
            controller.reset(q)
        goal = [0.5, 0.2, 0.4] if number < 60 else [0.45, -0.2, 0.5]
        command = controller.step(q, qd, goal, number * controller.period)
        commands.append(command)
        q, qd = command, (command - q) / controller.period
    controller.save_log(tmp_path / "log.jsonl")
    sources = [str(folder / name) for name in ("main.c", "reachlab_policy.c")]
    subprocess.run([str(compiler()), *flags, "-o", str(tmp_path / "policy"), *sources, "-lm"], check=True)
    done = subprocess.run(
        [str(tmp_path / "policy"), str(tmp_path / "log.jsonl")], capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    printed = np.array([[float(number) for number in line.split()] for line in done.stdout.splitlines()])
    assert printed == pytest.approx(np.array(commands), abs=1e-9)


@needs_compiler
def test_the_example_in_c_stays_where_a_goal_is_out_of_reach(tmp_path: Path) -> None:
    folder = written(tmp_path / "policy", "pose")
    controller = Controller(folder)
    for number in range(40):
        goal = [5.0, 5.0, 5.0, 1.0, 0.0, 0.0, 0.0]
        controller.step(controller.home, 0 * controller.home, goal, number * controller.period)
    assert "is out of the workspace" in controller.problem
    controller.save_log(tmp_path / "log.jsonl")
    sources = [str(folder / name) for name in ("main.c", "reachlab_policy.c")]
    subprocess.run([str(compiler()), "-O1", "-o", str(tmp_path / "policy.out"), *sources, "-lm"], check=True)
    words = [str(tmp_path / "policy.out"), str(tmp_path / "log.jsonl")]
    printed = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    commands = np.array([[float(number) for number in line.split()] for line in printed.splitlines()])
    assert commands == pytest.approx(np.tile(controller.home, (40, 1)), abs=1e-9)


@needs_compiler
@pytest.mark.parametrize(
    ("task", "told"), [("precise", "is no log of Controller.save_log"), ("clutter", "does not read bodies_kind, ")]
)
def test_the_example_in_c_refuses_what_it_cannot_read(task: str, told: str, folder: Path, tmp_path: Path) -> None:
    folder = folder if task == "precise" else written(tmp_path / "policy", task)
    sources = [str(folder / name) for name in ("main.c", "reachlab_policy.c")]
    words = [
        str(compiler()),
        "-Wall",
        "-Wextra",
        "-Werror",
        "-std=c99",
        "-pedantic",
        "-o",
        str(tmp_path / "policy.out"),
    ]
    subprocess.run([*words, *sources, "-lm"], check=True)
    done = subprocess.run([str(tmp_path / "policy.out"), __file__], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert told in done.stderr


@needs_compiler
def test_the_header_is_one_of_cpp_too(folder: Path, tmp_path: Path) -> None:
    if (cpp := shutil.which("c++")) is None:
        pytest.skip("needs a C++ compiler")
    (tmp_path / "a.cpp").write_text('#include "reachlab_policy.h"\nint main() { return REACHLAB_OK; }\n')
    words = [cpp, "-Wall", "-Wextra", "-Werror", "-pedantic", "-std=c++11", f"-I{folder}", "-fsyntax-only"]
    done = subprocess.run([*words, str(tmp_path / "a.cpp")], capture_output=True, text=True, check=False)
    assert done.stderr == ""


@needs_compiler
def test_single_precision_compiles_without_a_warning(folder: Path, tmp_path: Path) -> None:
    source, library = str(folder / "reachlab_policy.c"), str(tmp_path / "f.so")
    words = [str(compiler()), *FLAGS, "-O2", "-DREACHLAB_FLOAT", "-o", library, source, "-lm"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.stderr == ""
