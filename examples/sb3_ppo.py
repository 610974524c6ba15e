"""PPO of Stable-Baselines3: an arm learns to touch a point on the table. Needs `pip install -e '.[sb3]'`."""

import argparse
import json
import math
import time
from collections.abc import Callable

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import ConvertCallback, EveryNTimesteps
from stable_baselines3.common.vec_env import VecNormalize

import reachlab
from reachlab.evaluation.episodes import make_runner
from reachlab.sb3 import make_vec_env

SETTINGS = {"observation": "target+tool", "reward": "dense"}


VALIDATION_STEPS, VALIDATION_SEED, FRESH_SEED = 65_536, 1, 5000
"""Environment steps between validations; seeds of the goals that end the training, and of those that judge it."""


def make_judge(model: PPO, env: VecNormalize) -> Callable[[int], reachlab.Report]:
    """A function that gives the report of the model on the held-out goals of a seed."""

    def act(observation: np.ndarray) -> np.ndarray:
        return model.predict(np.asarray(env.normalize_obs(observation)), deterministic=True)[0]

    held_out = reachlab.Env(reachlab.configure("tutorial", **SETTINGS), num_envs=1000)
    runner = make_runner(held_out, act)  # compiled once
    return lambda seed: reachlab.evaluate(held_out, act, seed=seed, episodes=1000, runner=runner)


def main() -> None:
    """Learn until every goal of a validation is reached, evaluate on others, and print the result as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=1_000_000, help="environment steps at most")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", help="name of the model and of its normaliser, for `reachlab eval`")
    args = parser.parse_args()
    if args.steps < 1 or args.seed < 0:
        parser.error("steps begin at 1, and seeds at 0")
    torch.set_num_threads(1)  # the networks are small
    began = time.perf_counter()
    env = VecNormalize(make_vec_env("reachlab/Reach-v0", 64, args.seed, env_kwargs=SETTINGS), norm_reward=False)
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=64,
        batch_size=1024,
        n_epochs=4,
        # `left` falls from 1 to 0, and below it in a last rollout that takes more steps than are left.
        learning_rate=lambda left: 2e-3 * max(left, 0.0),
        gamma=0.98,
        gae_lambda=0.9,
        policy_kwargs={"log_std_init": math.log(0.2)},  # half of the action box
        seed=args.seed,
        device="cpu",
    )
    judge = make_judge(model, env)
    goes_on = ConvertCallback(lambda *_: judge(VALIDATION_SEED).success_rate < 1)
    model.learn(args.steps, EveryNTimesteps(VALIDATION_STEPS, goes_on))
    result = {"steps": model.num_timesteps, "seed": args.seed, "wall_s": round(time.perf_counter() - began, 1)}
    if args.save:
        model.save(f"{args.save}.zip")
        env.save(f"{args.save}.pkl")
    report = judge(FRESH_SEED)
    print(json.dumps({"success": report.success_rate, "interval": report.success_interval, **result}))


if __name__ == "__main__":
    main()
