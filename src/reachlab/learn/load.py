"""Trained policies, read from their run directories."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax

from reachlab.agents.policy import Policy
from reachlab.envs.core import Env
from reachlab.envs.setup import in_evaluation
from reachlab.learn.learner import make_initial_policy
from reachlab.runs.directory import RunDirectory
from reachlab.runs.shipped import find_run
from reachlab.settings.config import RunConfig

POLICY = "learner/policy"
"""Name of the policy in a checkpoint."""


@dataclass(frozen=True)
class Saved:
    """A policy, and the identity of the checkpoint that it is from, see `Manifest.identity`."""

    policy: Policy
    checkpoint: dict[str, Any]


def load_policy(run: RunDirectory, env: Env, step: int | None = None) -> Policy:
    """Policy of a run's newest checkpoint, or of the one after `step`; it acts in every simulator.

    Raises:
        InputError: see `RunDirectory.read_checkpoint`.
    """
    return run.read_checkpoint(POLICY, _template(env), step)


def load_saved(run: RunDirectory, env: Env) -> Saved:
    """Policy of a run's newest checkpoint, with that one's identity; see `load_policy`."""
    checkpoint, policy = run.read_identified(POLICY, _template(env))
    return Saved(policy, checkpoint)


def _template(env: Env) -> Policy:
    return jax.eval_shape(lambda: make_initial_policy(env.config, env, jax.random.key(0)))


@dataclass(frozen=True)
class LoadedRun:
    """A finished run: its policy, its settings, and an environment in which the policy acts.

    Attributes:
        policy: what was learnt, of the newest checkpoint.
        config: the settings of the training.
        env: the environment; without what varied in training.
    """

    policy: Policy
    config: RunConfig
    env: Env

    def __repr__(self) -> str:
        """What it is, without its weights."""
        config = self.config
        return f"LoadedRun(task={config.task!r}, robot={config.robot!r}, sim={self.env.config.sim!r}, {self.policy!r})"


def load(run: str | Path, *, sim: str | None = None, num_envs: int = 1) -> LoadedRun:
    """Policy, settings and environment of a run, or of a policy that comes with reachlab.

    The environment is without what varied in training. To evaluate: `evaluate(loaded.env, "trained", loaded.policy,
    seed=1, episodes=100)`.

    Args:
        run: the run directory, as `train` makes it, or a name of `reachlab list`, as `panda/precise`.
        sim: simulator; by default the run's own.
        num_envs: environments in the batch.

    Raises:
        InputError: no such run, or one without a checkpoint that can be used, or no such simulator.
    """
    directory = find_run(run)
    trained = directory.read_config()
    config = in_evaluation(trained, sim or trained.sim)
    env = Env(config, num_envs)
    return LoadedRun(load_policy(directory, env), config, env)
