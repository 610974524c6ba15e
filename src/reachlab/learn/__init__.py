"""How a policy is learnt: rollouts, PPO, DAgger and the loop around them."""

from __future__ import annotations

from reachlab.settings.tables import Lazy, Table

METHODS: dict[str, Lazy] = Table(
    {
        "ppo": Lazy("proximal policy optimisation, by trial and error", "reachlab.learn.ppo_method:PPO"),
        "dagger": Lazy("dataset aggregation, from a teacher", "reachlab.learn.dagger:DAGGER"),
        "imitation": Lazy("dataset aggregation, from planned ways", "reachlab.learn.imitation:IMITATION"),
    }
)
"""Ways of learning by name, each a `Method`; a configuration says which, see `RunConfig.method`, or its
action, see `Action.method`."""
