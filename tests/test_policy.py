from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reachlab.agents.policy import Gaussian, Normaliser, distribution, make_policy, value
from reachlab.jax_setup import jit
from reachlab.settings.validation import InputError
from reachlab.tasks.schema import Field, Schema

K, A = 5, 3

ACTION_BOUNDS = np.array([-0.4, -0.4, -0.6], np.float32), np.array([0.4, 0.4, 0.3], np.float32)
"""The tutorial's box, which is not centred."""

SCHEMA = Schema((Field("numbers", "1", (K,), (-1.0,) * K, (1.0,) * K, (False,) * K, picture=False),))


@jit
def make(key):
    return make_policy(key, SCHEMA, ACTION_BOUNDS, (16, 8), initial_std=0.4)


@pytest.fixture(scope="module")
def policy():
    return make(jax.random.key(0))


act = jit(lambda policy, observation: policy.act(observation))
sample = jit(lambda policy, observation, key: policy.act(observation, key))


def normal(seed, *shape):
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def fresh(k):
    return Normaliser(jnp.zeros(k), jnp.ones(k), jnp.zeros(()))


def test_an_observation_may_be_a_list_of_numbers(policy):
    numbers = [0.1, -0.2, 0.3, 0.4, -0.5]
    np.testing.assert_array_equal(policy.act(numbers), policy.act(jnp.asarray(numbers, jnp.float32)))


def test_an_observation_of_another_size_is_refused_in_a_sentence(policy):
    with pytest.raises(
        InputError, match=r"observes numbers, 5 numbers, and got an array of shape \(2, 3\): give the env"
    ):
        policy.act(np.zeros((2, 3), np.float32))


# --- the normaliser ----------------------------------------------------------------------------------

# Few shapes, as JAX compiles for each; the data vary by seed, offset and spread.
chunks = st.lists(st.sampled_from([1, 2, 9]), min_size=1, max_size=5)


@settings(max_examples=25, deadline=None)
@given(chunks, st.integers(0, 2**32 - 1), st.floats(-50, 50), st.floats(0.1, 20))
def test_normaliser_knows_the_moments_of_all_it_was_given(sizes, seed, offset, spread):
    rng = np.random.default_rng(seed)
    # Every chunk has its own mean, so that merging them has something to get wrong.
    parts = [(offset + spread * (rng.normal() + rng.normal(size=(n, 2)))).astype(np.float32) for n in sizes]
    normaliser = fresh(2)
    for part in parts:
        normaliser = normaliser.update(jnp.asarray(part), len(part))
    given = np.concatenate(parts).astype(np.float64)
    scale = np.abs(given).max()
    assert normaliser.count == len(given)
    np.testing.assert_allclose(normaliser.mean, given.mean(0), atol=1e-5 * scale)
    # Differences of numbers of this scale are squared.
    np.testing.assert_allclose(normaliser.variance, given.var(0), rtol=1e-4, atol=1e-5 * scale * spread)


def test_normalised_observations_have_mean_0_and_variance_1():
    data = np.random.default_rng(0).normal([3.0, -200.0], [0.01, 40.0], (1000, 2)).astype(np.float32)
    scaled = np.asarray(fresh(2).update(jnp.asarray(data), len(data))(jnp.asarray(data)))
    np.testing.assert_allclose(scaled.mean(0), 0.0, atol=0.01)
    np.testing.assert_allclose(scaled.std(0), 1.0, atol=0.02)


def test_a_constant_observation_and_an_outlier_stay_finite_and_bounded():
    normaliser = fresh(1).update(jnp.full((10, 1), 2.0), 10)
    np.testing.assert_allclose(normaliser(jnp.asarray([2.0])), 0.0)
    far = np.asarray(normaliser(jnp.asarray([[1e9], [-1e9]])))[:, 0]
    assert np.isfinite(far).all()
    assert far[0] == -far[1] > 0


# --- the Gaussian ------------------------------------------------------------------------------------


def test_log_prob_is_the_density_of_independent_normals():
    mean, std = np.array([[0.5, -1.0, 2.0], [0.0, 0.0, 0.0]]), np.array([0.1, 1.0, 3.0])
    at = np.array([[0.6, -3.0, 2.0], [0.05, 1.0, -4.0]])
    density = np.prod(np.exp(-((at - mean) ** 2) / (2 * std**2)) / np.sqrt(2 * math.pi * std**2), axis=1)
    head = Gaussian(jnp.asarray(mean), jnp.log(jnp.asarray(std)))
    np.testing.assert_allclose(head.log_prob(jnp.asarray(at)), np.log(density), rtol=1e-5)


