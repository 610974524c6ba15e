"""PPO in one compiled program, in PureJaxRL's style: an arm learns to touch a point on the table."""

import argparse
import json
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import optax
from jax import Array
from jax.nn.initializers import orthogonal

import reachlab
from reachlab.evaluation.episodes import make_runner
from reachlab.jax_setup import jit  # with `jax.jit` the environment's steps take longer, see `reachlab.gymnax`

SETTINGS: dict[str, Any] = {"observation": "target+tool", "reward": "dense"}
NUM_ENVS, ROLLOUT_STEPS = 64, 64
EPOCHS, MINIBATCHES, VALIDATION = 4, 4, 16  # updates from one validation to the next
LEARNING_RATE = 2e-3  # at the start; it falls to 0
GAMMA, GAE_LAMBDA = 0.98, 0.9
CLIP, VALUE_WEIGHT, MAX_GRAD_NORM = 0.2, 0.5, 0.5
INITIAL_STD, HIDDEN = 0.2, 64  # half of the action box; units of a layer


def perceptron(key: Array, inputs: int, outputs: int, last_gain: float) -> list[tuple[Array, Array]]:
    """Weights and biases of a perceptron."""
    layers = [(inputs, HIDDEN, 2**0.5), (HIDDEN, HIDDEN, 2**0.5), (HIDDEN, outputs, last_gain)]
    keys = jax.random.split(key, len(layers))
    return [(orthogonal(gain)(k, (a, b)), jnp.zeros(b)) for k, (a, b, gain) in zip(keys, layers, strict=True)]


def output(layers: list[tuple[Array, Array]], x: Array) -> Array:
    """What a perceptron makes of inputs `[..., inputs]`."""
    for weight, bias in layers[:-1]:
        x = jnp.tanh(x @ weight + bias)
    return x @ layers[-1][0] + layers[-1][1]


def log_probability(parameters: dict[str, Any], observation: Array, action: Array) -> Array:
    """Logarithm of an action's probability density, but for a constant."""
    noise = (action - output(parameters["actor"], observation)) / jnp.exp(parameters["log_std"])
    return -(0.5 * noise**2 + parameters["log_std"]).sum(-1)


def powers(observation: Array) -> Array:
    """Sums of ones, observations and their squares, over the batch."""
    return jnp.stack([observation**power for power in range(3)]).sum(1)


def scaled(sums: Array, observation: Array) -> Array:
    """The observation with the mean taken away and in standard deviations, of `powers` that were added up."""
    mean, square = sums[1:] / sums[0]
    return jnp.clip((observation - mean) / jnp.sqrt(jnp.maximum(square - mean**2, 1e-6)), -10, 10)


def loss(parameters: dict[str, Any], batch: list[Array]) -> Array:
    """PPO's loss of policy and value."""
    observation, action, before, value, advantage = batch
    ratio = jnp.exp(log_probability(parameters, observation, action) - before)
    weight = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    gain = jnp.minimum(ratio * weight, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * weight).mean()
    misfit = ((output(parameters["critic"], observation)[..., 0] - value - advantage) ** 2).mean()
    return VALUE_WEIGHT * misfit - gain


