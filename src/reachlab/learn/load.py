"""Trained policies, read from their run directories."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from reachlab.agents.policy import Policy
from reachlab.envs.core import Env
from reachlab.envs.setup import in_evaluation
from reachlab.learn.learner import make_initial_policy
from reachlab.runs.directory import RunDirectory
from reachlab.runs.shipped import find_run
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import flatten, to_json
from reachlab.settings.validation import InputError

POLICY = "learner/policy"
"""Name of the policy in a checkpoint."""

BUILT_BY = ("observation", "action", "hidden", "memory")
"""Settings that say what a policy is built like."""


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
        checkpoint: what names the policy in reports and datasets, see `Manifest.identity`.
    """

    policy: Policy
    config: RunConfig
    env: Env
    checkpoint: dict[str, Any]

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
    env = Env(in_evaluation(trained, sim), num_envs)
    saved = load_saved(directory, env)
    return LoadedRun(saved.policy, trained, env, saved.checkpoint)


def load_initial(env: Env) -> Policy | None:
    """Policy that a training in `env` begins with, for its box of actions; None where its settings name none.

    Observations are normalised as it is used to until the first are known, and then by these alone: on another arm what
    it knows of their scale holds training back.

    Raises:
        InputError: see `load`, or the policy is built otherwise than that of the training.
    """
    if not (named := env.config.learner.initial_policy):
        return None
    loaded, own = load(named), _template(env)
    loaded.env.close()
    here, there = (flatten(to_json(config)) for config in (env.config, loaded.config))
    if differing := [name for name in BUILT_BY if here[name] != there[name]]:
        values = ", ".join(" ".join(map(str, (name, *np.atleast_1d(there[name])))) for name in differing)
        raise InputError(f"initial_policy '{named}' was trained with {values}: choose that too, or another policy.")
    if _shapes(loaded.policy) != _shapes(own):
        counts = [(one.schema.vector_size, one.centre.size) for one in (loaded.policy, own)]
        raise InputError(
            f"initial_policy '{named}' observes {counts[0][0]} numbers for actions of {counts[0][1]}, and this training"
            f" {counts[1][0]} for {counts[1][1]}: choose one of an arm with as many joints, and of a like task."
        )
    low, high = map(jnp.asarray, env.action_bounds)
    normaliser = replace(loaded.policy.normaliser, count=jnp.zeros(()))
    return Policy(loaded.policy.parameters, normaliser, (low + high) / 2, (high - low) / 2, own.schema)


def _shapes(policy: Policy) -> list[tuple[int, ...]]:
    return [leaf.shape for leaf in jax.tree.leaves(policy)]
