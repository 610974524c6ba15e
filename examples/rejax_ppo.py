"""PPO of rejax, a trainer written for gymnax, learns the tutorial's task; reachlab judges it on held-out goals.

make gymnax
.venv-gymnax/bin/python examples/rejax_ppo.py --seed 0
"""

from __future__ import annotations

import argparse
import json
import time

import jax
import jax.numpy as jnp
import optax
from gymnax.wrappers.compat import LegacyStepAPIWrapper  # pyright: ignore[reportMissingImports]
from rejax import PPO  # pyright: ignore[reportMissingImports]

import reachlab
import reachlab.gymnax

SETTINGS = {"observation": "target+tool", "reward": "dense"}

NUM_ENVS, ROLLOUT_STEPS = 128, 64

LEARNING_RATE = (1e-3, 1e-4)
"""At the start and at the end."""

INITIAL_STD = 0.2
"""Noise of the actions at the start; their box is about 0.4 to either side."""

INITIAL_MEAN = 0.01
"""Factor of the actor's last layer at the start."""

HELD_OUT_SEED, HELD_OUT_EPISODES = 5000, 1000

EPOCHS, MINIBATCHES = 8, 2


class FiveValues(LegacyStepAPIWrapper):
    """Gymnax's former `step` of five values, which rejax expects; unlike gymnax's class it can be copied."""

    def __deepcopy__(self, memo: dict[int, object]) -> FiveValues:
        """The wrapper itself: it holds no state."""
        return self


def main() -> None:
    """Train, judge, and print one line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1_000_000, help="environment steps")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    if asked.steps < 1 or asked.seed < 0:
        parser.error("steps begin at 1, and seeds at 0")

    started = time.perf_counter()
    env, params = reachlab.gymnax.make("tutorial", **SETTINGS)
    updates = asked.steps // (NUM_ENVS * ROLLOUT_STEPS) * EPOCHS * MINIBATCHES
    algorithm = PPO.create(
        env=FiveValues(env),
        env_params=params,
        num_envs=NUM_ENVS,
        num_steps=ROLLOUT_STEPS,
        num_epochs=EPOCHS,
        num_minibatches=MINIBATCHES,
        learning_rate=optax.linear_schedule(*LEARNING_RATE, updates),
        gamma=0.98,
        ent_coef=0.0,
        max_grad_norm=0.5,
        normalize_observations=True,
        agent_kwargs={"activation": "tanh"},
        total_timesteps=asked.steps,
        eval_freq=asked.steps,
        skip_initial_evaluation=True,
    ).replace(eval_callback=lambda *_: ())  # judged below

    def train(key: jax.Array) -> PPO:
        state = algorithm.init_state(key)
        actor = state.actor_ts.params["params"]
        # Without this the first actions are several times as large as their box.
        actor = actor | {
            "action_mean": jax.tree.map(lambda x: INITIAL_MEAN * x, actor["action_mean"]),
            "action_log_std": jnp.full_like(actor["action_log_std"], jnp.log(INITIAL_STD)),
        }
        state = state.replace(actor_ts=state.actor_ts.replace(params={"params": actor}))
        return algorithm.train(train_state=state)[0]

    # With `jax.jit` the environment's steps take longer, see `reachlab.gymnax`.
    trained = jax.block_until_ready(reachlab.gymnax.jit(train)(jax.random.key(asked.seed)))
    train_s = time.perf_counter() - started

    def act(observation: jax.Array) -> jax.Array:
        seen = algorithm.normalize_obs(trained.obs_rms_state, observation)
        return algorithm.actor.apply(trained.actor_ts.params, seen, method="_action_dist").mean()

    config = reachlab.configure("tutorial", **SETTINGS)
    judged = reachlab.Env(config, HELD_OUT_EPISODES)
    report = reachlab.evaluate(judged, act, seed=HELD_OUT_SEED, episodes=HELD_OUT_EPISODES)
    said = {"seed": asked.seed, "steps": int(trained.global_step), "train_s": round(train_s, 1)}
    print(json.dumps(said | {"success_rate": report.success_rate, "steps_mean": report.steps_mean}))


if __name__ == "__main__":
    main()
