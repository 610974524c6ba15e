"""The ids under which Gymnasium makes our environments; they are registered when this module is imported."""

from __future__ import annotations

from gymnasium.envs.registration import register

_SINGLE, _VECTOR = "reachlab.envs.gymnasium_single:ReachEnv", "reachlab.envs.gymnasium_vector:ReachVectorEnv"
register("reachlab/Reach-v0", entry_point=_SINGLE, vector_entry_point=_VECTOR)
_GOAL = "reachlab.envs.gymnasium_goal:ReachGoal"
register(
    "reachlab/ReachGoal-v0",
    entry_point=f"{_GOAL}Env",
    vector_entry_point=f"{_GOAL}VectorEnv",
    # The form of FetchReach and of PandaReach: steps of up to 5 cm, 50 in an episode, and 5 cm are near enough.
    kwargs={
        "task": "tutorial",
        "observation": "goal",
        "action": "tool_step",
        "reward": "goal",
        "targets": "box",
        "tool_scale": 0.05,
        "success_distance": 0.05,
        "max_steps": 50,
        "at_goal": "continue",
        "end_outside": False,
    },
)
register(
    "reachlab/KukaReach-v0",
    entry_point=_SINGLE,
    vector_entry_point=_VECTOR,
    kwargs={"task": "tutorial", "observation": "target", "reward": "sparse"},
)
