"""Gymnax's face, held against gymnax's own machinery and against `Env`; run by `make gymnax`."""

# pyright: reportMissingImports=false
from __future__ import annotations

from typing import Any

import gymnax.wrappers
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnax.environments import spaces
from gymnax.experimental.rollout import RolloutWrapper
from gymnax.wrappers.gym import GymnaxToGymWrapper, GymnaxToVectorGymWrapper

import reachlab.gymnax
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, Transition
from reachlab.envs.presets import configure
from reachlab.gymnax import jit
from reachlab.settings.validation import InputError
from reachlab.sims.simulator import chosen

STEPS, NUM_ENVS = 300, 4
SHORT: dict[str, Any] = {"max_steps": 20, "clip_actions": False, "success_distance": 0.5, "tool_scale": 0.05}
"""Episodes that end often and in every way."""

ROUNDING = 1e-5
"""Where two compiled programs differ in their last bits."""


@pytest.fixture(scope="module")
def made() -> tuple[Any, Any]:
    return reachlab.gymnax.make("tutorial", **SHORT)


def random_actions(env: Any, *shape: int) -> np.ndarray:
    space = env.action_space()
    return np.random.default_rng(7).uniform(space.low, space.high, (*shape, *space.shape)).astype(np.float32)


def played(env: Any, params: Any, keys: jax.Array, actions: np.ndarray) -> tuple[Any, ...]:
    """What `step` gave for actions `[T, B, a]` in environments with `keys [B]`, `[T, B, ...]`."""
    step_keys = jax.vmap(lambda key: jax.random.split(key, len(actions)), out_axes=1)(keys)

    def step(state: Any, now: Any) -> Any:
        observation, state, *rest = jax.vmap(env.step, (0, 0, 0, None))(now[0], state, now[1], params)
        return state, (observation, *rest)

    def play() -> Any:
        return jax.lax.scan(step, jax.vmap(env.reset, (0, None))(keys, params)[1], (step_keys, actions))[1]

    return jit(play)()


# --- the same episodes ----------------------------------------------------------------------------


@pytest.mark.parametrize("make_key", [jax.random.key, jax.random.PRNGKey])
def test_equal_keys_give_the_episodes_of_env_bit_for_bit(made: tuple[Any, Any], make_key: Any) -> None:
    env, params = made
    twin = Env(configure("tutorial", randomise=(), **SHORT), 1)

    def begin(key: jax.Array) -> tuple[jax.Array, EnvState]:
        state = twin.init(key[None])
        return twin.observe(state), state

    def follow(key: jax.Array, state: EnvState, action: jax.Array) -> tuple[jax.Array, EnvState, Transition]:
        state, done = twin.step(state, action[None])
        now, begun = (done.observation, state), begin(jax.random.split(key)[1])
        return *chosen(done.done, begun, now), done

    begin_own, follow_own = jit(begin), jit(follow)
    reset, step = jit(lambda key: env.reset(key, params)), jit(lambda *now: env.step(*now, params))
    key, own_key = make_key(3), jax.random.key(3)
    (observation, state), (own_observation, own) = reset(key), begin_own(own_key)
    assert np.array_equal(observation, own_observation[0])
    ends = {"terminated": 0, "truncated": 0, "is_success": 0}
    for action in random_actions(env, STEPS):
        (key, now), (own_key, own_now) = jax.random.split(key), jax.random.split(own_key)
        observation, state, reward, terminated, truncated, info = step(now, state, action)
        own_observation, own, done = follow_own(own_now, own, action)
        assert np.array_equal(observation, own_observation[0])
        assert np.array_equal(info["final_observation"], done.observation[0])
        assert (reward, terminated, truncated) == (done.reward[0], done.terminated[0], done.truncated[0])
        assert (info["is_success"], info["distance"]) == (done.terms["success"][0], done.errors.distance[0])
        assert state.time == own.clock[0]
        ends = {name: count + bool(info[name]) for name, count in ends.items()}
    assert min(ends.values()) > 0, "episodes ended in every way"


def test_a_batch_plays_the_episodes_of_its_environments(made: tuple[Any, Any]) -> None:
    env, params = made
    keys, actions = jax.random.split(jax.random.key(5), NUM_ENVS), random_actions(env, STEPS, NUM_ENVS)
    together = played(env, params, keys, actions)
    alone = played(env, params, keys[1:2], actions[:, 1:2])
    for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
        assert np.asarray(a[:, 1:2], float) == pytest.approx(np.asarray(b, float), abs=ROUNDING)
    *_, terminated, truncated, _ = together
    assert terminated.any()
    assert truncated.any()
    assert not (terminated & truncated).any()


