"""The Gymnasium faces, held against Gymnasium's own checker and its own vector environment."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
import warnings
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from params import tried
from pushes import pushes
from reachlab.envs.core import Env
from reachlab.envs.gymnasium_single import ReachEnv
from reachlab.envs.gymnasium_vector import ReachVectorEnv
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.render.offscreen import Camera
from reachlab.robots.loading import load_robot
from reachlab.settings.validation import InputError

NUM_ENVS = 3
SHORT: dict[str, Any] = {"max_steps": 40, "clip_actions": False, "success_distance": 0.4}
"""Episodes that end often and in every way."""

BAD_ACTIONS = {
    "nan": ([0.0, np.nan, 0.0], "environment 0.*nan.*index 1"),
    "beyond float32": ([1e300, 0.0, 0.0], "environment 0.*index 0"),
    "too short": ([0.0, 0.0], r"shape \(3,\)"),
    "scalar": (0.0, r"shape \(3,\)"),
    "none": (None, "action"),
    "words": (["up", "up", "left"], "numbers"),
    "ragged": ([[0.0], [0.0, 1.0], 0.0], "action"),
}


@pytest.fixture(scope="module")
def drawing() -> None:
    """Skips where nothing can be drawn."""
    try:
        Camera(load_robot("iiwa14"), 16, 16).close()
    except InputError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def single() -> ReachEnv:
    return ReachEnv()


@pytest.fixture(scope="module")
def twin() -> ReachEnv:
    return ReachEnv()


@pytest.fixture(scope="module")
def singles() -> list[ReachEnv]:
    return [ReachEnv(**SHORT) for _ in range(NUM_ENVS)]


# --- Gymnasium's checker, spaces and registration -------------------------------------------------


def test_gymnasiums_checker_finds_nothing_in_pictures_but_the_tutorials_box(drawing: None) -> None:
    del drawing
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(gymnasium.make("reachlab/Reach-v0", render_mode="rgb_array", disable_env_checker=True).unwrapped)
    (said,) = [str(warning.message) for warning in caught]
    assert "symmetric and normalized" in said


def test_settings_are_keywords_and_the_kuka_environment_is_the_tutorials() -> None:
    settings: dict[str, Any] = {"task": "tutorial", "observation": "target", "reward": "sparse"}
    for env in (
        gymnasium.make("reachlab/Reach-v0", max_steps=4, **settings),
        gymnasium.make("reachlab:reachlab/KukaReach-v0", max_steps=4),
    ):
        observations, actions = env.observation_space, env.action_space
        assert isinstance(observations, gymnasium.spaces.Box)
        assert isinstance(actions, gymnasium.spaces.Box)
        assert observations.low == pytest.approx((0.2, -0.3, -0.05))
        assert observations.high == pytest.approx((0.7, 0.3, 0.55))
        assert actions.low == pytest.approx((-0.4, -0.4, -0.6))
        assert actions.high == pytest.approx((0.4, 0.4, 0.3))
        assert observations.dtype == actions.dtype == np.float32
        env.reset(seed=0)
        steps = [env.step(np.array([0, 0, 0.3], np.float32)) for _ in range(4)]
        assert [truncated for *_, truncated, _ in steps] == [False, False, False, True]
        assert [float(reward) for _, reward, *_ in steps] == pytest.approx([0, 0, 0, -0.1]), "the sparse reward"
        env.close()


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"max_step": 3}, "setting 'max_step' does not exist. Did you mean 'max_steps'"),
        ({"robot": "iiwa"}, "robot 'iiwa' is not one of: .*iiwa14"),
        ({"task": "tutoral"}, "task 'tutoral' is not one of: .*Did you mean 'tutorial'"),
        ({"render_mode": "human"}, "render mode 'human' is not one of: rgb_array"),
        ({"max_steps": 0}, "max_steps must be at least 1 and at most 100000, got 0"),
        ({"clip_actions": "no"}, "clip_actions must be true or false, got 'no'"),
        ({"tool": "link_9"}, "link_9"),
    ],
)
@pytest.mark.parametrize("face", [ReachEnv, ReachVectorEnv])
def test_wrong_settings_are_refused_in_one_sentence(
    face: type[ReachEnv | ReachVectorEnv], settings: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence) as refused:
        face(**settings)
    assert "\n" not in str(refused.value)


# --- one episode at a time ------------------------------------------------------------------------


def test_equal_seeds_give_equal_episodes_and_later_resets_new_targets(single: ReachEnv) -> None:
    runs = []
    for _ in range(2):
        first, _ = single.reset(seed=3)
        step = single.step(np.array([0.1, 0.1, -0.5], np.float32))[0]
        runs.append([first, step, single.reset()[0], single.reset()[0]])
    for one, other in zip(*runs, strict=True):
        assert np.array_equal(one, other)
    starts = [runs[0][i][:2].tolist() for i in (0, 2, 3)]
    assert len({tuple(start) for start in starts}) == 3
    assert single.reset(seed=4)[0][:2].tolist() not in starts


def test_info_tells_distance_and_success(single: ReachEnv) -> None:
    observation, info = single.reset(seed=0)
    assert info["is_success"] is False
    assert info["distance"] == pytest.approx(np.linalg.norm(observation[:3] - observation[3:]), abs=1e-6)
    terminated, truncated, reward = False, False, 0.0
    while not (terminated or truncated):
        offset = (observation[:3] - observation[3:]) / 0.005
        observation, reward, terminated, truncated, info = single.step(np.clip(offset, -0.4, 0.4))
        assert info["distance"] == pytest.approx(np.linalg.norm(observation[:3] - observation[3:]), abs=1e-6)
    assert (terminated, truncated, info["is_success"]) == (True, False, True)
    assert reward > 1
    assert info["distance"] < 0.1


@pytest.mark.parametrize(("action", "sentence"), BAD_ACTIONS.values(), ids=BAD_ACTIONS)
def test_a_wrong_action_is_refused_and_nothing_moves(
    single: ReachEnv, twin: ReachEnv, action: Any, sentence: str
) -> None:
    for env in (single, twin):
        env.reset(seed=8)
    with pytest.raises(InputError, match=sentence) as refused:
        single.step(action)
    assert "\n" not in str(refused.value)
    good = np.array([0.1, -0.2, -0.3], np.float32)
    for one, other in zip(single.step(good)[:4], twin.step(good)[:4], strict=True):
        assert np.array_equal(one, other)


def test_observations_belong_to_the_caller(single: ReachEnv) -> None:
    first, _ = single.reset(seed=0)
    before = first.copy()
    second, *_ = single.step(np.array([0.4, 0.4, -0.6], np.float32))
    assert np.array_equal(first, before)
    first[:] = 0
    second[:] = 0
    assert single.step(np.zeros(3, np.float32))[0].any()
    assert single.render() is None, "without a render mode there is no picture"


def test_the_picture_shows_the_arm_move_in_whatever_thread(drawing: None) -> None:
    del drawing
    env = ReachEnv(render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    for _ in range(60):
        env.step(np.array([0.0, 0.0, -0.6], np.float32))
    after = env.render()
    assert isinstance(before, np.ndarray)
    assert isinstance(after, np.ndarray)
    assert before.dtype == np.uint8
    assert before.ndim == 3
    assert before.shape[2] == 3
    assert before.std() > 5, "a blank picture"
    assert (before != after).any(axis=-1).mean() > 0.005
    with ThreadPoolExecutor(1) as thread:
        assert np.array_equal(np.asarray(thread.submit(env.render).result()), after)
    assert np.array_equal(np.asarray(env.render()), after)
    env.close()


# --- batches --------------------------------------------------------------------------------------


def assert_same_info(ours: Mapping[str, Any], theirs: Mapping[str, Any], where: str) -> None:
    """Equal keys and masks, and equal values wherever the mask says that there is one."""
    assert set(ours) == set(theirs), where
    for name in theirs:
        if name.startswith("_"):
            assert np.array_equal(ours[name], theirs[name]), f"{where}: {name}"
        elif isinstance(theirs[name], dict):
            assert_same_info(ours[name], theirs[name], f"{where}: {name}")
        else:
            mask = theirs[f"_{name}"]
            for index in np.flatnonzero(mask):
                assert ours[name][index] == pytest.approx(theirs[name][index], abs=1e-4), f"{where}: {name} of {index}"
            if ours[name].dtype == object:
                assert [value is None for value in ours[name]] == (~mask).tolist(), f"{where}: {name}"


def assert_same_step(ours: tuple[Any, ...], theirs: tuple[Any, ...], where: str) -> None:
    """Two results of `step`, or of `reset`, that agree."""
    assert ours[0] == pytest.approx(theirs[0], abs=1e-4), where
    assert ours[0].dtype == theirs[0].dtype
    for one, other in zip(ours[1:-1], theirs[1:-1], strict=True):
        assert one == pytest.approx(other, abs=1e-3), where
        assert one.dtype == other.dtype, where
    assert_same_info(ours[-1], theirs[-1], where)


@pytest.mark.parametrize("mode", tried(AutoresetMode, [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP]))
def test_a_batch_is_gymnasiums_vector_of_single_environments(singles: list[ReachEnv], mode: AutoresetMode) -> None:
    theirs = SyncVectorEnv([lambda env=env: env for env in singles], autoreset_mode=mode)
    ours = gymnasium.make_vec("reachlab/Reach-v0", num_envs=NUM_ENVS, autoreset_mode=mode, **SHORT)
    assert ours.metadata["autoreset_mode"] is mode
    assert_same_step(ours.reset(seed=21), theirs.reset(seed=21), "reset")
    ends = {"terminated": 0, "truncated": 0, "success": 0}
    for number, actions in enumerate(pushes(NUM_ENVS, 300)):
        one, other = ours.step(actions), theirs.step(actions)
        assert_same_step(one, other, f"step {number}")
        done = one[2] | one[3]
        ends["terminated"] += int(one[2].sum())
        ends["truncated"] += int(one[3].sum())
        info = other[4]["final_info"] if "final_info" in other[4] else other[4]
        ends["success"] += int((info["is_success"] & done).sum())
        if mode is AutoresetMode.DISABLED and done.any():
            again = ours.reset(options={"reset_mask": done}), theirs.reset(options={"reset_mask": done})
            assert_same_step(*again, f"reset after step {number}")
    assert min(ends.values()) > 0, f"not every end occurred: {ends}"
    assert_same_step(ours.reset(), theirs.reset(), "the unseeded reset")
    ours.close()


BIT_FOR_BIT: dict[str, tuple[int, int, dict[str, Any]]] = {
    "tutorial": (NUM_ENVS, 300, SHORT),
    "precise": (NUM_ENVS, 70, {"task": "precise", "max_steps": 30}),
    "pybullet": (NUM_ENVS, 100, {"sim": "pybullet", **SHORT}),
}
"""Environments, steps and settings."""


@pytest.mark.parametrize("name", tried(BIT_FOR_BIT, ["tutorial", "precise"]))
@pytest.mark.parametrize("mode", tried(AutoresetMode, [AutoresetMode.SAME_STEP]))
@pytest.mark.compiled
def test_a_batch_gives_what_the_environment_gives_bit_for_bit(name: str, mode: AutoresetMode) -> None:
    num_envs, steps, settings = BIT_FOR_BIT[name]
    ours = ReachVectorEnv(num_envs=num_envs, autoreset_mode=mode, **settings)
    env = Env(configure(**({"task": "tutorial", "randomise": ()} | settings)), num_envs)
    step, reset = env.compile_whole(env.step), env.compile_whole(env.reset)
    state = env.compile_whole(env.init)(env_keys(7, num_envs))
    assert np.array_equal(ours.reset(seed=7)[0], env.observe_now(state))
    begun, ends, random = np.zeros(num_envs, bool), 0, np.random.default_rng(0)
    low, high = (2 * side for side in env.action_bounds)
    actions = np.zeros((num_envs, len(low)), np.float32)
    for number in range(steps):
        if number % 20 == 0:
            actions = random.uniform(low, high, (num_envs, len(low))).astype(np.float32)
        observation, *results, info = ours.step(actions)
        state, done = step(state, actions)
        seen, wanted = np.array(done.observation), [np.array(x) for x in (done.reward, done.terminated, done.truncated)]
        ended = np.array(done.done)
        ends += int(ended.sum())
        if mode is AutoresetMode.NEXT_STEP:
            anew, begun = begun, ended & ~begun
            wanted = [np.where(anew, 0, x) for x in wanted]
        else:
            anew = ended
        if anew.any():
            state = reset(state, anew)
            after = np.where(anew[:, None], env.observe_now(state), seen)
            if mode is AutoresetMode.SAME_STEP:
                assert np.array_equal(np.stack(info["final_obs"][anew]), seen[anew])
            if mode is AutoresetMode.DISABLED:
                assert np.array_equal(observation, seen)
                observation, _ = ours.reset(options={"reset_mask": anew})
            seen = after
        assert np.array_equal(observation, seen), f"step {number}"
        assert all(np.array_equal(one.astype(other.dtype), other) for one, other in zip(results, wanted, strict=True))
    assert ends > num_envs
    ours.close()


def test_jax_arrays_hold_the_same_numbers_and_go_to_pytorch_without_a_copy() -> None:
    torch = pytest.importorskip("torch")
    ours = ReachVectorEnv(num_envs=NUM_ENVS, arrays="jax", autoreset_mode="SameStep", **SHORT)
    theirs = ReachVectorEnv(num_envs=NUM_ENVS, autoreset_mode="SameStep", **SHORT)
    assert np.array_equal(ours.reset(seed=3)[0], theirs.reset(seed=3)[0])
    for actions in pushes(NUM_ENVS, 60):
        one, other = ours.step(torch.from_numpy(actions)), theirs.step(actions)
        assert all(isinstance(x, jax.Array) for x in (*one[:4], one[4]["distance"], one[4]["is_success"]))
        assert all(np.array_equal(x, np.asarray(y, x.dtype)) for x, y in zip(one[:4], other[:4], strict=True))
        assert torch.from_dlpack(one[0]).data_ptr() == one[0].unsafe_buffer_pointer()
        if "final_obs" in other[4]:
            ended = other[4]["_final_obs"]
            assert np.array_equal(np.asarray(one[4]["final_obs"])[ended], np.stack(other[4]["final_obs"][ended]))
    with pytest.raises(InputError, match="environment 1 is inf at index 2"):
        ours.step(torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, torch.inf], [0.0, 0.0, 0.0]]))
    with pytest.raises(InputError, match=r"shape \(3,\) in each of 3 environments, got \(3, 2\)"):
        ours.step(jnp.zeros((3, 2)))
    with pytest.raises(InputError, match="arrays 'torch' is not one of: jax, numpy"):
        ReachVectorEnv(arrays="torch")


@pytest.fixture(scope="module")
def batch() -> ReachVectorEnv:
    return ReachVectorEnv(num_envs=NUM_ENVS, autoreset_mode="Disabled", max_steps=5)


def test_a_step_before_the_first_reset_is_refused() -> None:
    for env in (ReachEnv(**SHORT), ReachVectorEnv(num_envs=NUM_ENVS, **SHORT)):
        with pytest.raises(InputError, match="call reset first"):
            env.step(np.zeros(env.action_space.shape or (), np.float32))


def test_environments_have_batched_spaces_and_take_seeds_of_their_own(batch: ReachVectorEnv) -> None:
    counted = batch.reset(seed=40)[0]
    assert counted in batch.observation_space
    assert batch.single_observation_space.shape == (6,)
    assert (batch.observation_space.shape, batch.action_space.shape) == ((NUM_ENVS, 6), (NUM_ENVS, 3))
    assert np.array_equal(batch.reset(seed=[40, 41, 42])[0], counted)
    mixed = batch.reset(seed=[42, None, 40])[0]
    assert mixed[0] == pytest.approx(counted[2])
    assert mixed[2] == pytest.approx(counted[0])
    assert mixed[1, :2].tolist() != counted[1, :2].tolist()
    with pytest.raises(InputError, match="seed must be one number or 3 of them, got 2"):
        batch.reset(seed=[1, 2])


def test_a_masked_reset_leaves_the_other_environments_alone(batch: ReachVectorEnv) -> None:
    batch.reset(seed=1)
    before = batch.step(np.full((NUM_ENVS, 3), 0.3, np.float32))[0]
    after, info = batch.reset(options={"reset_mask": np.array([False, True, False])})
    assert after[[0, 2]] == pytest.approx(before[[0, 2]], abs=1e-6)
    assert (after[1] != before[1]).any()
    assert info["_distance"].tolist() == [False, True, False]
    seeded, _ = batch.reset(seed=77, options={"reset_mask": np.array([False, True, False])})
    assert seeded[[0, 2]] == pytest.approx(before[[0, 2]], abs=1e-6)
    assert seeded[1] == pytest.approx(batch.reset(seed=77)[0][1])


@pytest.mark.parametrize("mask", [[True, False, True], np.array([1, 0, 1]), np.array([True, False])])
def test_a_misshapen_mask_and_an_option_that_a_batch_does_not_have_are_refused(
    batch: ReachVectorEnv, mask: Any
) -> None:
    batch.reset(seed=0)
    with pytest.raises(InputError, match=r"reset_mask.*bool array of \(3,\)"):
        batch.reset(options={"reset_mask": mask})
    with pytest.raises(InputError, match=r"option of reset 'target' is not one of: reset_mask\."):
        batch.reset(options={"target": [0.5, 0.0, 0.2]})


def test_without_autoreset_a_step_of_an_ended_episode_is_refused(batch: ReachVectorEnv) -> None:
    batch.reset(seed=0)
    still = np.zeros((NUM_ENVS, 3), np.float32)
    for _ in range(4):
        assert not batch.step(still)[3].any()
    assert batch.step(still)[3].all()
    with pytest.raises(InputError, match=r"environment 0 has ended.*reset_mask"):
        batch.step(still)
    batch.reset(options={"reset_mask": np.array([True, True, False])})
    with pytest.raises(InputError, match="environment 2 has ended"):
        batch.step(still)
    batch.reset(options={"reset_mask": np.array([False, False, True])})
    assert not batch.step(still)[3].any()


def test_a_wrong_action_names_its_environment_and_moves_none(batch: ReachVectorEnv) -> None:
    good = np.full((NUM_ENVS, 3), 0.2, np.float32)
    bad = good.copy()
    bad[2, 1] = np.nan
    batch.reset(seed=6)
    untouched = batch.step(good)
    batch.reset(seed=6)
    with pytest.raises(InputError, match="environment 2 is nan at index 1"):
        batch.step(bad)
    with pytest.raises(InputError, match=r"shape \(3,\) in each of 3 environments, got \(2, 3\)"):
        batch.step(good[:2])
    for one, other in zip(batch.step(good)[:4], untouched[:4], strict=True):
        assert np.array_equal(one, other)


def test_an_autoreset_mode_is_named_or_refused_and_so_is_a_batch_without_environments() -> None:
    named = ReachVectorEnv(num_envs=NUM_ENVS, autoreset_mode="SameStep", **SHORT)
    assert named.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    with pytest.raises(InputError, match=r"autoreset mode 'SamStep' is not one of: .*Did you mean 'SameStep'"):
        ReachVectorEnv(autoreset_mode="SamStep")


@pytest.mark.parametrize("count", [0, -1, 1.5, "3", 10**9, True])
def test_a_number_of_environments_that_cannot_be_is_refused(count: Any) -> None:
    with pytest.raises(InputError, match="num_envs must be a whole number from 1 to 131072, got"):
        ReachVectorEnv(num_envs=count)


@pytest.mark.parametrize("seed", [np.int64(40), np.array([40, 41, 42]), (40, 41, 42)], ids=repr)
def test_seeds_of_numpy_are_those_of_python(batch: ReachVectorEnv, seed: Any) -> None:
    counted = batch.reset(seed=40)[0]
    assert np.array_equal(batch.reset(seed=seed)[0], counted)


BAD_SEEDS: list[Any] = [-1, 2**32, 1.5, "3", True, np.float64(3), [1.5, 2, 3], np.array([1, 2, -3])]


@pytest.mark.parametrize("seed", BAD_SEEDS, ids=repr)
def test_what_is_no_seed_is_refused(single: ReachEnv, batch: ReachVectorEnv, seed: Any) -> None:
    for env in (single, batch):
        with pytest.raises(InputError, match="seed must be a whole number from 0 to 4294967295, got"):
            env.reset(seed=seed)


@pytest.mark.parametrize("options", [[1], "target", 3], ids=repr)
def test_options_that_are_no_dict_are_refused(single: ReachEnv, batch: ReachVectorEnv, options: Any) -> None:
    for env in (single, batch):
        with pytest.raises(InputError, match="options of reset must be a dict, got"):
            env.reset(options=options)


# --- threads, processes and copies ----------------------------------------------------------------

ASYNC = """
import gymnasium, warnings
if __name__ == "__main__":
    warnings.simplefilter("ignore")
    for sim in {sims}:
        envs = gymnasium.make_vec(
            "reachlab:reachlab/KukaReach-v0", num_envs=2, vectorization_mode="async", sim=sim, vector_kwargs={kwargs}
        )
        try:
            envs.reset(seed=0)
            print(sim, envs.step(envs.action_space.sample())[0].shape)
        except ValueError as error:
            print(sim, type(error).__name__, error)
        envs.close()
