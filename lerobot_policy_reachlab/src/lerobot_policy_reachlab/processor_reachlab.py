"""What LeRobot does with observations and actions around an exported policy: it takes them as they are."""

# pyright: reportMissingImports=false
from __future__ import annotations

from typing import Any

from lerobot.processor import PolicyAction, PolicyProcessorPipeline, make_default_pre_post_processors

from lerobot_policy_reachlab.configuration_reachlab import ReachlabConfig

Pipelines = tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]], PolicyProcessorPipeline[PolicyAction, PolicyAction]
]


def make_reachlab_pre_post_processors(config: ReachlabConfig, dataset_stats: Any = None) -> Pipelines:
    """LeRobot's usual steps before and after a policy, without normalisation, which the exported policy does.

    Statistics of a dataset therefore have no effect.
    """
    del dataset_stats
    return make_default_pre_post_processors(config)
