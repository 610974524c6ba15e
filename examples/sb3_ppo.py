"""PPO of Stable-Baselines3: an arm learns to touch a point on the table. Needs `pip install 'reachlab[sb3]'`."""

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

SETTINGS = {"observation": "target+tool", "reward": "dense"}


def learn(steps: int, seed: int) -> tuple[PPO, VecNormalize]:
    """The trained model, and the environment that normalises its observations."""
    env = VecNormalize(make_vec_env("reachlab/Reach-v0", 64, seed, **SETTINGS), norm_reward=False)
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=64,
        batch_size=1024,
        n_epochs=4,
        learning_rate=lambda left: 2e-3 * left,  # `left` falls from 1 to 0
        gamma=0.98,
        gae_lambda=0.9,
        policy_kwargs={"log_std_init": math.log(0.2)},  # half of the action box
        seed=seed,
        device="cpu",
    )
    return model.learn(steps), env


def main() -> None:
    """Learn, evaluate on held-out goals, and print the result as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=600_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    torch.set_num_threads(1)  # the networks are small
    began = time.perf_counter()
    model, env = learn(args.steps, args.seed)
    result = {"steps": model.num_timesteps, "seed": args.seed, "wall_s": round(time.perf_counter() - began, 1)}

    def act(observation: np.ndarray) -> np.ndarray:
        return model.predict(np.asarray(env.normalize_obs(observation)), deterministic=True)[0]

    held_out = reachlab.Env(reachlab.configure("tutorial", **SETTINGS), num_envs=1000)
    report = reachlab.evaluate(held_out, act, seed=5000, episodes=1000)
    print(json.dumps({"success": report.success_rate, "interval": report.success_interval, **result}))


if __name__ == "__main__":
    main()
