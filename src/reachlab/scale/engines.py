"""What carries the trainings of a sweep: processes of this machine, or Ray."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from reachlab.scale.cluster import Cluster
from reachlab.scale.training import run_training

LOCAL_PATIENCE, RAY_PATIENCE = 3.0, 30.0
"""Time in which trainings that are asked to end have to, at the end of the sweep [s]."""

AT_LEAST = 0.05
"""Time that each of them has, also when that is over [s]."""

COMMAND = "from reachlab.scale.training import main; main()"
"""What a process of a training runs."""


class Engine(Protocol):
    """Carries trainings, each in a process of one thread; it is made with a number of workers and Ray's address."""

    def start(self, *order: Any) -> Any:
        """Begin a training, or continue it, see `training.run_training`; what is given names it below."""

    def running(self, training: Any) -> bool:
        """Whether its process has not ended yet."""
        ...

    def stop(self, training: Any) -> None:
        """Ask a training to end, with everything saved."""

    def close(self) -> None:
        """End all that run, with everything saved if it can be."""


class LocalEngine:
    """Trainings in processes of this machine; see `Engine`."""

    def __init__(self, workers: int, address: str | None = None) -> None:
        """Engine on which nothing runs; `workers` and `address` are for others."""
        del workers, address
        self._processes = set[subprocess.Popen[bytes]]()

    def start(self, *order: Any) -> subprocess.Popen[bytes]:
        """See `Engine.start`; what the process prints is in a file beside the run directory."""
        with Path(order[0]).with_suffix(".log").open("ab") as log:
            process = subprocess.Popen(  # noqa: S603 (our own command)
                [sys.executable, "-c", COMMAND, json.dumps(order)],
                stdin=subprocess.PIPE,  # closed when this process is gone, however it went
                stdout=log,
                stderr=log,
                start_new_session=True,  # Ctrl-C is for the sweep
            )
        self._processes.add(process)
        return process

    def running(self, training: subprocess.Popen[bytes]) -> bool:
        """See `Engine.running`."""
        if training.poll() is None:
            return True
        with training:  # closes its standard input
            self._processes.discard(training)
        return False

    def stop(self, training: subprocess.Popen[bytes]) -> None:
        """See `Engine.stop`."""
        training.terminate()

    def close(self) -> None:
        """See `Engine.close`; one that does not end is killed, and goes on from its last checkpoint."""
        for process in self._processes:
            process.terminate()
        until = time.monotonic() + LOCAL_PATIENCE
        for process in self._processes:
            with process:
                try:
                    process.wait(max(until - time.monotonic(), AT_LEAST))
                except subprocess.TimeoutExpired:
                    process.kill()
        self._processes.clear()


def heard(training: Callable[..., None]) -> Callable[..., None]:
    """A training as a task of Ray, which cancels by SIGINT: what a script began in the background ignores that."""

    def task(*order: Any) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        training(*order)

    return task


class RayEngine:
    """Trainings as Ray tasks; see `Engine`. All nodes have to see the sweep's folder at the same path."""

    def __init__(self, workers: int, address: str | None = None) -> None:
        """Engine on the cluster at an address, or on a Ray that is started here for so many workers.

        Raises:
            InputError: see `Cluster`.
        """
        self._cluster = Cluster(address, workers)
        self._ray = self._cluster.ray
        # A new process for each: the last one's memory is gone, and a death concerns it alone.
        self._run = self._ray.remote(num_cpus=1, max_retries=0, max_calls=1)(heard(run_training))
        self._tasks = list[Any]()

    def start(self, *order: Any) -> Any:
        """See `Engine.start`."""
        self._tasks.append(self._run.remote(*order))
        return self._tasks[-1]

    def running(self, training: Any) -> bool:
        """See `Engine.running`.

        Raises:
            RayTaskError: it ended by an error that is none of its own.
        """
        if not self._ray.wait([training], timeout=0)[0]:
            return True
        self._tasks.remove(training)
        try:
            self._ray.get(training)
        except self._ray.exceptions.TaskCancelledError:
            pass  # it was stopped where it noted no signals any more; Ray raises this as an error of the task, too
        except self._ray.exceptions.RayTaskError:
            raise
        except self._ray.exceptions.RayError:
            pass  # its process or node died: the sweep looks at what is left of it
        return False

    def stop(self, training: Any) -> None:
        """See `Engine.stop`."""
        self._ray.cancel(training)

    def close(self) -> None:
        """See `Engine.close`."""
        for task in self._tasks:
            self._ray.cancel(task)
        if self._tasks:
            self._ray.wait(self._tasks, num_returns=len(self._tasks), timeout=RAY_PATIENCE)
        for task in self._tasks:
            self._ray.cancel(task, force=True)
        self._cluster.close()