"""


@pytest.mark.slow
@pytest.mark.parametrize("context", ["fork", "spawn"])
def test_asynchronous_environments_work_or_are_refused_in_one_sentence(tmp_path: Path, context: str) -> None:
    sims = ("kinematic", "mujoco") if context == "fork" else ("kinematic",)
    (tmp_path / "script.py").write_text(ASYNC.format(sims=sims, kwargs={"context": context}))
    done = subprocess.run(
        [sys.executable, str(tmp_path / "script.py")], capture_output=True, text=True, timeout=240, check=True
    )
    lines = done.stdout.splitlines()
    assert len(lines) == len(sims), done.stderr
    for sim, line in zip(sims, lines, strict=True):
        if context == "fork":
            assert line.startswith(f"{sim} InputError JAX cannot compute in this process, a fork of one that uses it")
            assert "vector_kwargs={'context': 'spawn'}" in line
        else:
            assert line == f"{sim} (2, 3)"


FORK = """
import multiprocessing, warnings
import jax.numpy
from reachlab.envs.gymnasium_single import ReachEnv

def child():
    try:
        ReachEnv("tutorial")
    except ValueError as error:
        print(type(error).__name__, error)

warnings.simplefilter("ignore")
jax.numpy.ones(3).block_until_ready()
process = multiprocessing.get_context("fork").Process(target=child)
process.start()
process.join(60)
process.kill()
"""


@pytest.mark.slow
def test_a_fork_of_a_process_that_used_jax_for_something_else_is_refused_too(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(FORK)
    done = subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("InputError JAX cannot compute in this process, a fork of one"), done.stderr


def test_where_jax_computes_with_64_bits_environments_are_made_without_it() -> None:
    with jax.enable_x64(True):
        with pytest.raises(InputError, match=r"JAX is set to 64: .* within `with jax.enable_x64\(False\):`"):
            ReachEnv(**SHORT)
        with jax.enable_x64(False):
            env = ReachEnv(**SHORT)
            observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)


@pytest.mark.parametrize("sim", ["kinematic", "mujoco"])
def test_a_copy_continues_as_the_original_and_leaves_it_alone(sim: str) -> None:
    original = ReachEnv(sim=sim, **SHORT)
    original.reset(seed=3)
    push = np.array([0.3, -0.2, -0.5], np.float32)
    original.step(push)
    twin = copy.deepcopy(original)
    for _ in range(3):
        twin.step(-push)
    again = copy.deepcopy(original)
    for _ in range(3):
        one, other = original.step(push), again.step(push)
        assert np.array_equal(one[0], other[0])
        assert one[1:4] == other[1:4]


def test_a_copy_steps_a_simulator_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    original = ReachEnv(sim="mujoco", **SHORT)
    original.reset(seed=3)
    original.step(np.zeros(3, np.float32))
    twin = copy.deepcopy(original)
    taken = []
    for name, env in (("original", original), ("twin", twin)):
        simulator = env._episodes.env.simulator
        own = type(simulator).step

        def step(*given: Any, name: str = name, own: Any = own, simulator: Any = simulator) -> Any:
            taken.append(name)
            return own(simulator, *given)

        monkeypatch.setattr(simulator, "step", step)
    twin.step(np.zeros(3, np.float32))
    original.step(np.zeros(3, np.float32))
    assert taken == ["twin", "original"]


def test_a_closed_environment_takes_no_step_and_no_reset() -> None:
    for env in (ReachEnv(), ReachVectorEnv(num_envs=1)):
        env.close()
        for use in (lambda env=env: env.step(np.zeros((1, 3))), lambda env=env: env.reset(seed=1)):
            with pytest.raises(InputError, match="the environment is closed: make another"):
                use()
        env.close()


def test_an_environment_that_is_pickled_says_that_it_cannot_be(single: ReachEnv, batch: ReachVectorEnv) -> None:
    for env in (single, batch):
        with pytest.raises(InputError, match="an environment cannot be pickled: make another"):
            pickle.dumps(env)


def test_pybullet_refuses_to_be_copied_and_to_be_used_after_its_end() -> None:
    env = ReachEnv(sim="pybullet")
    env.reset(seed=0)
    with pytest.raises(InputError, match="'pybullet' cannot be copied"):
        copy.deepcopy(env)
    env.close()
    env.close()
    for use in (lambda: env.step(np.zeros(3, np.float32)), lambda: env.reset(seed=1)):
        with pytest.raises(InputError, match="the environment is closed: make another"):
            use()
