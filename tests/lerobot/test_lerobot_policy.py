"""Environments and exported policies under LeRobot's own evaluation; run by `make lerobot`."""

# pyright: reportMissingImports=false
from __future__ import annotations

import json
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.envs.factory import make_env
from lerobot.envs.utils import _call_make_env, _import_hub_module, _normalize_hub_result, close_envs
from lerobot.policies import get_policy_class, make_policy, make_pre_post_processors
from lerobot.processor import PolicyProcessorPipeline
from lerobot.scripts.lerobot_eval import eval_policy, rollout
from lerobot.utils.constants import OBS_ENV_STATE, OBS_STATE

import reachlab
from lerobot_policy_reachlab import ReachlabConfig, ReachlabEnv
from reachlab.envs.core import Env
from reachlab.envs.setup import in_evaluation
from reachlab.settings.json_form import override
from reachlab.settings.validation import InputError

EPISODES, TOGETHER, SEED = 200, 50, 5000
HUB = Path(__file__).parents[2] / "lerobot_policy_reachlab" / "env.py"

REST = [0.0, -11.0, -6.0, 78.0, 0.0, 50.0]
"""Where the motors are near home, in LeRobot's units."""


def parts(folder: Path) -> dict[str, Any]:
    """What LeRobot's rollouts take, made as `lerobot-eval` makes it."""
    env_config, config = ReachlabEnv(task=str(folder)), ReachlabConfig(export=str(folder))
    before, after = make_pre_post_processors(config)
    return {
        "env": make_env(env_config, n_envs=TOGETHER)["reachlab"][0],
        "policy": make_policy(config, env_cfg=env_config),
        "env_preprocessor": PolicyProcessorPipeline(steps=[]),
        "env_postprocessor": PolicyProcessorPipeline(steps=[]),
        "preprocessor": before,
        "postprocessor": after,
    }


def saved(folder: Path, out: Path) -> Path:
    """A folder with an exported policy as LeRobot saves it."""
    policy = get_policy_class("reachlab")(ReachlabConfig(export=str(folder)))
    policy.save_pretrained(out)
    for steps in make_pre_post_processors(policy.config):
        steps.save_pretrained(out)
    return out


def test_success_is_that_of_reachlabs_own_evaluation(exported: Path) -> None:
    made = parts(exported)
    with closing(made["env"]), torch.inference_mode():
        found = eval_policy(**made, n_episodes=EPISODES, start_seed=SEED)["aggregated"]["pc_success"] / 100
    loaded = reachlab.load("so101/precise")
    # Its controller keeps the limits of acceleration and jerk, as an environment with `shaping` does.
    config = override(in_evaluation(loaded.config, loaded.config.sim), shaping=True)
    with closing(Env(config, TOGETHER)) as env:
        report = reachlab.evaluate(env, "trained", loaded.policy, seed=SEED, episodes=EPISODES)
    low, high = report.success_interval
    assert low <= found <= high
    assert low > 0.9


def test_success_is_told_at_the_end_of_an_episode_alone(exported: Path) -> None:
    made = parts(exported)
    with closing(made["env"]):
        played = rollout(**made, seeds=list(range(TOGETHER)))
    ends = played["done"].int().argmax(dim=1)
    assert played["success"].any()
    for success, end in zip(played["success"], ends, strict=True):
        assert not success[:end].any()


def test_a_policy_that_does_nothing_fails(exported: Path) -> None:
    made = parts(exported)
    made["policy"].select_action = lambda batch: batch[OBS_STATE]
    with closing(made["env"]), torch.inference_mode():
        assert eval_policy(**made, n_episodes=TOGETHER, start_seed=SEED)["aggregated"]["pc_success"] < 10