def test_samples_have_the_mean_and_spread_and_entropy_they_claim():
    mean, std = np.array([0.5, -1.0]), np.array([0.1, 2.0])
    head = Gaussian(jnp.broadcast_to(jnp.asarray(mean, jnp.float32), (40_000, 2)), jnp.log(jnp.asarray(std)))
    drawn = jit(lambda head, key: head.sample(key))(head, jax.random.key(0))
    sampled = np.asarray(drawn)
    # Five standard errors.
    np.testing.assert_allclose((sampled.mean(0) - mean) / std, 0.0, atol=5 / 200)
    np.testing.assert_allclose(sampled.std(0) / std, 1.0, atol=5 / 280)
    np.testing.assert_allclose(np.corrcoef(sampled.T)[0, 1], 0.0, atol=5 / 200)
    # Entropy is the mean of -log p.
    np.testing.assert_allclose(-head.log_prob(drawn).mean(), head.entropy(), atol=5 / 200)


# --- the policy --------------------------------------------------------------------------------------


def test_without_a_key_the_policy_is_deterministic(policy):
    observation = normal(1, 4, K)
    mean = act(policy, observation)
    np.testing.assert_array_equal(mean, act(policy, observation))
    sampled = sample(policy, observation, jax.random.key(2))
    np.testing.assert_array_equal(sampled, sample(policy, observation, jax.random.key(2)))
    assert not np.array_equal(sampled, mean)
    assert not np.array_equal(sampled, sample(policy, observation, jax.random.key(3)))


def test_samples_scatter_around_the_deterministic_action_in_units_of_the_box(policy):
    observation = np.broadcast_to(np.arange(K, dtype=np.float32), (20_000, K))
    sampled = np.asarray(sample(policy, observation, jax.random.key(4)))
    half = (ACTION_BOUNDS[1] - ACTION_BOUNDS[0]) / 2
    np.testing.assert_allclose((sampled.mean(0) - act(policy, observation[0])) / half, 0.0, atol=0.02)
    np.testing.assert_allclose(sampled.std(0) / half, 0.4, atol=0.02)


def test_network_outputs_of_minus_1_0_and_1_are_the_lower_bound_centre_and_upper_bound(policy):
    low, high = ACTION_BOUNDS
    np.testing.assert_allclose(policy.action(jnp.zeros(A)), (low + high) / 2, atol=1e-7)
    np.testing.assert_allclose(policy.action(jnp.ones(A)), high, atol=1e-6)
    np.testing.assert_allclose(policy.action(-jnp.ones(A)), low, atol=1e-6)


def test_first_actions_are_near_the_centre_of_the_box(policy):
    observation = normal(5, 100, K)
    output = (act(policy, observation) - policy.centre) / policy.half
    assert 0 < np.abs(output).max() < 0.1


def test_act_normalises_what_it_observes(policy):
    observed = 1000.0 + normal(6, 500, K)
    trained = policy.observed(observed)
    scaled = (observed - observed.mean(0)) / observed.std(0)
    np.testing.assert_allclose(act(trained, observed), act(policy, scaled), atol=1e-3 * 0.4)
    # Without the normaliser all of them are the same to the saturated network.
    assert np.asarray(act(trained, observed)).std(0).min() > 10 * np.asarray(act(policy, observed)).std(0).max()


@pytest.mark.parametrize("shape", [(), (4,), (2, 3)])
def test_leading_shapes_pass_through(policy, shape):
    observation = normal(7, *shape, K)
    assert act(policy, observation).shape == (*shape, A)
    inputs = policy.inputs(observation)
    assert value(policy.parameters, inputs).shape == shape
    assert distribution(policy.parameters, inputs).log_prob(jnp.zeros((*shape, A))).shape == shape


def test_equal_keys_make_equal_policies_and_others_do_not(policy):
    same, other = (make(jax.random.key(seed)) for seed in (0, 1))
    jax.tree.map(np.testing.assert_array_equal, same, policy)
    assert not np.array_equal(other.parameters.actor[0][0], policy.parameters.actor[0][0])
    # Actor and critic start from samples of their own.
    assert not np.array_equal(same.parameters.actor[0][0], same.parameters.critic[0][0])
