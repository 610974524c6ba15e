"""Signals that ask a command to end."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

from reachlab.cli import main as cli
from reachlab.cli.flags import List
from reachlab.cli.verbs import VERBS, Verb
from reachlab.learn.interrupts import ASKING, Interrupted, Interrupts, hear, raise_on_termination, spared


@pytest.fixture(autouse=True)
def _handlers() -> Iterator[None]:
    """Signals as a terminal gives them: below `nohup`, or in the background, some are ignored."""
    before = {number: signal.getsignal(number) for number in ASKING}
    for number in ASKING:
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_every_command_that_is_asked_to_end_says_one_line_and_which_signal_it_was(
    number: int, status: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(VERBS, "list", Verb(List, lambda _: signal.raise_signal(number)))
    assert cli.main(["list"]) == status
    assert capsys.readouterr() == ("", "reachlab: interrupted.\n")


def test_where_nothing_would_be_lost_the_first_signal_raises() -> None:
    with Interrupts() as interrupts:
        interrupts.at_once = True
        with pytest.raises(Interrupted) as raised:
            signal.raise_signal(signal.SIGTERM)
    assert (raised.value.status, interrupts.received) == (143, signal.SIGTERM)


def test_while_a_library_is_imported_a_signal_waits() -> None:
    raise_on_termination()
    imported = []

    def load() -> None:
        with spared():
            signal.raise_signal(signal.SIGTERM)
            imported.append(True)

    with pytest.raises(Interrupted) as raised:
        load()
    assert (raised.value.status, imported) == (143, [True])
    hear()
    with spared():
        pass
    with pytest.raises(Interrupted):
        signal.raise_signal(signal.SIGTERM)
    hear()


DEAF = """
import contextlib, sys, time
from reachlab.learn.interrupts import Interrupts, end_if_deaf, raise_on_termination
raise_on_termination()
end_if_deaf()
with Interrupts() if sys.argv[1] == "saves" else contextlib.nullcontext():
    with contextlib.suppress(KeyboardInterrupt):  # as a callback does that lets out nothing
        print("up", flush=True)
        time.sleep(3)
    if sys.argv[1] == "begins":
        with Interrupts():
            time.sleep(3)
    time.sleep(3)
"""


@pytest.mark.parametrize(("kind", "status"), [("saves", 0), ("idle", 143), ("begins", 1)])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_a_process_that_does_not_hear_it_unless_it_saves(kind: str, status: int, number: int) -> None:
    pipe, command = subprocess.PIPE, [sys.executable, "-c", DEAF, kind]
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout
        assert process.stderr
        assert process.stdout.readline() == "up\n"
        process.send_signal(number)
        assert process.wait(20) == (130 if status == 143 and number == signal.SIGINT else status)
        assert ("Interrupted: interrupted." in process.stderr.read()) == (kind == "begins")


QUIET = """
import time
from reachlab.learn.interrupts import end_at_once, end_if_deaf, raise_on_termination
raise_on_termination()
end_if_deaf()
end_at_once()
print("up", flush=True)
time.sleep(3)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_process_that_has_done_its_work_ends_without_a_word(number: int) -> None:
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", QUIET], stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout
        assert process.stderr
        assert process.stdout.readline() == "up\n"
        process.send_signal(number)
        assert (process.wait(20), process.stderr.read()) == (-number, "")


def test_a_closed_terminal_that_says_so_twice_ends_nothing_at_once() -> None:
    with Interrupts() as interrupts:
        signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGHUP)
    assert interrupts.received == signal.SIGHUP
    signal.raise_signal(signal.SIGHUP)  # while what is left is put away


def test_a_closed_terminal_raises_once() -> None:
    raise_on_termination()
    with pytest.raises(Interrupted):
        signal.raise_signal(signal.SIGHUP)
    signal.raise_signal(signal.SIGHUP)


def test_below_nohup_a_closed_terminal_ends_nothing() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    raise_on_termination()
    with Interrupts() as interrupts:
        signal.raise_signal(signal.SIGHUP)
    assert interrupts.received is None
    assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
