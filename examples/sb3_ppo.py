"""PPO of Stable-Baselines3 on the tutorial's task: an arm touches a point on the table.

pip install 'reachlab[sb3]'; python examples/sb3_ppo.py
"""

import argparse
import json
import math
import time

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

import reachlab
from reachlab.sb3 import make_vec_env

NUM_ENVS, FRESH_SEED = 64, 5000
SETTINGS = {"observation": "target+tool", "reward": "dense"}


def learn(steps: int, seed: int) -> tuple[PPO, VecNormalize]:
    """The trained model, and the environment that normalises its observations."""
    env = VecNormalize(make_vec_env(NUM_ENVS, "tutorial", seed=seed, **SETTINGS), norm_reward=False)
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=64,
        batch_size=2048,
        n_epochs=8,
        learning_rate=lambda left: 1e-5 + 1e-3 * left,  # `left` falls from 1 to 0
        gamma=0.98,
        policy_kwargs={"log_std_init": math.log(0.2)},  # half of the action box
        seed=seed,
        device="cpu",
    )
    return model.learn(steps), env


def main() -> None:
    """Learn, evaluate on held-out goals, and print the result as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=800_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    torch.set_num_threads(1)  # the networks are small
    began = time.perf_counter()
    model, env = learn(args.steps, args.seed)
    wall = time.perf_counter() - began

    def act(observation: np.ndarray) -> np.ndarray:
        return model.predict(np.asarray(env.normalize_obs(observation)), deterministic=True)[0]

    held_out = reachlab.Env(reachlab.configure("tutorial", **SETTINGS), num_envs=1000)
    report = reachlab.evaluate(held_out, act, seed=FRESH_SEED, episodes=1000)
    result = {"success": report.success_rate, "interval": report.success_interval, "steps": model.num_timesteps}
    print(json.dumps({**result, "seed": args.seed, "wall_s": round(wall, 1)}))


if __name__ == "__main__":
    main()