def make_training(env: reachlab.Env, updates: int) -> tuple[Callable[[Array], Any], Callable[[Any, Array], Any]]:
    """Functions that give what a training begins with, and what it has come to after an iteration for each key.

    These are parameters, the optimiser's memory, the sums that scale observations, and the environment's state.
    """
    box, size = jnp.asarray(env.schema.bounds), len(env.action_bounds[0])
    rates = optax.linear_schedule(LEARNING_RATE, 0.0, updates * EPOCHS * MINIBATCHES)
    optimiser = optax.chain(optax.clip_by_global_norm(MAX_GRAD_NORM), optax.adam(rates, eps=1e-5))

    def iteration(carry: Any, key: Array) -> tuple[Any, None]:
        parameters, memory, sums, state = carry
        for_batches, *for_actions = jax.random.split(key, 1 + ROLLOUT_STEPS)

        def value(seen: Any) -> Array:
            return output(parameters["critic"], scaled(sums, seen))[:, 0]

        def step(state: Any, key: Array) -> tuple[Any, Any]:
            seen: Any = env.observe(state)
            x = scaled(sums, seen)
            noise = jax.random.normal(key, (NUM_ENVS, size))
            action = output(parameters["actor"], x) + jnp.exp(parameters["log_std"]) * noise
            kept = (x, action, log_probability(parameters, x, action), value(seen))
            state, now = env.step(state, action)
            # An episode that only ran out of time would have earned more: what its last observation promises.
            reward = now.reward + GAMMA * now.truncated * value(now.observation)
            return env.reset(state, now.done), (kept, reward, 1.0 - now.done, powers(seen))

        def advantage(carry: tuple[Array, Array], now: Any) -> tuple[Any, Array]:
            (following, next_value), (value, reward, goes_on) = carry, now
            advantage = reward + GAMMA * goes_on * (next_value + GAE_LAMBDA * following) - value
            return (advantage, value), advantage

        def descend(carry: Any, chosen: Array) -> tuple[Any, None]:
            parameters, memory = carry
            change, memory = optimiser.update(jax.grad(loss)(parameters, [x[chosen] for x in rollout]), memory)
            return (optax.apply_updates(parameters, change), memory), None

        state, (kept, reward, goes_on, watched) = jax.lax.scan(step, state, jnp.stack(for_actions))
        start = jnp.zeros(NUM_ENVS), value(env.observe(state))
        _, advantages = jax.lax.scan(advantage, start, (kept[-1], reward, goes_on), reverse=True)
        rollout = [x.reshape(-1, *x.shape[2:]) for x in (*kept, advantages)]
        orders = [jax.random.permutation(key, len(rollout[0])) for key in jax.random.split(for_batches, EPOCHS)]
        batches = jnp.concatenate(orders).reshape(EPOCHS * MINIBATCHES, -1)
        carry, _ = jax.lax.scan(descend, (parameters, memory), batches)
        return (*carry, sums + watched.sum(0), state), None

    def begin(key: Array) -> Any:
        for_actor, for_critic, for_env = jax.random.split(key, 3)
        actor, critic = perceptron(for_actor, box.shape[1], size, 0.01), perceptron(for_critic, box.shape[1], 1, 1.0)
        parameters = {"actor": actor, "critic": critic, "log_std": jnp.full(size, jnp.log(INITIAL_STD))}
        return parameters, optimiser.init(parameters), powers(box), env.init(jax.random.split(for_env, NUM_ENVS))

    return jit(begin), jit(lambda carry, keys: jax.lax.scan(iteration, carry, keys)[0])


def main() -> None:
    """Learn until every goal of a validation is reached, evaluate on others, and print the result as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=1_000_000, help="environment steps, rounded up to a validation")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    if args.steps < 1 or args.seed < 0:
        parser.error("steps begin at 1, and seeds at 0")
    began = time.perf_counter()
    config = reachlab.configure("tutorial", **SETTINGS)
    updates = -(-args.steps // (NUM_ENVS * ROLLOUT_STEPS))
    begin, advance = make_training(reachlab.Env(config, NUM_ENVS), updates)
    held_out, decide = reachlab.Env(config, 1000), jax.jit(lambda actor, sums, seen: output(actor, scaled(sums, seen)))

    def act(observation: Array) -> Array:
        return decide(carry[0]["actor"], carry[2], observation)

    runner = make_runner(held_out, act)  # compiled once
    key = jax.random.key(args.seed)
    carry, done, success = begin(key), 0, 0.0
    while done < updates and success < 1:
        carry = advance(carry, jax.random.split(jax.random.fold_in(key, done), VALIDATION))
        done += VALIDATION
        success = reachlab.evaluate(held_out, act, seed=1, runner=runner).success_rate
    steps, wall_s = done * NUM_ENVS * ROLLOUT_STEPS, round(time.perf_counter() - began, 1)
    report = reachlab.evaluate(held_out, act, seed=5000, runner=runner)
    judged = {"success": report.success_rate, "interval": report.success_interval}
    print(json.dumps({**judged, "steps": steps, "seed": args.seed, "wall_s": wall_s}))


if __name__ == "__main__":
    main()
