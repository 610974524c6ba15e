from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reachlab.agents.policy import Inputs, Normaliser, distribution, make_policy, value
from reachlab.jax_setup import jit
from reachlab.learn import ppo
from reachlab.learn.learner import make_learner, make_optimiser
from reachlab.learn.rollout import Rollout
from reachlab.settings.config import LoopConfig, PPOConfig, RunConfig
from reachlab.settings.json_form import override
from reachlab.tasks.schema import Field, Schema

K, A, T, B = 4, 2, 6, 8

CONFIG = RunConfig(
    loop=LoopConfig(num_envs=B, rollout_steps=T),
    ppo=PPOConfig(epochs=1, minibatches=1, clip_ratio=0.2, value_weight=0.5, entropy_weight=0.01),
)

SCHEMA = Schema((Field("numbers", "1", (K,), (-1.0,) * K, (1.0,) * K, (False,) * K, picture=False),))


@pytest.fixture(scope="module")
def policy():
    """Untrained, with a normaliser that changes what it is given."""
    box = -np.ones(A, np.float32), np.ones(A, np.float32)
    made = jit(lambda key: make_policy(key, SCHEMA, box, (8,), initial_std=0.4))(jax.random.key(0))
    return replace(made, normaliser=Normaliser(jnp.full(K, 3.0), jnp.full(K, 4.0), jnp.asarray(100.0)))


@jit
def sampled(parameters, inputs, key):
    """Samples of the policy, and how likely they are."""
    head = distribution(parameters, inputs)
    output = head.sample(key)
    return output, head.log_prob(output)


inputs = jit(lambda policy, observation: policy.inputs(observation))


@pytest.fixture(scope="module")
def rollout(policy):
    random = np.random.default_rng(1)
    observation, next_observation = (2 + random.normal(size=(2, T, B, K))).astype(np.float32)
    output, log_prob = sampled(policy.parameters, inputs(policy, observation), jax.random.key(1))
    terminated = random.random((T, B)) < 0.2
    given = {
        "observation": observation,
        "output": output,
        "log_prob": log_prob,
        "next_observation": next_observation,
        "reward": random.normal(size=(T, B)).astype(np.float32),
        "terminated": terminated,
        "truncated": ~terminated & (np.arange(T) == 3)[:, None],
        "success": terminated,
        "distance": np.ones((T, B), np.float32),
        "clock": np.ones((T, B), np.int32),
    }
    return Rollout(**jax.tree.map(jnp.asarray, given))


def start(config, policy):
    """A learner with this policy that has learnt nothing yet."""
    return make_learner(make_optimiser(config, ppo.updates_per_iteration(config.ppo)), policy)


@functools.cache
def updater(config):
    return jit(lambda learner, rollout, key: ppo.update(learner, rollout, key, config))


# --- advantages --------------------------------------------------------------------------------------


gae = jit(ppo.gae)

NONE, ENDS = [False, False, False], [False, True, False]


def estimate(reward, v_t, v_tp1, terminated, done, gamma, gae_lambda):
    columns = (jnp.asarray(numbers)[:, None] for numbers in (reward, v_t, v_tp1, terminated, done))
    return np.asarray(gae(*columns, gamma, gae_lambda))[:, 0]


def test_gae_by_hand():
    """γ = ½, λ = ½. δ = 1 + ½·4 − 2 = 1; 2 + ½·8 − 4 = 2; 3 + ½·2 − 8 = −4. A = −4; 2 − ¼·4; 1 + ¼·1."""
    result = estimate([1.0, 2.0, 3.0], [2.0, 4.0, 8.0], [4.0, 8.0, 2.0], NONE, NONE, 0.5, 0.5)
    np.testing.assert_allclose(result, [1.25, 1.0, -4.0])


