"""Engine `local`: each training in a process of its own on this machine."""

from __future__ import annotations

import os
import subprocess
import sys
import time

from reachlab.runs.files import write_json
from reachlab.scale.engine import Job

POLL = 0.05
"""Time between two looks at the processes [s]."""

PATIENCE = 3.0
"""Time in which trainings that are asked to end have to [s]; one that does not goes on from its last checkpoint."""

COMMAND = "from reachlab.scale.local import work; work()"
"""What a process of a training runs."""


class LocalEngine:
    """Trainings in processes of this machine; see `engine.Engine`."""

    def __init__(self, workers: int, address: str | None = None) -> None:
        """Engine on which nothing runs; `workers` and `address` are for others."""
        del workers, address
        self._processes: dict[Job, subprocess.Popen[bytes]] = {}

    @property
    def running(self) -> list[Job]:
        """See `Engine.running`."""
        return list(self._processes)

    def submit(self, job: Job) -> None:
        """See `Engine.submit`."""
        order = job.path.with_suffix(".job")
        write_json(order, job.to_json())
        with job.log_file.open("ab") as log:
            self._processes[job] = subprocess.Popen(  # noqa: S603 (our own command)
                [sys.executable, "-c", COMMAND, str(order)],
                stdin=subprocess.PIPE,  # closed when this process is gone, however it went
                stdout=log,
                stderr=log,
                start_new_session=True,  # Ctrl-C is for the sweep
                env=os.environ | {"TF_CPP_MIN_LOG_LEVEL": "3"},
            )

    def ended(self, timeout: float) -> list[Job]:
        """See `Engine.ended`."""
        until = time.monotonic() + timeout
        while not (ended := [job for job, process in self._processes.items() if process.poll() is not None]):
            if time.monotonic() > until:
                break
            time.sleep(POLL)
        for job in ended:
            self._close(self._processes.pop(job))
        return ended

    def close(self) -> None:
        """See `Engine.close`."""
        for process in self._processes.values():
            process.terminate()
        until = time.monotonic() + PATIENCE
        for process in self._processes.values():
            try:
                process.wait(max(until - time.monotonic(), POLL))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            self._close(process)
        self._processes.clear()

    @staticmethod
    def _close(process: subprocess.Popen[bytes]) -> None:
        if process.stdin:
            process.stdin.close()


def work() -> None:
    """Run the training whose file is named on the command line, as long as who started it is there."""
    import json
    import threading
    from pathlib import Path

    from reachlab.learn.interrupts import end_if_deaf, raise_on_termination
    from reachlab.scale.engine import end_with_parent, run_job

    raise_on_termination()
    end_if_deaf()
    threading.Thread(target=end_with_parent, daemon=True).start()
    run_job(json.loads(Path(sys.argv[1]).read_text()))
