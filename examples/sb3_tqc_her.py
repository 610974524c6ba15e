"""TQC of sb3-contrib with hindsight replay on the goal form of the task, in the RL Zoo's 20,000 steps of PandaReach.

pip install 'reachlab[sb3]'; python examples/sb3_tqc_her.py
"""

import argparse
import json
import time
from typing import Any

import gymnasium
import numpy as np
import torch
from sb3_contrib import TQC
from stable_baselines3 import HerReplayBuffer

import reachlab
from reachlab.sb3 import make_vec_env

NUM_ENVS, FRESH_SEED = 8, 5000
SETTINGS: dict[str, Any] = dict(gymnasium.spec("reachlab/ReachGoal-v0").kwargs)


def learn(steps: int, seed: int) -> TQC:
    """The trained model."""
    model = TQC(
        "MultiInputPolicy",
        make_vec_env(NUM_ENVS, seed=seed, **SETTINGS),
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
        buffer_size=max(steps, 1000),
        learning_starts=1000,  # no episode has ended before
        gradient_steps=4,  # for each step of all environments
        batch_size=256,
        learning_rate=1e-3,
        gamma=0.9,
        tau=0.05,
        ent_coef="auto_0.02",
        policy_kwargs={"net_arch": [64, 64], "n_critics": 1},
        seed=seed,
        device="cpu",
    )
    return model.learn(steps)


def main() -> None:
    """Learn, evaluate on held-out goals, and print the result as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    torch.set_num_threads(1)  # the networks are small
    began = time.perf_counter()
    model = learn(args.steps, args.seed)
    wall = time.perf_counter() - began

    def act(observation: dict[str, np.ndarray]) -> np.ndarray:
        return model.predict(observation, deterministic=True)[0]

    held_out = reachlab.Env(reachlab.configure(**SETTINGS), num_envs=1000)
    report = reachlab.evaluate(held_out, act, seed=FRESH_SEED, episodes=1000)
    result = {"success": report.success_rate, "interval": report.success_interval, "steps": model.num_timesteps}
    print(json.dumps({**result, "seed": args.seed, "wall_s": round(wall, 1)}))


if __name__ == "__main__":
    main()
