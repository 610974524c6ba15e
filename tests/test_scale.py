"""More than one process: rollouts by Ray workers, and sweeps."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from reachlab.cli.main import main
from reachlab.cli.sweep_command import SweepDisplay
from reachlab.envs.presets import configure
from reachlab.learn.checkpointing import UnwritableError
from reachlab.learn.interrupts import Interrupted
from reachlab.learn.train import train
from reachlab.robots.loading import load_robot
from reachlab.runs.directory import RunDirectory, read_config
from reachlab.runs.files import write_json
from reachlab.scale.cluster import Cluster
from reachlab.scale.engines import LocalEngine, RayEngine, heard
from reachlab.scale.goals import GOALS, check_goal
from reachlab.scale.rollouts import RayRollouts, divide
from reachlab.scale.space import dimensions, read_space
from reachlab.scale.study import Study
from reachlab.scale.sweep import SweepProgress, sweep
from reachlab.scale.training import failure_file, read_validations
from reachlab.scale.trials import DEATHS, SweepConfig, Trials, _check_of, pessimistic
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import to_json
from reachlab.settings.validation import InputError, installing

pytestmark = pytest.mark.slow

TINY: dict[str, Any] = {
    "num_envs": 16,
    "rollout_steps": 16,
    "total_steps": 20 * 256,
    "hidden": (8,),
    "stop_early": False,
    "report_episodes": 16,
    "max_steps": 30,
}
"""A training of a moment."""

SPACE = {"learning_rate": {"low": 1e-4, "high": 1e-2, "log": True}, "epochs": {"low": 1, "high": 4}}


def newest_weights(out: Path) -> bytes:
    return max(out.glob("checkpoints/step_*/state.safetensors")).read_bytes()


# --- rollouts -------------------------------------------------------------------------------------


@pytest.mark.parametrize("num_envs", [16, 100, 256, 1000])
@pytest.mark.parametrize("workers", [1, 2, 3, 7])
def test_every_environment_has_one_worker_and_parts_begin_at_whole_blocks(num_envs: int, workers: int) -> None:
    if workers * 16 > num_envs + 15:
        with pytest.raises(InputError, match=r"workers must be at least 1 and at most \d+"):
            divide(num_envs, workers)
        return
    shares = divide(num_envs, workers)
    assert len(shares) == workers
    assert [env for share in shares for env in share] == list(range(num_envs))
    assert all(share.start % 16 == 0 for share in shares)
    sizes = list(map(len, shares))
    assert max(sizes) - min(sizes) <= 16


def test_no_worker_is_refused() -> None:
    with pytest.raises(InputError, match="at least 1"):
        divide(64, 0)
    assert divide(64, 1) == [range(64)]


@pytest.fixture(scope="module")
def ray() -> Iterator[Any]:
    cluster = Cluster(None, 2)  # one for all tests: whoever finds it leaves it as it is
    yield cluster.ray
    cluster.close()


SHORT: dict[str, Any] = {"rollout_steps": 8, "report_episodes": 16, "minibatches": 2, "max_steps": 12}
ELSEWHERE = {
    "mujoco": (configure("precise", **SHORT, num_envs=40, total_steps=4 * 320), 2),
    # A process of its own holds no more than 16 of them.
    "pybullet": (configure(sim="pybullet", **SHORT, num_envs=16, total_steps=4 * 128, stop_early=False), 1),
}


@pytest.mark.parametrize("sim", ELSEWHERE)
def test_workers_learn_the_weights_of_one_process_also_if_one_is_killed(sim: str, tmp_path: Path, ray: Any) -> None:
    config, workers = ELSEWHERE[sim]
    train(config, tmp_path / "alone")
    iterations = 0
    with RayRollouts(config, workers) as collect:

        def watch(_: object) -> None:
            nonlocal iterations
            iterations += 1
            if iterations == 2:
                ray.kill(collect._workers[-1])

        train(config, tmp_path / "shared", watch, collect=collect)
        assert collect.lost == 1
        assert iterations == 4
    assert newest_weights(tmp_path / "alone") == newest_weights(tmp_path / "shared")


def test_more_workers_than_cpus_are_refused(ray: Any) -> None:
    assert ray.cluster_resources()["CPU"] == 2
    with pytest.raises(InputError, match="Ray has 2 CPUs, and each of 3 workers needs one"):
        RayRollouts(configure("precise"), 3)


def test_a_simulator_that_is_compiled_is_not_shared(tmp_path: Path, ray: Any) -> None:
    del ray
    with (
        RayRollouts(configure(**TINY), 1) as collect,
        pytest.raises(InputError, match="use --sim mujoco or pybullet"),
    ):
        train(configure(**TINY), tmp_path / "run", collect=collect)


# --- space and goals ------------------------------------------------------------------------------


def test_a_space_is_read(tmp_path: Path) -> None:
    file = tmp_path / "space.toml"
    file.write_text(
        "[space]\nlearning_rate = { low = 1e-5, high = 3e-3, log = true }\nepochs = { low = 2, high = 10 }\n"
        "hidden = [[64, 64], [128, 128]]\nreward = ['sparse', 'dense']\n"
    )
    rate, epochs, hidden, reward = dimensions(read_space(file, RunConfig()), RunConfig())
    assert (rate.low, rate.high, rate.log, rate.whole) == (1e-5, 3e-3, True, False)
    assert (epochs.low, epochs.high, epochs.log, epochs.whole) == (2, 10, False, True)
    assert hidden.choices == ((64, 64), (128, 128))
    assert reward.choices == ("sparse", "dense")


@pytest.mark.parametrize(
    ("said", "refused"),
    [
        ("", r"must hold the table \[space\] alone"),
        ("space = 3", r"must hold the table \[space\] alone"),
        ("[space]", r"must hold the table \[space\] alone"),
        ("[space]\nepochs = [2, 3]\n[more]\na = 1", r"must hold the table \[space\] alone"),
        ("[space", "is no TOML file"),
        ("[space]\nlearning_rat = [1e-3, 1e-4]", "Did you mean 'learning_rate'"),
        ("[space]\nepochs = { low = 0, high = 3 }", "epochs must be at least 1"),
        ("[space]\ngamma = { low = 0.9, high = 1.5 }", "gamma must be"),
        ("[space]\nepochs = { low = 3, high = 2 }", "a low below its high"),
        ("[space]\nentropy_weight = { low = 0.0, high = 1.0, log = true }", "a low above 0 below its high"),
        ("[space]\nepochs = { low = 1, high = 3, steps = 2 }", "limits or a list of choices"),
        ("[space]\nepochs = 3", "limits or a list of choices"),
        ("[space]\nepochs = [3]", "fewer than two choices"),
        ("[space]\nhidden = { low = [8], high = [16] }", "as its values are no numbers"),
        ("[space]\nseed = [1, 2]", "with --seeds"),
        ("[space]\nrobot = ['panda', 'nosuch']", "robot 'nosuch' is not one of"),
        ("[space]\nreward = ['dense', 'spars']", "Did you mean 'sparse'"),
        ("[space]\ntask = ['tutorial', 'precise']", "sweep each of them by itself"),
        ("[space]\ncloseness_weight = [1.0, 2.0]", "has an effect only with reward precise or closeness"),
        ("[space]\nhidden = [[[1, 2], [3]], [64, 64]]", "hidden must be"),
        ("[space]\nlearning_rate = [1e-3, {a = 1}]", "learning_rate must be"),
        ("a = " + 5000 * "[", "nests lists or tables too deep"),
        (f"[space]\n#{2**20 * ' '}", "larger than 1 MB"),
    ],
)
def test_a_space_that_makes_no_sense_is_refused(said: str, refused: str, tmp_path: Path) -> None:
    file = tmp_path / "space.toml"
    file.write_text(said)
    with pytest.raises(InputError, match=refused):
        read_space(file, RunConfig())


def test_a_space_that_is_missing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_space(tmp_path / "space.toml", RunConfig())


def test_goals_read_a_result_and_the_worst_stands_for_what_is_missing() -> None:
    result = {"success_rate": 0.5, "final_error_mm": {"median": None, "p95": 2.5}, "steps": 700, "validated": True}
    assert GOALS["success_rate"].of(result) == 0.5
    assert GOALS["final_error_mm.median"].of(result) == float("inf")
    assert GOALS["final_error_mm.p95"].of(result) == 2.5
    assert GOALS["steps"].of(result) == 700
    assert GOALS["steps"].of(result | {"validated": False}) == float("inf")
    assert GOALS["steps"].of({"success_rate": 0.5}) is None, "of a report on the way"


@pytest.mark.parametrize(
    ("goal", "task", "refused"),
    [
        ("succes_rate", "tutorial", "Did you mean 'success_rate'"),
        ("success_within.1", "tutorial", "a task that does not end at the target"),
        ("final_angle_rad.median", "precise", "a goal with an orientation"),
        ("tracking.rms_mm", "precise", "a goal that moves"),
        ("steps", "precise", "ends once its validations suffice"),
    ],
)
def test_a_goal_that_trainings_do_not_have_is_refused(goal: str, task: str, refused: str) -> None:
    with pytest.raises(InputError, match=refused):
        check_goal(goal, configure(task))


# --- studies --------------------------------------------------------------------------------------


def make_study(folder: Path, config: RunConfig | None = None) -> Study:
    used = config or configure()
    return Study(folder / "journal", dimensions(SPACE, used), GOALS["success_rate"], used)


def test_the_first_trial_is_the_settings_themselves_where_the_space_holds_them(tmp_path: Path) -> None:
    inside = configure(learning_rate=2e-3, epochs=3)
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    study = make_study(tmp_path / "in", inside)
    assert study.settings(study.ask(20)) == {"learning_rate": 2e-3, "epochs": 3}
    study = make_study(tmp_path / "out", configure(epochs=8))
    assert study.settings(study.ask(20))["epochs"] <= 4


def test_a_study_continues_as_if_its_process_had_not_died(tmp_path: Path) -> None:
    (tmp_path / "whole").mkdir()
    (tmp_path / "cut").mkdir()
    whole = make_study(tmp_path / "whole")
    for value in (0.1, 0.4, 0.2):
        whole.end(whole.ask(20), value)
    for value in (0.1, 0.4, 0.2):
        study = make_study(tmp_path / "cut")
        settings = study.settings(study.ask(20))
        with (tmp_path / "cut" / "journal").open("ab") as journal:
            journal.write(b'{"op_code": 5, "wor')  # its process dies while it writes
        again = make_study(tmp_path / "cut")
        (trial,) = again.begun()
        assert again.settings(trial) == settings
        again.end(trial, value)
    assert make_study(tmp_path / "cut").trials == whole.trials
    assert [trial.value for trial in whole.ranked] == [0.4, 0.2, 0.1]


def test_a_study_of_another_goal_or_space_is_refused(tmp_path: Path) -> None:
    used, journal = configure(), tmp_path / "journal"
    make_study(tmp_path)
    for goal, space, what in (("final_error_mm.median", SPACE, "goal"), ("success_rate", {"epochs": [1, 2]}, "space")):
        with pytest.raises(InputError, match=f"was begun with another {what}, .*: begin a new sweep"):
            Study(journal, dimensions(space, used), GOALS[goal], used)
    with journal.open("ab") as file:
        file.write(b'{"op_code": 99}\n')
    with pytest.raises(InputError, match="cannot be used"):
        make_study(tmp_path)


def test_a_training_with_other_settings_is_not_a_trials(tmp_path: Path) -> None:
    run = RunDirectory(tmp_path / "0000")
    run.create(configure())
    _check_of(run, configure(), ["gamma"])
    with pytest.raises(InputError, match=r"was trained with gamma 0\.\d+, and not 0\.8: remove it"):
        _check_of(run, configure(gamma=0.8), ["gamma"])


def test_a_goal_that_was_not_reached_is_no_value_and_never_the_best(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = Study(tmp_path / "journal", dimensions(SPACE, configure()), GOALS["steps"], configure())
    study.end(study.ask(20), float("inf"))
    assert (study.trials[0].state, study.trials[0].value, study.ranked) == ("complete", None, [])
    SweepDisplay("steps")(SweepProgress(study.trials, 1, {}, None))
    assert "  steps not reached\n" in capsys.readouterr().err


def test_several_seeds_count_as_the_poorer_end_of_the_interval_of_their_mean() -> None:
    assert pessimistic([0.5], maximise=True) == 0.5
    half = 12.706 * 0.1  # Student's t of one degree of freedom, and the standard error of the mean
    assert pessimistic([0.4, 0.6], maximise=True) == pytest.approx(0.5 - half, rel=1e-4)
    assert pessimistic([0.4, 0.6], maximise=False) == pytest.approx(0.5 + half, rel=1e-4)
    assert pessimistic([0.4, float("inf")], maximise=False) == float("inf")


# --- sweeps ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sweep") / "sweep"
    seen: list[SweepProgress] = []
    result = sweep(configure(**TINY), SweepConfig(SPACE, seeds=2, trials=2), out, seen.append, workers=2)
    assert len(result.trials) == 2
    assert seen[-1].total == 2
    assert {len(one.running) for one in seen} <= {0, 1, 2}
    assert result.config == read_config(out / "best.json")
    return out


def rows_of(out: Path) -> list[dict[str, str]]:
    with (out / "trials.csv").open() as file:
        return list(csv.DictReader(file))


def test_a_sweep_leaves_a_run_for_every_seed_of_every_trial_and_a_table(swept: Path) -> None:
    rows = rows_of(swept)
    assert [row["trial"] for row in rows] == ["0", "1"]
    assert {row["state"] for row in rows} == {"complete"}
    for row in rows:
        for seed in (0, 1):
            config = RunDirectory(swept / "trials" / f"{int(row['trial']):04}-{seed}").read_config()
            assert config.seed == seed
            assert config.ppo.epochs == int(row["epochs"])
            assert config.learner.learning_rate == pytest.approx(float(row["learning_rate"]))
    best = max(rows, key=lambda row: float(row["success_rate"]))
    assert read_config(swept / "best.json").ppo.epochs == int(best["epochs"])
    assert (swept / "history.png").stat().st_size > 5000


def test_a_sweep_goes_on_with_more_trials_and_leaves_the_others_as_they_were(
    swept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: newest_weights(path) for path in (swept / "trials").iterdir() if path.is_dir()}
    assert main(["sweep", "--resume", str(swept), "--trials", "3", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["trials"]) == 3
    after = {path: newest_weights(path) for path in (swept / "trials").iterdir() if path.is_dir()}
    assert len(after) == 6
    assert before == {path: weights for path, weights in after.items() if path in before}
    assert main(["sweep", "--resume", str(swept), "--trials", "1"]) == 0
    assert "trial 2 of 3" in capsys.readouterr().err


def test_the_best_settings_are_trained_with_and_flags_change_them(swept: Path, tmp_path: Path) -> None:
    flags = ["--config", str(swept / "best.json"), "--total-steps", "256", "--out", str(tmp_path / "run")]
    assert main(["train", *flags]) == 0
    trained, best = RunDirectory(tmp_path / "run").read_config(), read_config(swept / "best.json")
    assert (trained.ppo, trained.learner) == (best.ppo, best.learner)
    assert trained.loop.total_steps == 256
    assert main(["train", "--config", str(tmp_path / "run" / "config.json"), "--out", str(tmp_path / "again")]) == 0
    assert newest_weights(tmp_path / "run") == newest_weights(tmp_path / "again")


def test_a_trial_with_settings_that_contradict_each_other_fails_with_the_sentence(tmp_path: Path) -> None:
    space = {"minibatches": [3, 5]}
    result = sweep(configure(**TINY), SweepConfig(space, trials=2), tmp_path / "sweep")
    assert result.config is None
    assert [trial.state for trial in result.trials] == ["fail", "fail"]
    assert all("cannot be divided among" in trial.why for trial in result.trials)


@pytest.mark.parametrize(("trials", "tried"), [(3, 3), (20, 6)])
def test_settings_that_can_be_counted_are_tried_once_each(
    trials: int, tried: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def done(_: Trials, trial: Any, path: Path, *__: Any) -> Iterator[None]:
        path.mkdir(parents=True)
        write_json(RunDirectory(path).report_file, {"success_rate": 1 / (1 + trial.number)})
        yield

    monkeypatch.setattr(Trials, "_train", done)
    monkeypatch.setattr("reachlab.scale.sweep.LOOK", 0.0)
    space = {"epochs": {"low": 2, "high": 4}, "gamma": [0.9, 0.95]}
    seen: list[SweepProgress] = []
    result = sweep(configure(**TINY), SweepConfig(space, trials=trials), tmp_path / "sweep", seen.append, workers=2)
    assert len({str(trial.settings) for trial in result.trials}) == len(result.trials) == tried
    assert seen[-1].total == tried


def test_a_sweep_whose_trials_all_fail_is_no_success(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "space.toml").write_text("[space]\nminibatches = [3, 5]")
    words = ["sweep", str(tmp_path / "space.toml"), "--out", str(tmp_path / "out"), "--num-envs", "16", "--trials", "2"]
    assert main([*words, "--minibatches", "4"]) == 2
    assert "every trial failed" in capsys.readouterr().err


def wait_for(found: Any, seconds: float = 60.0) -> None:
    until = time.monotonic() + seconds
    while not found():
        assert time.monotonic() < until
        time.sleep(0.05)


LONG = configure(**TINY | {"total_steps": 10_000 * 256, "checkpoint_interval": 0.1})


def order(path: Path, config: RunConfig, validations: int = 0) -> tuple[Any, ...]:
    return str(path), to_json(config), "success_rate", validations


def test_a_training_that_is_asked_to_end_is_saved(tmp_path: Path) -> None:
    engine, path = LocalEngine(1), tmp_path / "0000-0"
    training = engine.start(*order(path, LONG, 2000))
    wait_for(lambda: len(read_validations(path)) > 1)
    engine.stop(training)
    wait_for(lambda: not engine.running(training))
    assert not RunDirectory(path).finished
    validated = max(read_validations(path)) * LONG.loop.total_steps // 2001
    assert validated <= RunDirectory(path).checkpoint_steps()[-1] < LONG.loop.total_steps


def test_trainings_end_with_their_engine(tmp_path: Path) -> None:
    engine, path = LocalEngine(1), tmp_path / "0000-0"
    training = engine.start(*order(path, LONG))
    wait_for((path / "checkpoints").exists)
    assert engine.running(training)
    engine.close()
    assert training.poll() is not None


def test_validations_are_at_equal_distances_also_of_a_training_that_is_killed(tmp_path: Path) -> None:
    config = configure(**TINY | {"total_steps": 400 * 256, "checkpoint_interval": 0.01})
    engine, path = LocalEngine(1), tmp_path / "0000-0"
    training = engine.start(*order(path, config, 3))
    wait_for(lambda: len(read_validations(path)) > 1)
    os.kill(training.pid, signal.SIGKILL)
    wait_for(lambda: not engine.running(training))
    assert not RunDirectory(path).finished
    training = engine.start(*order(path, config, 3))
    wait_for(lambda: not engine.running(training))
    assert RunDirectory(path).finished
    assert list(read_validations(path)) == [1, 2, 3]


def test_a_failure_of_the_training_itself_is_written_down(tmp_path: Path) -> None:
    engine, path = LocalEngine(1), tmp_path / "0000-0"
    training = engine.start(*order(path, configure(**TINY, robot=str(tmp_path / "missing.urdf"))))
    wait_for(lambda: not engine.running(training))
    assert "missing.urdf" in json.loads(failure_file(path).read_text())["error"]


class Dying:
    """An engine whose processes die at once, each trial's after a poorer validation, and some after their report."""

    def __init__(self, finished: int) -> None:
        self._finished, self.started, self.stopped = finished, list[str](), list[str]()

    def start(self, *order: Any) -> str:
        path = Path(order[0])
        path.mkdir(parents=True, exist_ok=True)
        number = int(path.name.partition("-")[0])
        write_json(path.with_suffix(".json"), [[100, 1.0 - number / 10]])
        if number < self._finished:
            write_json(path / "report.json", {"success_rate": 1.0 - number / 10})
        self.started.append(path.name)
        return path.name

    def running(self, training: str) -> bool:
        del training
        return False

    def stop(self, training: str) -> None:
        self.stopped.append(training)

    def close(self) -> None:
        pass