def test_parameters_can_shorten_an_episode(made: tuple[Any, Any]) -> None:
    env, params = made
    assert params.max_steps_in_episode == SHORT["max_steps"]
    still = np.zeros((10, 1, 3), np.float32)
    *_, truncated, _ = played(env, params.replace(max_steps_in_episode=5), jax.random.key(0)[None], still)
    assert truncated[:, 0].tolist() == [False, False, False, False, True] * 2


# --- gymnax's own machinery -----------------------------------------------------------------------


def test_gymnaxs_wrappers_and_rollout_run_on_it(made: tuple[Any, Any]) -> None:
    env, params = made
    logged = gymnax.wrappers.LogWrapper(gymnax.wrappers.FlattenObservationWrapper(env))
    *_, info = played(logged, params, jax.random.split(jax.random.key(0), NUM_ENVS), random_actions(env, 80, NUM_ENVS))
    assert info["returned_episode"].any(axis=0).all()
    assert info["returned_episode_lengths"].max() <= SHORT["max_steps"]
    rollout = RolloutWrapper(env=env)
    observation, action, reward, *_ = rollout.batch_rollout(jax.random.split(jax.random.key(0), NUM_ENVS), None)
    assert rollout.input_shape == (6,)
    assert observation.shape == (NUM_ENVS, SHORT["max_steps"], 6)
    assert action.shape == (NUM_ENVS, SHORT["max_steps"], 3)
    assert np.isfinite(reward).all()


def test_gymnax_makes_gymnasiums_environments_of_it(made: tuple[Any, Any]) -> None:
    env, params = made
    single = GymnaxToGymWrapper(env, params)
    observation, _ = single.reset(seed=3)
    assert single.observation_space.contains(np.asarray(observation))
    observation, _, terminated, truncated, info = single.step(single.action_space.sample())
    assert single.observation_space.contains(np.asarray(observation))
    assert not any((terminated, truncated, info["is_success"]))
    batch = GymnaxToVectorGymWrapper(env, NUM_ENVS, params)
    batch.reset(seed=3)
    observations, rewards, *_ = batch.step(batch.action_space.sample())
    assert observations.shape == (NUM_ENVS, 6)
    assert rewards.shape == (NUM_ENVS,)


def test_it_has_the_spaces_of_env(made: tuple[Any, Any]) -> None:
    env, params = made
    twin = Env(configure("tutorial", **SHORT), 1)
    for space, bounds in (
        (env.observation_space(params), twin.schema.bounds),
        (env.action_space(params), twin.action_bounds),
    ):
        assert isinstance(space, spaces.Box)
        assert np.array_equal((space.low, space.high), bounds)
        assert space.contains(space.sample(jax.random.PRNGKey(0)))


def test_goals_are_observed_as_a_dict() -> None:
    env, params = reachlab.gymnax.make("tutorial", observation="goal", reward="goal", end_outside=False)
    observation, state = env.reset(jax.random.key(0), params)
    space = env.observation_space(params)
    assert set(observation) == set(space.spaces) == {"observation", "achieved_goal", "desired_goal"}
    assert all(observation[name].shape == part.shape for name, part in space.spaces.items())
    after, _, reward, *_ = env.step(jax.random.key(1), state, jnp.zeros(3), params)
    assert set(after) == set(observation)
    assert reward == -1


def test_observe_and_discount_are_those_of_the_state(made: tuple[Any, Any]) -> None:
    env, params = made
    key = jax.random.key(0)
    observation, state = env.reset(key, params)
    assert np.array_equal(env.observe(key, state, None, params), observation)
    assert env.discount(state, params) == 1
    assert not env.is_truncated(state, params)


def test_an_action_has_as_many_numbers_as_the_environment_says(made: tuple[Any, Any]) -> None:
    env, params = made
    _, state = env.reset(jax.random.key(0), params)
    assert env.action_space().shape == (env.num_actions,)
    for action in (0, np.zeros(env.num_actions + 1), np.zeros((2, env.num_actions))):
        with pytest.raises(InputError, match=r"action has shape .*, and this environment takes \(3,\)\."):
            env.step(jax.random.key(0), state, action, params)


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"sim": "mujoco"}, "gymnax needs an environment that JAX can trace, got simulator 'mujoco'.*sim='kinematic'"),
        ({"observation": "image"}, "got .* observation 'image': .* without a picture"),
        ({"task": "precise"}, "got simulator 'mujoco'"),
        ({"task": "tutoral"}, "task 'tutoral' is not one of: .*Did you mean 'tutorial'"),
        ({"max_step": 3}, "setting 'max_step' does not exist. Did you mean 'max_steps'"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as refused:
        reachlab.gymnax.make(**settings)
    assert "\n" not in str(refused.value)
