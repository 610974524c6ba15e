"""Rollouts by workers: the weights of one process for any number of them, also when a machine is lost."""

from __future__ import annotations

import tempfile
import threading
from pathlib import Path

from faults.saves import Trial
from reachlab.envs.presets import configure
from reachlab.learn.train import train
from reachlab.scale.rollouts import RayRollouts

WORKERS = (1, 2, 4)
"""Numbers of workers that are tried."""

STEPS, LOST_AFTER = 512_000, 6
"""Environment steps of a training, and iterations after which a machine is lost."""

CONFIG = configure("precise", total_steps=STEPS, report_episodes=64)


def shared_weights() -> Trial:
    """Train with each number of workers, and compare with one process."""
    wrong = []
    with tempfile.TemporaryDirectory() as place:
        train(CONFIG, Path(place) / "alone")
        for workers in WORKERS:
            with RayRollouts(CONFIG, workers) as collect:
                train(CONFIG, Path(place) / str(workers), collect=collect)
            if _weights(Path(place) / str(workers)) != _weights(Path(place) / "alone"):
                wrong.append(f"{workers} workers learn other weights than one process")
    return Trial(len(WORKERS), wrong)


def lost_node() -> Trial:
    """Train on a cluster of two nodes on this machine, and take one away while they collect."""
    from ray.cluster_utils import Cluster

    wrong, iterations = [], 0
    with tempfile.TemporaryDirectory() as place:
        train(CONFIG, Path(place) / "alone")
        cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
        other = cluster.add_node(num_cpus=1)
        try:
            with RayRollouts(CONFIG, 2, cluster.address) as collect:

                def watch(_: object) -> None:
                    nonlocal iterations
                    iterations += 1
                    if iterations == LOST_AFTER:
                        threading.Timer(0.3, cluster.remove_node, (other,), {"allow_graceful": False}).start()

                train(CONFIG, Path(place) / "shared", watch, collect=collect)
                lost = collect.lost
        finally:
            cluster.shutdown()
        if not lost:
            wrong.append("no worker was lost")
        if _weights(Path(place) / "shared") != _weights(Path(place) / "alone"):
            wrong.append("other weights than undisturbed")
    return Trial(1, wrong)


def _weights(out: Path) -> bytes:
    return max(out.glob("checkpoints/step_*/state.safetensors")).read_bytes()