def run_trials(folder: Path, total: int, engine: Dying) -> Study:
    study = make_study(folder)
    trials = Trials(SweepConfig(SPACE), configure(**TINY), folder / "trials", study, engine)
    while trials.advance(total, 1):
        pass
    return study


def test_a_poor_trial_is_given_up_also_if_its_process_has_died(tmp_path: Path) -> None:
    engine = Dying(finished=5)
    study = run_trials(tmp_path, 6, engine)
    assert [trial.state for trial in study.trials] == ["complete"] * 5 + ["pruned"]
    assert engine.stopped == ["0005-0"]


def test_a_training_whose_process_dies_is_continued_but_not_for_ever(tmp_path: Path) -> None:
    engine = Dying(finished=0)
    (trial,) = run_trials(tmp_path, 1, engine).trials
    assert (trial.state, engine.started) == ("fail", ["0000-0"] * DEATHS)
    assert f"its process died {DEATHS} times without a newer checkpoint" in trial.why


class Full(Dying):
    """One of which the first training's report cannot be written."""

    def start(self, *order: Any) -> str:
        write_json(failure_file(Path(order[0])), {"error": "no", "lost": "the report cannot be written"})
        return Path(order[0]).name


def test_a_sweep_that_cannot_save_a_training_goes_on_with_it_when_there_is_room(tmp_path: Path) -> None:
    (tmp_path / "trials").mkdir()
    with pytest.raises(
        UnwritableError, match=r"the report cannot be written: make room there.*`reachlab sweep --resume"
    ):
        run_trials(tmp_path, 1, Full(finished=0))
    study = run_trials(tmp_path, 1, Dying(finished=1))
    assert [trial.state for trial in study.trials] == ["complete"]


