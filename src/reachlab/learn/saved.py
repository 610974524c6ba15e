"""Trained policies, read from their run directories."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax

from reachlab.agents.policy import Policy
from reachlab.envs.core import Env
from reachlab.learn.learner import make_initial_policy
from reachlab.runs.directory import RunDirectory

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
    return jax.eval_shape(lambda key: make_initial_policy(env.config, env, key), jax.random.key(0))
