"""Ray, started here or joined."""

from __future__ import annotations

import logging
import os
import socket
import warnings
from typing import Any

from reachlab.settings.validation import InputError, needing

LOCAL = "127.0.0.1"
"""Where a Ray that is started here listens: no other machine reaches it."""

AUTO, CLIENT = "auto", "ray://"
"""The address of the cluster that this machine is a node of, and the beginning of those of Ray's client."""

ANSWER_TIME = 5.0
"""Time in which something has to answer [s]."""

QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # else a warning on every start
    "RAY_DISABLE_DOCKER_CPU_WARNING": "1",
}
"""What Ray is told in the environment: to send nothing anywhere, and not to warn."""


class Cluster:
    """A connection to Ray.

    Attributes:
        ray: the module `ray`.
    """

    def __init__(self, address: str | None, workers: int) -> None:
        """Connect to the cluster at an address, or to a Ray that is started here with a CPU for each worker.

        One that this process is connected to already is used as it is.

        Raises:
            InputError: Ray is not installed, nothing answers at the address, or it has too few CPUs.
        """
        for name, value in QUIET.items():
            os.environ.setdefault(name, value)
        with needing("engine 'ray' needs Ray: {}.", "ray"):
            import ray
        self.ray: Any = ray
        if address:
            _knock(address)
        self._mine = not self.ray.is_initialized()
        if self._mine:
            self._connect(address, workers)
        if (cpus := int(self.ray.cluster_resources().get("CPU", 0))) < workers:
            self.close()
            raise InputError(f"Ray has {cpus} CPUs, and each of {workers} workers needs one: choose fewer --workers.")

    def _connect(self, address: str | None, workers: int) -> None:
        begin: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
        if address:
            begin |= {"address": address}
        else:
            begin |= {"address": "local", "num_cpus": workers, "include_dashboard": False, "_node_ip_address": LOCAL}
        try:
            with warnings.catch_warnings():
                # Ray forks, and what was forked becomes another program at once: JAX's threads are not missed.
                warnings.filterwarnings("ignore", "os.fork", RuntimeWarning)
                self.ray.init(**begin)
        except (ConnectionError, ValueError, RuntimeError) as error:
            reason = str(error).partition("\n")[0].rstrip(".")
            where = f"at address {address!r}" if address else "here"
            raise InputError(f"Ray cannot be used {where} ({reason}): see `ray status`.") from None

    def close(self) -> None:
        """Disconnect; a Ray that was started here ends."""
        if self._mine:
            self.ray.shutdown()


def _knock(address: str) -> None:
    """Make sure that something answers at an address: Ray itself would try for minutes."""
    host, colon, port = address.removeprefix(CLIENT).rpartition(":")
    if address == AUTO:
        return
    if not colon or not port.isdecimal():
        raise InputError(f"address must be HOST:PORT or {AUTO!r}, got {address!r}.")
    try:
        socket.create_connection((host, int(port)), ANSWER_TIME).close()
    except (OSError, OverflowError) as error:
        raise InputError(
            f"no Ray answers at address {address!r} ({error}): see `ray status` on its head node."
        ) from None