@pytest.mark.parametrize("seed", [4295, 2**31 - 1])
def test_a_study_takes_any_seed(seed: int, tmp_path: Path) -> None:
    study = make_study(tmp_path, configure(seed=seed))
    assert study.settings(study.ask(20))
    assert study.settings(study.ask(20))


def test_a_robot_file_of_a_space_is_known_by_its_absolute_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = load_robot("ur5e").model.file
    shutil.copytree(file.parent, tmp_path / "arm")
    monkeypatch.chdir(tmp_path)
    (dimension,) = dimensions({"robot": ["iiwa14", f"arm/{file.name}"]}, configure())
    assert dimension.choices == ("iiwa14", str(tmp_path / "arm" / file.name))


def test_an_interrupted_sweep_says_how_it_continues(tmp_path: Path) -> None:
    def interrupt(progress: SweepProgress) -> None:
        if progress.running:
            signal.raise_signal(signal.SIGTERM)

    with pytest.raises(Interrupted, match=r"reachlab sweep --resume .*sweep` continues from there"):
        sweep(configure(**TINY), SweepConfig(SPACE, trials=2), tmp_path / "sweep", interrupt)
    assert len(sweep(configure(**TINY), SweepConfig(SPACE, trials=2), tmp_path / "sweep", resume=True).trials) == 2