def test_gae_takes_no_value_from_beyond_a_termination():
    """δ = 1 + ½·4 − 2 = 1; 2 − 4 = −2, as the episode ends there; 3 + ½·2 − 8 = −4 is another's."""
    result = estimate([1.0, 2.0, 3.0], [2.0, 4.0, 8.0], [4.0, 100.0, 2.0], ENDS, ENDS, 0.5, 0.5)
    np.testing.assert_allclose(result, [0.5, -2.0, -4.0])


def test_gae_values_the_final_state_of_a_truncated_episode_and_lets_nothing_leak_across():
    """δ = 1 + ½·4 − 2 = 1; 2 + ½·10 − 4 = 3 with the value of its own last state; the rest is another's."""
    result = estimate([1.0, 2.0, 3.0], [2.0, 4.0, 8.0], [4.0, 10.0, 2.0], NONE, ENDS, 0.5, 0.5)
    np.testing.assert_allclose(result, [1.75, 3.0, -4.0])


def test_gae_of_lambda_1_is_the_discounted_return_less_the_value(rollout):
    """Each step's return is summed forwards, to the end of its episode or of the rollout."""
    v_t, last = np.random.default_rng(3).normal(size=(2, T, B)).astype(np.float32)
    done, terminated, reward = map(np.asarray, (rollout.done, rollout.terminated, rollout.reward))
    # Within an episode the next value is the value of the next step.
    v_tp1 = np.where(done, last, np.concatenate([v_t[1:], last[-1:]]))
    expected = np.zeros((T, B))
    for t, b in np.ndindex(T, B):
        end = next((i for i in range(t, T) if done[i, b]), T - 1)
        gains = sum(0.9 ** (i - t) * reward[i, b] for i in range(t, end + 1))
        bootstrap = 0.0 if terminated[end, b] else 0.9 ** (end - t + 1) * v_tp1[end, b]
        expected[t, b] = gains + bootstrap - v_t[t, b]
    result = gae(*map(jnp.asarray, (reward, v_t, v_tp1, terminated, done)), 0.9, 1.0)
    np.testing.assert_allclose(result, expected, rtol=1e-4, atol=1e-5)


# --- the loss ----------------------------------------------------------------------------------------


@functools.cache
def grading(config):
    """Loss with what it watches, and its gradient, compiled."""
    return jit(jax.value_and_grad(lambda parameters, batch: ppo.loss(parameters, batch, config.ppo), has_aux=True))


def gradient_of(parameters, batch, config):
    return grading(config)(parameters, batch)[1]


def loss_of(parameters, batch, config):
    return grading(config)(parameters, batch)[0]


log_prob = jit(lambda parameters, batch: distribution(parameters, batch.inputs).log_prob(batch.output))


def make_batch(policy, advantage, log_ratio: Any = 0.0):
    """Batch whose samples are `exp(log_ratio)` times as likely under the policy as when they were sampled."""
    random, n = np.random.default_rng(5), len(advantage)
    observed = Inputs(None, jnp.asarray(random.normal(size=(n, K)), jnp.float32))
    output, log_prob = sampled(policy.parameters, observed, jax.random.key(5))
    rest = np.asarray(log_prob) - np.asarray(log_ratio), np.asarray(advantage), random.normal(size=n)
    log_prob, advantage, returns = (jnp.asarray(numbers.astype(np.float32)) for numbers in rest)
    return ppo.Batch(observed, output, log_prob, advantage, returns)


