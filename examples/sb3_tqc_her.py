"""TQC of sb3-contrib with hindsight replay: an arm learns to hold a point. Needs `pip install -e '.[sb3]'`."""

import argparse
import json
import time

import gymnasium
import numpy as np
import torch
from sb3_contrib import TQC
from stable_baselines3 import HerReplayBuffer

import reachlab
from reachlab.sb3 import make_vec_env

ENV_ID = "reachlab/ReachGoal-v0"


def learn(steps: int, seed: int) -> TQC:
    """The trained model."""
    return TQC(
        "MultiInputPolicy",
        make_vec_env(ENV_ID, 8, seed),
        replay_buffer_class=HerReplayBuffer,
        buffer_size=max(steps, 1000),
        learning_starts=1000,  # no episode has ended before
        gradient_steps=2,  # for each step of all environments
        batch_size=256,
        learning_rate=1e-3,
        gamma=0.95,
        tau=0.05,
        ent_coef="auto_0.05",
        policy_kwargs={"net_arch": [64, 64], "n_critics": 1},
        seed=seed,
        device="cpu",
    ).learn(steps)


def main() -> None:
    """Learn, evaluate on held-out goals, and print the result as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=20_000)  # the RL Zoo's of PandaReach
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    if args.steps < 1 or args.seed < 0:
        parser.error("steps begin at 1, and seeds at 0")
    torch.set_num_threads(1)  # the networks are small
    began = time.perf_counter()
    model = learn(args.steps, args.seed)
    result = {"steps": model.num_timesteps, "seed": args.seed, "wall_s": round(time.perf_counter() - began, 1)}

    def act(observation: dict[str, np.ndarray]) -> np.ndarray:
        return model.predict(observation, deterministic=True)[0]

    held_out = reachlab.Env(reachlab.configure(**gymnasium.spec(ENV_ID).kwargs), num_envs=1000)
    report = reachlab.evaluate(held_out, act, seed=5000, episodes=1000)
    print(json.dumps({"success": report.success_rate, "interval": report.success_interval, **result}))


if __name__ == "__main__":
    main()
