"""Engine `ray`: each training in a process of its own on a Ray cluster."""

from __future__ import annotations

from typing import Any

from reachlab.scale.cluster import Cluster
from reachlab.scale.engine import Job, run_job

PATIENCE = 30.0
"""Time in which trainings that are asked to end have to [s]."""


class RayEngine:
    """Trainings as Ray tasks; see `engine.Engine`. All nodes have to see the sweep's folder at the same path."""

    def __init__(self, workers: int, address: str | None = None) -> None:
        """Engine on the cluster at an address, or on a Ray that is started here for so many workers.

        Raises:
            InputError: see `Cluster`.
        """
        self._cluster = Cluster(address, workers)
        self._ray = self._cluster.ray
        # A new process for each: the last one's memory is gone, and a death concerns it alone.
        self._run = self._ray.remote(num_cpus=1, max_retries=0, max_calls=1)(run_job)
        self._tasks: dict[Any, Job] = {}

    @property
    def running(self) -> list[Job]:
        """See `Engine.running`."""
        return list(self._tasks.values())

    def submit(self, job: Job) -> None:
        """See `Engine.submit`."""
        self._tasks[self._run.remote(job.to_json())] = job

    def ended(self, timeout: float) -> list[Job]:
        """See `Engine.ended`.

        Raises:
            RayTaskError: a training ended by an error that is none of its own.
        """
        ready, _ = self._ray.wait(list(self._tasks), num_returns=1, timeout=timeout)
        for task in ready:
            try:
                self._ray.get(task)
            except self._ray.exceptions.RayTaskError:
                raise
            except self._ray.exceptions.RayError:
                pass  # its process or node died: the sweep looks at what is left of it
        return [self._tasks.pop(task) for task in ready]

    def close(self) -> None:
        """See `Engine.close`."""
        for task in self._tasks:
            self._ray.cancel(task)
        if self._tasks:
            self._ray.wait(list(self._tasks), num_returns=len(self._tasks), timeout=PATIENCE)
        for task in self._tasks:
            self._ray.cancel(task, force=True)
        self._tasks.clear()
        self._cluster.close()