def test_what_lerobot_saves_acts_as_before(exported: Path, tmp_path: Path) -> None:
    policy, folder = get_policy_class("reachlab")(ReachlabConfig(export=str(exported))), saved(exported, tmp_path / "s")
    assert str(exported) not in (folder / "config.json").read_text()
    config = PreTrainedConfig.from_pretrained(folder)
    config.pretrained_path = folder
    other, asked = make_policy(config, env_cfg=ReachlabEnv(task=str(exported))), [[0.25, 0.05, 0.15], [0.25, -0.1, 0.1]]
    state, batch = torch.tensor([REST] * 2), {OBS_ENV_STATE: torch.tensor(asked)}
    for _ in range(5):
        batch[OBS_STATE] = state
        state = policy.select_action(batch)
        assert torch.equal(state, other.select_action(batch))
    assert not torch.equal(state[0], state[1])
    before, after = make_pre_post_processors(config, pretrained_path=str(folder))
    assert torch.equal(before(dict(batch))[OBS_STATE], batch[OBS_STATE])
    assert torch.equal(after(state), state)


@pytest.mark.parametrize("is_saved", [False, True])
def test_the_command_of_lerobot_evaluates_it(exported: Path, tmp_path: Path, is_saved: bool) -> None:
    policy = ["--policy.type=reachlab", f"--policy.export={exported}"]
    if is_saved:
        policy = [f"--policy.path={saved(exported, tmp_path / 'saved')}"]
    words = [f"--env.task={exported}", "--env.settings={max_steps: 70}", f"--output_dir={tmp_path / 'out'}"]
    words += ["--eval.n_episodes=1", "--eval.batch_size=1"]  # each picture of its film takes time
    command = [str(Path(sys.executable).with_name("lerobot-eval")), "--env.type=reachlab", *policy, *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    told = json.loads((tmp_path / "out" / "eval_info.json").read_text())
    assert told["overall"]["n_episodes"] == 1
    assert told["overall"]["pc_success"] == 100.0
    assert len(list((tmp_path / "out" / "videos").rglob("*.mp4"))) == 1


def test_a_repository_of_the_hub_gives_pictures() -> None:
    module = _import_hub_module(str(HUB), "someone/reachlab")
    made = _normalize_hub_result(_call_make_env(module, n_envs=2, use_async_envs=True, cfg=None))
    ((env,),) = (group.values() for group in made.values())
    seen, _ = env.reset(seed=[3, 4])
    assert env.observation_space.contains(seen)
    assert np.ptp(seen["pixels"]["front"][0]) > 100
    assert (seen["pixels"]["front"][0] != seen["pixels"]["front"][1]).any()
    close_envs(made)


def test_what_does_not_fit_is_refused_in_a_sentence(exported: Path) -> None:
    policy = get_policy_class("reachlab")(ReachlabConfig(export=str(exported)))
    with pytest.raises(InputError, match="policy and environment have 6 and 7 motors"):
        policy.select_action({OBS_STATE: torch.zeros(1, 7), OBS_ENV_STATE: torch.zeros(1, 3)})
    with pytest.raises(InputError, match="asks for other goals"):
        policy.select_action({OBS_STATE: torch.zeros(1, 6), OBS_ENV_STATE: torch.zeros(1, 7)})
    with pytest.raises(InputError, match="not by LeRobot"):
        policy({})
    with pytest.raises(InputError, match=r"--policy\.export=FOLDER"):
        get_policy_class("reachlab")(ReachlabConfig())
    with pytest.raises(InputError, match="download it first"):
        get_policy_class("reachlab").from_pretrained("someone/reachlab")
    with pytest.raises(InputError, match="task 'precis' is not one of"):
        ReachlabEnv(task="precis")


def test_a_goal_out_of_reach_is_told_once(exported: Path, caplog: pytest.LogCaptureFixture) -> None:
    policy = get_policy_class("reachlab")(ReachlabConfig(export=str(exported)))
    for _ in range(3):
        policy.select_action({OBS_STATE: torch.tensor([REST]), OBS_ENV_STATE: torch.full((1, 3), 2.0)})
    (message,) = (record.message for record in caplog.records if "workspace" in record.message)
    assert "the goal [2, 2, 2] is out of the workspace" in message