def test_loss_of_the_policy_that_sampled_the_batch(policy):
    """The ratio is 1 and normalised advantages cancel; half the squared value error and the entropy remain."""
    batch = make_batch(policy, [1.0, -2.0, 3.0, 0.5])
    total, watched = loss_of(policy.parameters, batch, CONFIG)
    error = np.asarray(value(policy.parameters, batch.inputs) - batch.returns)
    entropy = A * (np.log(0.4) + 0.5 * np.log(2 * np.pi * np.e))
    np.testing.assert_allclose(total, 0.5 * 0.5 * np.square(error).mean() - 0.01 * entropy, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(watched["kl"], 0.0, atol=1e-6)
    assert watched["clip_fraction"] == 0.0


def test_policy_gradient_at_ratio_1_is_that_of_log_prob_times_advantage(policy):
    advantage = np.array([1.0, -2.0, 3.0, 0.5], np.float32)
    batch = make_batch(policy, advantage)
    weight = (advantage - advantage.mean()) / advantage.std()

    def plain(parameters):
        return -(distribution(parameters, batch.inputs).log_prob(batch.output) * weight).mean()

    only_policy = override(CONFIG, value_weight=0.0, entropy_weight=0.0)
    found = gradient_of(policy.parameters, batch, only_policy)
    expected = jit(jax.grad(plain))(policy.parameters)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-5), found, expected)


@pytest.mark.parametrize(
    ("ratio", "sign", "moves"),
    [(1.5, 1, False), (1.5, -1, True), (0.5, 1, True), (0.5, -1, False), (1.1, 1, True), (0.9, -1, True)],
)
def test_clipping_stops_the_gradient_only_where_the_ratio_has_already_gone_the_right_way(policy, ratio, sign, moves):
    """Sample 0 has the ratio and a large advantage of that sign; the others lie where they have no gradient."""
    advantage = sign * np.array([3.0, -1.0, -1.0, -1.0], np.float32)
    # Normalised advantages of the others have the opposite sign: they are clipped on the other side.
    others = np.log(0.5 if sign > 0 else 1.5)
    batch = make_batch(policy, advantage, [np.log(ratio), others, others, others])
    only_policy = override(CONFIG, value_weight=0.0, entropy_weight=0.0)
    gradient = gradient_of(policy.parameters, batch, only_policy)
    size = float(sum(jnp.abs(leaf).sum() for leaf in jax.tree.leaves(gradient)))
    assert (size > 1e-3) == moves
    if moves:
        # A step down the gradient makes a good sample likelier and a bad one less likely.
        stepped = jax.tree.map(lambda p, g: p - 1e-3 * g, policy.parameters, gradient)
        before, after = (log_prob(p, batch)[0] for p in (policy.parameters, stepped))
        assert sign * (after - before) > 0


def test_value_and_entropy_weights_pull_the_right_way(policy):
    batch = make_batch(policy, [0.0, 0.0, 0.0, 0.0])
    weighted = override(CONFIG, value_weight=1.0, entropy_weight=1.0)
    gradient = gradient_of(policy.parameters, batch, weighted)
    stepped = jax.tree.map(lambda p, g: p - 0.01 * g, policy.parameters, gradient)
    _, before = loss_of(policy.parameters, batch, CONFIG)
    _, after = loss_of(stepped, batch, CONFIG)
    assert after["value_loss"] < before["value_loss"]
    assert after["entropy"] > before["entropy"]


def test_watched_scalars_report_how_far_the_policy_has_moved(policy):
    ratio = np.array([1.5, 1.1, 0.7, 1.0])
    _, watched = loss_of(policy.parameters, make_batch(policy, [1.0, 2.0, 3.0, 4.0], np.log(ratio)), CONFIG)
    np.testing.assert_allclose(watched["clip_fraction"], 0.5)
    np.testing.assert_allclose(watched["kl"], (ratio - 1 - np.log(ratio)).mean(), rtol=1e-4)


# --- the optimiser -----------------------------------------------------------------------------------


def changes(config, gradients):
    """What the optimiser adds to parameters, for each of the gradients in turn."""
    optimiser = make_optimiser(config, ppo.updates_per_iteration(config.ppo))
    step = jit(optimiser.update)
    state = optimiser.init(jax.tree.map(jnp.zeros_like, gradients[0]))
    result = []
    for gradient in gradients:
        change, state = step(gradient, state)
        result.append(change)
    return result


