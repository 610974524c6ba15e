"""What a run of the tests costs, by file, in units of the same machine; and which tests `make check` leaves out."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

from reachlab.jax_setup import BRIEF_OPTIONS

SLOWEST = 10
"""Files that are listed."""

PROGRAM = "/jax/core/compile/backend_compile_duration"
CACHED = "/jax/compilation_cache/cache_hits"
"""Events of JAX: a program was compiled or taken from the cache; one was taken from the cache."""

WORTH_KEEPING = 0.1
"""A program that takes longer to compile counts [s]: shorter ones are single operations."""

OPERATIONS = 200
"""Of the program whose compilation is the unit of CPU time, about a second."""

LONG, OTHER_PROCESS = 0.5, 0.05
"""A test is long if it takes more units, or if processes that it starts take so many [units]."""

START = "starting and collecting"

LIST = Path(__file__).with_name("long_tests.txt")


def cpu_times() -> Counter[str]:
    """CPU time of this process and of those that it has waited for, and of the latter alone [s]."""
    own = os.times()
    children = own.children_user + own.children_system
    return Counter({"cpu": own.user + own.system + children, "children": children})


def unit() -> float:
    """CPU time that this machine takes to compile a program of `OPERATIONS` operations [s]."""

    def program(x: jax.Array) -> jax.Array:
        for number in range(OPERATIONS):
            x = jnp.sin(x @ x + number)
        return x

    jax.config.update("jax_enable_compilation_cache", False)
    lowered = jax.jit(program, compiler_options=BRIEF_OPTIONS).lower(jnp.zeros((8, 8)))
    begin = cpu_times()["cpu"]
    lowered.compile()
    jax.config.update("jax_enable_compilation_cache", True)
    return cpu_times()["cpu"] - begin


class Costs:
    """Counts in the processes that run tests, and adds up in the one that prints."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._prints = not hasattr(config, "workerinput")
        self._unit = unit() if self._prints else 1.0
        self._events: Counter[str] = Counter()
        self._before: Counter[str] = Counter()
        self._cached = False
        self._files: dict[str, Counter[str]] = {}
        self._long: set[str] = set()
        jax.monitoring.register_event_listener(self._event)
        jax.monitoring.register_event_duration_secs_listener(self._duration)

    def _event(self, event: str, **_: object) -> None:
        self._cached |= event == CACHED

    def _duration(self, event: str, duration_secs: float, **_: object) -> None:
        if event == PROGRAM:
            self._events["programs"] += duration_secs > WORTH_KEEPING and not self._cached
            self._cached = False

    def _since(self) -> Mapping[str, float]:
        """What was spent since this was last asked for."""
        now = Counter(self._events)
        now.update(cpu_times())
        spent = {kind: now[kind] - self._before[kind] for kind in now}
        self._before = now
        return spent

    def pytest_collection_finish(self) -> None:
        self._started = self._since()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self) -> Iterator[None]:
        report = yield
        report.costs, self._started = [(report.location[0], self._since()), (START, self._started)], {}
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        costs = getattr(report, "costs", [])  # from the hook above, but for a test whose process crashed
        for file, cost in costs:
            self._files.setdefault(file, Counter()).update(cost)
        for _, cost in costs[:1]:
            self._note(report.nodeid, cost)

    def _note(self, nodeid: str, cost: Counter[str]) -> None:
        if cost["cpu"] > LONG * self._unit or cost["children"] > OTHER_PROCESS * self._unit:
            self._long.add(function_of(nodeid))

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        if not self._prints or not self._files:
            return
        total = sum(self._files.values(), Counter[str]())
        line, units = terminalreporter.write_line, total["cpu"] / self._unit
        programs = total["programs"]
        line(f"\nCPU {total['cpu']:.0f} s, {units:.0f} units of {self._unit:.2f} s; {programs} programs compiled")
        for name, cost in sorted(self._files.items(), key=lambda one: -one[1]["cpu"])[:SLOWEST]:
            line(f"{cost['cpu'] / self._unit:7.1f} units {cost['programs']:4d} programs  {name}")
        if self._config.getoption("--note-long"):
            LIST.write_text("".join(f"{name}\n" for name in sorted(long_tests() | self._long)))


def function_of(nodeid: str) -> str:
    """File and function of a test, whatever its parameters."""
    return Path(nodeid.split("[")[0]).name


def long_tests() -> set[str]:
    """Tests that were found to be long, by file and function."""
    return set(LIST.read_text().split())


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--note-long", action="store_true", help=f"add the tests that prove long to {LIST.name}")


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(Costs(config))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what takes long, so that `make check` leaves it out."""
    known = long_tests()
    for item in items:
        if function_of(item.nodeid) in known:
            item.add_marker(pytest.mark.long)
