"""An exported policy in real time: its controller in one process, a simulated arm in another, faults between them."""

from __future__ import annotations

import contextlib
import multiprocessing
import time
from collections.abc import Iterator
from importlib.machinery import SourceFileLoader
from multiprocessing.connection import Connection
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from reachlab.deploy.onboard.folder import read_folder
from reachlab.deploy.plant import Measurement, Outcome, Plant, drive
from reachlab.deploy.plant_faults import Faults
from reachlab.envs.earlier_configs import from_json
from reachlab.envs.setup import in_evaluation
from reachlab.robots.catalogue import find_model_file
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import override
from reachlab.settings.validation import InputError

READY = "ready"
"""Answer of a controller that has been reset; any other text says why it was not."""

EARLY = 0.25
"""Share of a control period by which a measurement may come before its time and still begins a control step."""

PATIENCE = 60.0
"""Time in which a controller has to be ready [s]."""


def load_controller(folder: Path) -> ModuleType:
    """The module `controller.py` of an export, from its file.

    Raises:
        InputError: there is none.
    """
    file = folder / "controller.py"
    if not file.is_file():
        raise InputError(f"'{folder}' holds no controller.py: name a folder that `reachlab export` wrote.")
    module = ModuleType("controller")
    module.__file__ = str(file)
    SourceFileLoader("controller", str(file)).exec_module(module)
    return module


def start_controller(folder: Path, *, feels: bool = False) -> Any:
    """The controller of an export, by the folder's own `controller.py`, for one who may measure the wrench.

    Raises:
        InputError: see `read_folder`, or the policy observes a wrench that is not measured.
    """
    facts = read_facts(folder)  # the folder's own controller may be an old one, which looks at less
    if "wrench" in facts.get("inputs", ()) and not feels:
        raise InputError(
            f"the policy in '{folder}' observes the wrench at the wrist, which is not measured here: call"
            " Controller.step(…, wrench=…) in a loop of your own, or train without --wrench."
        )
    try:
        return load_controller(folder).Controller(folder)
    except ValueError as error:
        raise InputError(str(error)) from None


def read_facts(folder: Path) -> dict[str, Any]:
    """What the `policy.json` of an export says.

    Raises:
        InputError: see `read_folder`.
    """
    try:
        return read_folder(folder)
    except ValueError as error:
        raise InputError(str(error)) from None


def settings_of(folder: Path, sim: str | None) -> RunConfig:
    """Settings in which an exported policy is checked, in a simulator or in its own.

    Raises:
        InputError: the folder is none that was exported, the policy gets pictures, there is no such simulator, or the
            arm's file is not the one of the export.
    """
    facts = read_facts(folder)
    if facts["observation"]["pictured"]:
        raise InputError("a policy that gets pictures is not checked in real time: evaluate it, `reachlab eval`.")
    config = from_json(facts["settings"])
    file = find_model_file(config.robot, config.package)
    if facts.get("robot_sha256", file.digest) != file.digest:
        raise InputError(
            f"'{folder}' was exported for another arm: robot file '{file.file}', or a file that it names, has changed"
            " since. Restore it, or train and export again."
        )
    return override(in_evaluation(config, sim), control_period=facts["control_period"])


def check(folder: Path, *, sim: str | None, episodes: int, seed: int, faults: Faults) -> Outcome:
    """Play held-out episodes in real time with the controller of an export, in a process of its own.

    Raises:
        InputError: see `settings_of`, or the controller does not start.
    """
    plant = Plant(settings_of(folder, sim), seed)
    try:
        with _controller(folder) as link:
            return drive(plant, link, faults, episodes)
    finally:
        plant.close()


@contextlib.contextmanager
def _controller(folder: Path) -> Iterator[PipeLink]:
    """A controller in a process of its own, which ends with this one."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=serve, args=(folder, there), daemon=True)
    process.start()
    there.close()
    try:
        yield PipeLink(here)
    finally:
        here.close()
        process.join(5)
        if process.is_alive():
            process.terminate()


class PipeLink:
    """A pipe to a controller's process, see `Link`."""

    def __init__(self, pipe: Connection) -> None:
        """The end of a pipe."""
        self._pipe, self.problem = pipe, ""

    def begin(self, q: np.ndarray) -> None:
        """Reset the controller.

        Raises:
            InputError: it refuses, or is not ready in time.
        """
        self._pipe.send(q)
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            if self._pipe.poll(0.1) and isinstance(answer := self._pipe.recv(), str):
                if answer != READY:
                    raise InputError(answer)
                self.problem = ""
                return
        raise InputError(f"the controller is not ready within {PATIENCE:g} s.")

    def send(self, measurement: Measurement) -> None:
        """Tell the controller a measurement."""
        self._pipe.send(measurement)

    def receive(self) -> list[np.ndarray]:
        """The commands that have come."""
        commands = []
        while self._pipe.poll():
            command, self.problem = self._pipe.recv()
            commands.append(command)
        return commands


def serve(folder: Path, pipe: Connection) -> None:
    """Run the controller of an export at the other end of a pipe, until that is closed."""
    try:
        controller = start_controller(folder, feels=True)
    except (InputError, OSError) as error:
        pipe.recv()
        pipe.send(str(error))
        return
    period, measured, fresh, due = controller.period, None, False, 0.0
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            # A measurement is used as it comes, but never twice in a period: the last one then. Where none comes in a
            # period and a half, there is none.
            left = due + period * (-EARLY if fresh else 0.5) - time.perf_counter()
            if measured is None or left > 0:
                pipe.poll(None if measured is None else left)
                while pipe.poll():
                    measured = _heard(pipe, controller)
                    fresh = measured is not None
                continue
            due = (now := time.perf_counter()) + period
            q, qd = (measured.q, measured.qd) if fresh else (None, None)
            fresh = False
            command = controller.step(q, qd, measured.goal, now, **measured.beside)
            pipe.send((command, controller.problem))


def _heard(pipe: Connection, controller: Any) -> Measurement | None:
    """The measurement that comes next; None where a reset does, which is answered."""
    message = pipe.recv()
    if isinstance(message, Measurement):
        return message
    answer = READY
    try:
        controller.reset(message)
    except ValueError as error:
        answer = str(error)
    pipe.send(answer)
    return None