def test_the_norm_of_all_gradients_together_is_bounded():
    """Adam on gradients shortened to 0.5 by their global norm, worked out in NumPy over two steps.

    Adam forgets the scale of a single gradient, so the second step, with a short gradient, shows what the
    first one was shortened to. Clipping each element, or each array, would give other numbers.
    """
    config = override(CONFIG, max_grad_norm=0.5, learning_rate=1e-2, final_learning_rate=1e-2)
    first = {"a": np.array([30.0, 0.0]), "b": np.array([[40.0], [0.3]])}
    second = {"a": np.array([0.1, 0.2]), "b": np.array([[-0.1], [0.3]])}
    norm = np.sqrt(sum(np.square(g).sum() for g in first.values()))
    found = changes(config, [jax.tree.map(jnp.asarray, g) for g in (first, second)])[1]
    for name in first:
        g1, g2 = first[name] * 0.5 / norm, second[name]
        mean = (0.9 * 0.1 * g1 + 0.1 * g2) / (1 - 0.9**2)
        square = (0.999 * 0.001 * g1**2 + 0.001 * g2**2) / (1 - 0.999**2)
        np.testing.assert_allclose(found[name], -1e-2 * mean / (np.sqrt(square) + 1e-5), rtol=1e-3, atol=1e-7)


def test_learning_rate_falls_on_a_line_from_its_first_to_its_final_value():
    """A constant gradient makes every step of Adam as long as the learning rate."""
    loop = {"num_envs": 10, "rollout_steps": 2, "action_repeat": 5}
    rate = {"anneal_steps": 500, "max_grad_norm": 0.5, "learning_rate": 1e-2, "final_learning_rate": 2e-3}
    config = override(CONFIG, **loop, **rate, epochs=2, minibatches=2)
    updates = 500 // 100 * 2 * 2
    rates = -np.ravel(changes(config, [jnp.asarray(0.4)] * (updates + 3)))
    np.testing.assert_allclose(rates[: updates + 1], np.linspace(1e-2, 2e-3, updates + 1), rtol=1e-3)
    np.testing.assert_allclose(rates[updates:], 2e-3, rtol=1e-3)


def test_noise_follows_its_schedule_or_what_is_learnt(policy, rollout):
    scheduled = override(CONFIG, initial_std=0.4, final_std=0.1, anneal_steps=2 * T * B * 4, action_repeat=4)
    fresh = replace(policy, normaliser=replace(policy.normaliser, count=jnp.zeros(())))
    learner = start(scheduled, fresh)
    for wanted in (0.2, 0.1, 0.1):
        learner, watched = updater(scheduled)(learner, rollout, jax.random.key(6))
        np.testing.assert_allclose(watched["std"], wanted, rtol=1e-5)
    _, learnt = updater(CONFIG)(start(CONFIG, fresh), rollout, jax.random.key(6))
    assert 0.39 < learnt["std"] < 0.41
    assert learnt["std"] != np.float32(0.4)


# --- minibatches -------------------------------------------------------------------------------------


def shuffle(seed, steps, num_envs):
    return np.asarray(shuffler(steps, num_envs)(jax.random.key(seed)))


@functools.cache
def shuffler(steps, num_envs):
    return jit(lambda key: ppo._shuffle(key, steps, num_envs))


