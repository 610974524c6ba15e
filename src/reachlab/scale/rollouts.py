"""Rollouts by Ray: the environments are divided among workers, and their rows are those of one process, bit for bit."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Self, TypeVar

import jax
import numpy as np
from jax import Array

from reachlab.agents.policy import Policy
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.jax_setup import set_threads, use_compilation_cache
from reachlab.learn.rollout import EngineError, Rollout, host_collector
from reachlab.scale.cluster import Cluster
from reachlab.settings.config import LoopConfig, RunConfig
from reachlab.settings.validation import InputError

ALIGNED = 16
"""A worker has a multiple of so many environments, the last one the rest too: compiled loops take no more rows at once,
so that a row is computed by the same instructions in a part as in the whole."""

LOSSES = 20
"""Workers that may be lost in a row, without one that collects, until training ends."""

Tree = TypeVar("Tree")


def divide(num_envs: int, workers: int) -> list[range]:
    """Environments of each worker, as equally many as blocks of `ALIGNED` allow.

    Raises:
        InputError: there are more workers than blocks.
    """
    blocks = -(-num_envs // ALIGNED)
    if not 1 <= workers <= blocks:
        raise InputError(
            f"workers must be at least 1 and at most {blocks}, one for {ALIGNED} of num_envs {num_envs}, got {workers}."
        )
    ends = [min(ALIGNED * (blocks * (i + 1) // workers), num_envs) for i in range(workers)]
    return [range(first, end) for first, end in itertools.pairwise([0, *ends])]


class Gathered(NamedTuple):
    """What a worker has collected: the state of its environments, their rows, and how long it took [s].

    Where its engine failed, `failure` says why, and there may be no rows.
    """

    state: Any
    rollout: Any
    busy_s: float
    failure: str = ""


class Worker:
    """Some of the environments in a process of their own; what they are comes with every call."""

    def __init__(self, config: RunConfig, share: range) -> None:
        """Worker of a share of the environments, which computes on one thread."""
        set_threads(1)
        use_compilation_cache()
        self._env = Env(config, len(share), threads=1)
        self._gather = host_collector(share.start, config.loop.num_envs)

    def collect(self, policy: Policy, state: EnvState, key: Array, config: LoopConfig) -> Gathered:
        """What its environments, in a state, collect with a policy; keys are given and returned as their data."""
        begun = time.perf_counter()
        state = replace(state, key=jax.random.wrap_key_data(state.key))
        try:
            after, rollout = self._gather(self._env, policy, state, jax.random.wrap_key_data(key), config)
        except EngineError as error:
            return Gathered(None, error.rollout, time.perf_counter() - begun, str(error))
        return Gathered(_sent(after), _on_host(rollout), time.perf_counter() - begun)


class RayRollouts:
    """Collects by Ray actors; a `rollout.Collect`.

    Workers keep nothing that is needed: the learner has the state of all environments, so that a worker that dies is
    replaced by another, which collects the same rows.

    Attributes:
        busy_s: time of the worker that took longest, added up over all calls [s].
        lost: workers that were replaced.
    """

    def __init__(self, config: RunConfig, workers: int, address: str | None = None) -> None:
        """Begin to start the workers, on the cluster at an address or on a Ray that is started here.

        Raises:
            InputError: too many workers, Ray is not installed, or nothing answers at the address.
        """
        self._config, self._shares = config, divide(config.loop.num_envs, workers)
        self._cluster = Cluster(address, workers)
        self._ray = self._cluster.ray
        self._workers = [self._start(share, cpus=1) for share in self._shares]
        self.busy_s, self.lost = 0.0, 0

    def _start(self, share: range, cpus: int) -> Any:
        actor = self._ray.remote(num_cpus=cpus, scheduling_strategy="SPREAD")(Worker)
        return actor.remote(self._config, share)

    def __call__(
        self, _env: Env, policy: Policy, state: EnvState, key: Array, config: LoopConfig
    ) -> tuple[EnvState, Rollout]:
        """See `rollout.Collect`.

        Raises:
            EngineError: an engine failed.
            InputError: workers are lost again and again.
        """
        state = _sent(state)
        shared, key_data = self._ray.put(_on_host(policy)), np.asarray(jax.random.key_data(key))
        parts = [jax.tree.map(lambda x, s=share: x[s.start : s.stop], state) for share in self._shares]
        gathered = self._gather(lambda worker, i: worker.collect.remote(shared, parts[i], key_data, config))
        self.busy_s += max(one.busy_s for one in gathered)
        if failure := next((one.failure for one in gathered if one.failure), ""):
            rows = [one.rollout for one in gathered if one.failure and one.rollout is not None]
            raise EngineError(failure, rows[0] if rows else None)
        after = _joined([one.state for one in gathered], axis=0)
        rollout = _joined([one.rollout for one in gathered], axis=1)
        return replace(after, key=jax.random.wrap_key_data(after.key)), rollout

    def _gather(self, submit: Callable[[Any, int], Any]) -> list[Gathered]:
        """What the workers give, in their order; those that die are replaced."""
        pending, results, losses = {}, {}, 0
        for index, worker in enumerate(self._workers):
            pending[submit(worker, index)] = index
        while pending:
            ready = self._ray.wait(list(pending), num_returns=1)[0][0]
            index = pending.pop(ready)
            try:
                results[index] = self._ray.get(ready)
                losses = 0
            except self._ray.exceptions.RayTaskError:
                raise
            except self._ray.exceptions.RayError as error:
                losses, self.lost = losses + 1, self.lost + 1
                if losses >= LOSSES:
                    reason = str(error).partition("\n")[0]
                    raise InputError(f"{losses} workers died one after the other ({reason}).") from None
                # Without a CPU of its own it starts also where what is left of the cluster has none free.
                self._workers[index] = self._start(self._shares[index], cpus=0)
                pending[submit(self._workers[index], index)] = index
        return [results[index] for index in range(len(self._workers))]

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *raised: object) -> None:
        """End the workers."""
        for worker in self._workers:
            self._ray.kill(worker)
        self._cluster.close()


def _sent(state: EnvState) -> EnvState:
    """A state of arrays on the host, with the data of its keys."""
    return _on_host(replace(state, key=jax.random.key_data(state.key)))


def _on_host(tree: Tree) -> Tree:
    return jax.tree.map(np.asarray, tree)


def _joined(trees: Sequence[Any], axis: int) -> Any:
    return jax.tree.map(lambda *parts: np.concatenate(parts, axis=axis), *trees)
