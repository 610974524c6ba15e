"""Ray, started here or joined."""

from __future__ import annotations

import logging
import os
import warnings
from typing import Any

from reachlab.settings.validation import InputError

LOCAL = "127.0.0.1"
"""Where a Ray that is started here listens: no other machine reaches it."""

QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # else a warning on every start
    "RAY_DISABLE_DOCKER_CPU_WARNING": "1",
}
"""What Ray is told in the environment: to send nothing anywhere, and not to warn."""


def load_ray() -> Any:
    """The module `ray`.

    Raises:
        InputError: it is not installed.
    """
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
    try:
        import ray
    except ModuleNotFoundError:
        raise InputError("engine 'ray' needs Ray: pip install 'reachlab[ray]'.") from None
    return ray


def join(address: str | None, cpus: int) -> Any:
    """The module `ray`, connected to the cluster at an address, or to a Ray that is started here with so many CPUs.

    One that this process is connected to already is used as it is.

    Raises:
        InputError: Ray is not installed, or nothing answers at the address.
    """
    ray = load_ray()
    if ray.is_initialized():
        return ray
    begin: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    if address:
        begin |= {"address": address}
    else:
        begin |= {"address": "local", "num_cpus": cpus, "include_dashboard": False, "_node_ip_address": LOCAL}
    try:
        with warnings.catch_warnings():
            # Ray forks, and what was forked becomes another program at once: JAX's threads are not missed.
            warnings.filterwarnings("ignore", "os.fork", RuntimeWarning)
            ray.init(**begin)
    except (ConnectionError, ValueError, RuntimeError) as error:
        reason = str(error).partition("\n")[0].rstrip(".")
        where = f"at address {address!r}" if address else "here"
        raise InputError(f"Ray cannot be used {where} ({reason}): see `ray status`.") from None
    return ray