@pytest.mark.parametrize(
    ("words", "refused"),
    [
        ("--validations 3", "with validations 7 and"),
        ("--seeds 3", "with seeds 1 and"),
        ("--goal time_to_reach_s", "with goal"),
    ],
)
def test_a_sweep_is_resumed_with_its_own_settings(words: str, refused: str, tmp_path: Path, capsys: Any) -> None:
    config = configure(**TINY)
    RunDirectory(tmp_path / "sweep").create(config)
    write_json(tmp_path / "sweep" / "sweep.json", vars(SweepConfig(SPACE, trials=2)))
    assert main(["sweep", "--resume", str(tmp_path / "sweep"), *words.split()]) == 2
    assert f"was begun {refused}" in capsys.readouterr().err


@pytest.mark.parametrize(("words", "trials"), [([], 2), (["--trials", "9"], 9)])
def test_a_sweep_is_resumed_with_its_own_trials_or_others(
    words: list[str], trials: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def stopped(_: Any, settings: SweepConfig, *__: Any, **___: Any) -> None:
        asked.append(settings)
        raise InputError("far enough")

    monkeypatch.setattr("reachlab.scale.sweep.sweep", stopped)
    RunDirectory(tmp_path / "sweep").create(configure(**TINY))
    write_json(tmp_path / "sweep" / "sweep.json", vars(SweepConfig(SPACE, seeds=3, trials=2)))
    assert main(["sweep", "--resume", str(tmp_path / "sweep"), *words]) == 2
    assert [(one.trials, one.seeds) for one in asked] == [(trials, 3)]


def test_a_training_that_ray_cancels_where_it_notes_no_signals_has_ended(tmp_path: Path, ray: Any) -> None:
    begun = tmp_path / "begun"

    def training() -> None:
        begun.touch()
        while True:
            time.sleep(0.05)

    def in_the_background() -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a shell's script begins it
        heard(training)()

    engine = RayEngine(1)
    engine._run = ray.remote(max_retries=0)(in_the_background)
    order = engine.start()
    while not begun.exists():
        time.sleep(0.05)
    engine.stop(order)
    until = time.monotonic() + 60
    while engine.running(order):
        assert time.monotonic() < until
        time.sleep(0.05)
    assert not engine._tasks
    engine.close()


def test_trials_on_ray_are_those_of_processes(swept: Path, tmp_path: Path, ray: Any) -> None:
    del ray
    config, settings = configure(**TINY), SweepConfig(SPACE, seeds=1, trials=1)
    sweep(config, settings, tmp_path / "sweep", engine="ray")
    assert newest_weights(tmp_path / "sweep" / "trials" / "0000-0") == newest_weights(swept / "trials" / "0000-0")


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "refused"),
    [
        (["sweep"], "sweep needs a space"),
        (["sweep", "missing.toml"], "space 'missing.toml' cannot be read"),
        (["sweep", "--resume", "{folder}"], "is no sweep: begin one with `reachlab sweep SPACE --out"),
        (["sweep", "{space}", "--engine", "slurm"], "engine 'slurm' is not one of: local, ray"),
        (["sweep", "{space}", "--address", "127.0.0.1:1"], "use --engine ray"),
        (["sweep", "{space}", "--goal", "sucess_rate"], "Did you mean 'success_rate'"),
        (["sweep", "{space}", "--out", "{folder}"], "exists and is not overwritten"),
        (["train", "--address", "127.0.0.1:1"], "say how many with --workers"),
        (
            ["sweep", "{space}", "--engine", "ray", "--address", "127.0.0.1:1"],
            "no Ray answers at address '127.0.0.1:1'",
        ),
        (
            ["sweep", "{space}", "--engine", "ray", "--address", "head"],
            "address must be HOST:PORT or 'auto', got 'head'",
        ),
        (["train", "--workers", "2", "--engine", "local"], "use --engine ray here"),
        (["train", "--task", "precise", "--workers", "99"], "at most 16, one for 16 of num_envs 256"),
        (["train", "--config", "missing.json"], "'missing.json' is no file: --config takes the config.json"),
        (["train", "--config", "{config}", "--task", "precise"], "leave --task out"),
    ],
)
def test_what_cannot_be_used_is_refused_in_a_sentence(
    words: list[str], refused: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = {"folder": tmp_path / "folder", "space": tmp_path / "space.toml", "config": tmp_path / "config.json"}
    places["folder"].mkdir()
    places["space"].write_text("[space]\nepochs = { low = 1, high = 4 }\n")
    write_json(places["config"], to_json(configure()))
    assert main([word.format(**places) for word in words]) == 2
    assert refused in capsys.readouterr().err


@pytest.mark.parametrize(
    ("module", "words", "sentence"),
    [
        ("optuna", ["sweep", "{space}", "--out", "{out}"], f"sweep needs Optuna: {installing('sweep')}."),
        (
            "ray",
            ["sweep", "{space}", "--engine", "ray", "--out", "{out}"],
            f"engine 'ray' needs Ray: {installing('ray')}.",
        ),
        (
            "ray",
            ["train", "--task", "precise", "--workers", "2", "--out", "{out}"],
            f"engine 'ray' needs Ray: {installing('ray')}.",
        ),
    ],
)
def test_without_its_extra_each_is_refused_before_anything_is_written(
    module: str,
    words: list[str],
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / "space.toml").write_text("[space]\nepochs = { low = 1, high = 4 }\n")
    places = {"space": tmp_path / "space.toml", "out": tmp_path / "out"}
    assert main([word.format(**places) for word in words]) == 2
    assert capsys.readouterr().err.strip() == f"reachlab: {sentence}"
    assert not (tmp_path / "out").exists()