@pytest.mark.parametrize(("steps", "num_envs", "minibatches"), [(16, 32, 4), (1, 6, 3)])
def test_each_minibatch_has_environments_of_its_own_at_every_step(steps, num_envs, minibatches):
    order = shuffle(0, steps, num_envs)
    assert sorted(order) == list(range(steps * num_envs))
    for rows in order.reshape(minibatches, -1):
        for step in range(steps):
            used = rows[rows // num_envs == step] % num_envs
            assert len(set(used)) == num_envs // minibatches


def test_minibatches_change_from_epoch_to_epoch_and_mix_environments_from_step_to_step():
    one, other = (shuffle(seed, 16, 32) for seed in (0, 1))
    assert not np.array_equal(one, other)
    half = one[: len(one) // 2]
    envs_by_step = {tuple(sorted(half[half // 32 == step] % 32)) for step in range(16)}
    assert len(envs_by_step) > 4


# --- the update --------------------------------------------------------------------------------------


def test_update_learns_with_the_normaliser_that_collected_the_rollout_and_hands_on_one_that_knows_it(policy, rollout):
    learner, watched = updater(CONFIG)(start(CONFIG, policy), rollout, jax.random.key(6))
    np.testing.assert_allclose(watched["kl"], 0.0, atol=1e-6, err_msg="only then is the first ratio exactly 1")
    assert watched["clip_fraction"] == 0.0
    observed = np.asarray(rollout.observation).reshape(-1, K)
    n, mean = T * B, observed.mean(0)
    count = 100 + n
    merged = (100 * 3.0 + n * mean) / count
    # Second moments about zero add up.
    moment = (100 * (4.0 + 3.0**2) + n * (observed.var(0) + mean**2)) / count - merged**2
    assert learner.policy.normaliser.count == count
    np.testing.assert_allclose(learner.policy.normaliser.mean, merged, rtol=1e-5)
    np.testing.assert_allclose(learner.policy.normaliser.variance, moment, rtol=1e-4)


def test_update_of_one_batch_is_one_step_of_the_optimiser_on_the_loss(policy, rollout):
    """The whole of PPO put together by hand from its parts."""
    learner = start(CONFIG, policy)
    found, _ = updater(CONFIG)(learner, rollout, jax.random.key(6))
    values = jit(lambda observation: value(policy.parameters, policy.inputs(observation)))
    v_t, v_tp1 = values(rollout.observation), values(rollout.next_observation)
    advantage = gae(
        rollout.reward, v_t, v_tp1, rollout.terminated, rollout.done, CONFIG.ppo.gamma, CONFIG.ppo.gae_lambda
    )
    batch = ppo.Batch(
        Inputs(None, policy.normaliser(rollout.observation).reshape(-1, K)),
        rollout.output.reshape(-1, A),
        rollout.log_prob.reshape(-1),
        advantage.reshape(-1),
        (advantage + v_t).reshape(-1),
    )
    gradient = gradient_of(policy.parameters, batch, CONFIG)
    (change,) = changes(CONFIG, [gradient])
    expected = jax.tree.map(jnp.add, policy.parameters, change)
    # Adam's first step turns a gradient of rounding into a part of the learning rate, 1e-3.
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=2e-5), found.policy.parameters, expected)


def test_updates_on_one_rollout_raise_the_probability_of_what_paid(policy, rollout):
    """Reward is the first component of the output: the policy's mean has to move that way."""
    config = override(CONFIG, epochs=4, minibatches=2, learning_rate=1e-2, gamma=0.0, value_weight=0.0)
    paid = replace(rollout, reward=rollout.output[..., 0])
    learner, watched = updater(config)(start(config, policy), paid, jax.random.key(7))

    def mean_output(learner):
        head = distribution(learner.policy.parameters, policy.inputs(rollout.observation))
        return head.mean[..., 0].mean()

    assert mean_output(learner) > mean_output(start(config, policy)) + 0.05
    assert watched["kl"] > 0
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((learner, watched)))


def test_equal_keys_give_equal_updates(policy, rollout):
    config = override(CONFIG, epochs=4, minibatches=2, learning_rate=1e-2, gamma=0.0, value_weight=0.0)
    one, same, other = (updater(config)(start(config, policy), rollout, jax.random.key(seed))[0] for seed in (1, 1, 2))
    jax.tree.map(np.testing.assert_array_equal, one, same)
    assert not np.array_equal(one.policy.parameters.actor[0][0], other.policy.parameters.actor[0][0])
