"""The command line as a user meets it."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from reachlab.agents import AGENTS
from reachlab.bench import SUITES
from reachlab.cli import flags as cli_flags
from reachlab.cli import main as cli
from reachlab.cli import train_command
from reachlab.cli.flags import Train, no_goals
from reachlab.cli.verbs import VERBS
from reachlab.envs.consistency import NAMES
from reachlab.envs.presets import configure, distillation, preset
from reachlab.envs.setup import make_setup, settled
from reachlab.envs.uses import unused
from reachlab.render import CAMERAS
from reachlab.robots.catalogue import ROBOTS
from reachlab.runs.directory import RunDirectory
from reachlab.runs.metrics import read_metrics
from reachlab.runs.shipped import shipped
from reachlab.scale import ENGINES
from reachlab.scale.goals import GOALS
from reachlab.settings.json_form import flatten, to_json
from reachlab.settings.validation import InputError
from reachlab.sims import SIMULATORS
from reachlab.sims.mujoco import MujocoSimulator
from reachlab.tasks import TASKS
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.paths import PATHS
from reachlab.tasks.rewards import REWARDS
from reachlab.tasks.targets import TARGETS
from reachlab.tasks.tutorial import AT_GOAL

TINY = "--num-envs 16 --rollout-steps 16 --total-steps 1024 --no-stop-early --report-episodes 10 --max-steps 300"
"""A training of four iterations."""

TABLES = {
    "tasks": TASKS,
    "robots": ROBOTS,
    "simulators": SIMULATORS,
    "observations": OBSERVATIONS,
    "actions": ACTIONS,
    "rewards": REWARDS,
    "targets": TARGETS,
    "goal paths": PATHS,
    "at goal": AT_GOAL,
    "engines": ENGINES,
    "goals of a sweep": GOALS,
    "agents": AGENTS,
    "cameras": CAMERAS,
    "policies": shipped(),
    "suites": SUITES,
}


@dataclass(frozen=True)
class Said:
    """What a command came to."""

    status: int
    out: str
    err: str


class Shell:
    """Runs commands in this process, in a folder of their own."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *words: object) -> Said:
        self._capsys.readouterr()
        try:
            status = cli.main([str(word) for word in words])
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else int(end.code is not None)
        out, err = self._capsys.readouterr()
        return Said(status, str(out), str(err))


@pytest.fixture
def reachlab(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Shell:
    monkeypatch.chdir(tmp_path)
    return Shell(capsys)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Said]:
    """A run of the command, and what it said."""
    out, said, errors = tmp_path_factory.mktemp("cli") / "trained", io.StringIO(), io.StringIO()
    flags = "--seed 4 --reward sparse --action-repeat 1 --no-clip-actions --hidden 16 16 --json"
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(errors):
        status = cli.main(["train", "--out", str(out), *f"{TINY} {flags}".split()])
    return out, Said(status, said.getvalue(), errors.getvalue())


@pytest.fixture
def run(trained: tuple[Path, Said]) -> Path:
    return trained[0]


def in_a_process(*words: str) -> Said:
    done = subprocess.run([sys.executable, "-m", "reachlab", *words], capture_output=True, text=True, check=False)
    return Said(done.returncode, done.stdout, done.stderr)


# --- help and lists -------------------------------------------------------------------------------


def test_the_overview_names_every_command(reachlab: Shell) -> None:
    said = reachlab()
    assert (said.status, said.err) == (0, "")
    assert said == reachlab("--help") == reachlab("-h")
    for name, verb in VERBS.items():
        assert f"  {name} " in said.out
        assert verb.flags.__doc__
        assert verb.flags.__doc__ in said.out


@pytest.mark.parametrize("verb", VERBS)
def test_every_command_has_help_with_every_name_of_its_table(reachlab: Shell, verb: str) -> None:
    said = reachlab(verb, "--help")
    assert (said.status, said.err) == (0, "")
    assert f"usage: reachlab {verb}" in said.out
    names = {"eval": AGENTS, "video": AGENTS, "view": AGENTS, "bench": SUITES}.get(verb)
    assert not names or f": {', '.join(names)}." in " ".join(said.out.replace("│", " ").split())


def test_every_setting_is_a_flag_of_train_and_the_last_task_sets_the_defaults(
    reachlab: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    text = reachlab("train", "--help").out
    config = preset()
    names = [name for part in (config.rules, config.physics, config.ppo) for name in vars(part)]
    names += ["task", "robot", "sim", "seed"]
    assert len(names) == len(set(names)), "flags are flat"
    for name in names:
        shown = re.search(rf"--(no-)?{name.replace('_', '-')}\b", text) is not None
        assert shown is (name not in unused(flatten(to_json(config)))), name
    assert text.count("\n") <= 110
    help_of = reachlab("train", "--task", "tutorial", "--task=precise", "--help").out
    assert help_of == reachlab("train", "--task", "precise", "--help").out != text


def test_list_tells_a_program_and_a_person_every_name_and_what_a_task_asks_for(reachlab: Shell) -> None:
    listed = json.loads(reachlab("list", "--json").out)
    assert {kind: set(entries) for kind, entries in listed.items()} == {k: set(t) for k, t in TABLES.items()}
    assert all(summary.strip() for entries in listed.values() for summary in entries.values())
    assert "within 10 mm for 10 steps (0.2 s)" in listed["tasks"]["precise"]
    said = reachlab("list")
    assert (said.status, said.err) == (0, "")
    assert all(name in said.out for table in TABLES.values() for name in table)
    assert list(json.loads(reachlab("list", "robots", "goal-paths", "--json").out)) == ["robots", "goal paths"]
    assert "kind 'robot' is not one of: " in reachlab("list", "robot").err


@pytest.mark.slow
def test_baselines_are_measured_on_goals_of_any_setting(reachlab: Shell) -> None:
    words = ("eval", "--task", "track", "--agent", "ik", "--episodes", 2, "--max-steps", 60)
    table = reachlab(*words, "--goal-paths", "smooth", "--goal-speed", 0.1, 0.1)
    assert table.status == 0
    assert "after the first 1 s is below 10 mm" in table.out
    assert all(heading in table.out for heading in ("RMS error", "p95 error", "lag"))
    told = json.loads(reachlab(*words, "--goal-paths", "line", "--goal-speed", 0.3, 0.3, "--json").out)
    assert list(told["tracking"]["by_speed"]) == ["0.225 and more"]
    assert "among" not in reachlab(*words, "--goal-paths", "line", "circle", "--goal-velocity", "False").err
    said = reachlab("eval", "--task", "pose", "--agent", "ik", "--goal-paths", "line")
    assert said == Said(2, "", said.err)
    assert "goal_paths is a setting of task track, and not of pose" in said.err


@pytest.mark.slow
def test_the_table_of_poses_tells_both_errors(reachlab: Shell) -> None:
    said = reachlab("eval", "--task", "pose", "--agent", "zero", "--episodes", 2, "--max-steps", 12)
    text = " ".join(said.out.replace("┃", " ").replace("│", " ").split())
    for words in ("within 10 mm and 0.05 rad for 10 steps", "median angle", "≤ 10 mm,", "≤ 2 mm,"):
        assert words in text


def test_reports_of_a_run_on_other_goals_are_not_kept_in_it(reachlab: Shell, run: Path) -> None:
    words = ("eval", run, "--agent", "zero", "--episodes", 20, "--seed", 77)
    assert reachlab(*words, "--max-steps", 5, "--json").status == 0
    assert not list(run.rglob("*-77.json"))


def test_the_version_is_told(reachlab: Shell) -> None:
    assert reachlab("--version") == Said(0, f"reachlab {version('reachlab')}\n", "")


@pytest.mark.parametrize(("verb", "names"), [("eval", AGENTS), ("video", AGENTS), ("view", AGENTS), ("bench", SUITES)])
def test_help_lists_every_name_of_the_table(reachlab: Shell, verb: str, names: dict[str, object]) -> None:
    text = " ".join(reachlab(verb, "--help").out.replace("│", " ").split())
    assert f": {', '.join(names)}." in text


def test_help_of_a_setting_lists_every_name_of_its_table(reachlab: Shell) -> None:
    texts = [" ".join(reachlab("train", "--task", task, "--help").out.replace("│", " ").split()) for task in TASKS]
    for setting, (_, table) in (NAMES | {"robot": ("robot", ROBOTS)}).items():
        text = next(one for one in texts if f"--{setting.replace('_', '-')} " in one)
        described = re.split(rf"--{setting.replace('_', '-')} NAME", text)[1][:700]
        assert all(re.search(rf"(?<![\w+]){re.escape(name)}(?![\w+])", described) for name in table), setting


def test_whole_numbers_are_written_as_numbers_are() -> None:
    flags = cli._parse("train", Train, ["--total-steps", "1e6", "--num-envs", "2.56e2", "--hidden", "6.4e1", "32"])
    assert (flags.run.loop.total_steps, flags.run.loop.num_envs, flags.run.learner.hidden) == (10**6, 256, (64, 32))


@pytest.mark.parametrize("words", [["train", "--help"], ["list"]], ids=" ".join)
def test_a_reader_who_has_gone_ends_a_command_silently(words: list[str]) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        command = [sys.executable, "-m", "reachlab", *words]
        done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    finally:
        os.close(writer)
    assert (done.returncode, done.stderr) == (cli.UNREAD, "")


@pytest.mark.parametrize("stream", ["stdin", "stdout", "stderr"])
def test_a_stream_that_is_closed_ends_no_command(stream: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, stream, None)
    assert cli.main(["--version"]) == cli.DONE
    assert cli.main(["nosuch"]) == cli.WRONG_INPUT
    vars(sys)[stream].close()


# --- wrong input ----------------------------------------------------------------------------------

WRONG = {
    "unknown command": ("trian", "Did you mean 'train'"),
    "unknown flag": ("train --rewrd dense", "Did you mean --reward"),
    "word too many": ("train extra", "extra"),
    "no value": ("train --out", "--out"),
    "word for a number": ("train --num-envs many", "--num-envs.*'many'"),
    "fraction for a whole number": ("train --num-envs 2.5", "--num-envs.*'2.5'"),
    "number out of range": ("train --num-envs 0", "num_envs must be at least 1 and at most 131072, got 0"),
    "number that is not whole": ("train --num-envs 1.5", "--num-envs: must be a whole number, got '1.5'"),
    "list with commas": ("train --hidden 64,32", "--hidden is a list, which is written with blanks: --hidden 64 32."),
    "word in a list": ("train --hidden 64 x", "--hidden takes numbers, got '64', 'x'"),
    "word in a pair": ("train --task clutter --obstacles two 3", "--obstacles takes numbers, got 'two', '3'"),
    "unit beside a number": ("train --success-distance 100mm", "--success-distance takes a number, got '100mm'"),
    "number of a list too few": ("train --target-low 0.4 -0.2", "--target-low takes 3 numbers, got '0.4', '-0.2'"),
    "comma in a number": ("train --learning-rate 1,e-3", "--learning-rate takes a number, got '1,e-3'"),
    "word without its flag": ("train runs/first", "A value follows its flag, as in --out FOLDER"),
    "export of nothing": ("export", "reachlab export needs PATH: Run directory"),
    "the note of a run as a flag": ("train --imports quick.py", "Did you mean --import FILE"),
    "no hidden layer": ("train --hidden", "hidden needs a layer at least, as --hidden 64"),
    "arm in place of a policy": ("eval panda", "policy 'panda' is not one of: panda/clutter"),
    "xacro": (
        "robot mine.urdf.xacro",
        "is no .urdf or .xml file, .*: expand it with `xacro mine.urdf.xacro > mine.urdf`",
    ),
    "page of another ending": (
        "view run --out v.png",
        "the page cannot be written to 'v.png': name a file that ends in",
    ),
    "negative seed": ("train --seed -1", "seed must be at least 0"),
    "not a number": ("train --gamma nan", "gamma must be .*nan"),
    "wrong entry": ("train --hidden 64 0", "each entry of hidden must be at least 1 and at most 4096, got 0"),
    "unknown task": ("train --task tutoral", "Did you mean 'tutorial'"),
    "maker of a robot": ("train --robot kuka", "robot 'kuka' is not one of.*Did you mean 'iiwa14'"),
    "unknown robot": ("train --robot iiwa15", "robot 'iiwa15' is not one of.*Did you mean 'iiwa14'"),
    "robot file that is not there": ("train --robot arm.xml", "robot file '/.*/arm.xml' does not exist: put it there"),
    "robot file that is none": ("train --robot broken.xml", "robot file '/.*/broken.xml' does not compile"),
    "unknown tool": ("train --tool hand", "hand"),
    "unknown reward": ("train --reward spars", "Did you mean 'sparse'"),
    "minibatches that do not divide": ("train --num-envs 10 --rollout-steps 7 --minibatches 4", "10.*4 minibatches"),
    "existing out": ("train --out taken", "'taken' exists and is not overwritten"),
    "eval without a run": ("eval", "agent 'trained' needs a run: name its directory or a policy of `reachlab list`"),
    "eval of a file": ("eval broken.xml", "'broken.xml' is a file, where the directory of a run is needed"),
    "eval of a run beside": ("eval rum", r"does not exist: .*\. Did you mean 'run'\?"),
    "train into an unfinished run": (
        "train --out begun",
        "overwritten: name another with --out, or continue it with --resume",
    ),
    "eval of no run elsewhere": ("eval ../nothing", "'../nothing' does not exist: train one with"),
    "eval of no run": ("eval nothing", "'nothing' does not exist: train one with"),
    "eval of an empty folder": ("eval taken", "config.json' is missing"),
    "eval of an unknown agent": ("eval taken --agent tained", "Did you mean 'trained'"),
    "eval of no episodes": ("eval run --agent ik --episodes 0", "episodes must be at least 1 and .*, got 0"),
    "video to an unknown ending": ("video run --out film.avi", "'film.avi': name a file that ends in .webp or .gif"),
    "video into no folder": ("video run --out no/film.gif", "cannot be written to 'no/film.gif'"),
    "video of no pictures a second": ("video run --fps 0", "fps must be above 0"),
    "video of too few pictures": ("video run --agent ik --fps 1e-6", "a picture would stand for 1e.06 s"),
    "plot of nothing": ("plot", "run"),
    "plot of no run": ("plot nothing", "run directory 'nothing' does not exist"),
    "plot of a sweep": ("plot swept", "'swept' is a sweep: its runs are the folders in 'swept/trials'"),
    "eval of a sweep": ("eval swept", "'swept' is a sweep: its runs are the folders in 'swept/trials'"),
    "view of a sweep": ("view swept", "'swept' is a sweep: its runs are the folders in 'swept/trials'"),
    "export of a sweep": ("export swept --out e", "'swept' is a sweep: its runs are the folders in 'swept/trials'"),
    "settings in no file": ("train --config nothing.json", "'nothing.json' is no file: --config takes the config.json"),
    "settings of a distillation": ("train --config taught.json", "the file holds the settings of a distillation"),
    "unknown task of an evaluation": ("eval --task plaice", "Did you mean 'place'"),
    "unknown observation of a student": ("distil panda/precise --observation imge", "Did you mean 'image'"),
    "plot to an unknown ending": ("plot young --out curve.xyz", "cannot be written to 'curve.xyz'"),
    "plot to a folder": ("plot young --out .", "cannot be written to '.': name a file that ends in .png or .svg"),
}


@pytest.mark.parametrize("task", TASKS)
def test_the_flags_of_goals_take_what_a_task_begins_with(task: str) -> None:
    rules = vars(preset(task).rules)
    given = {name: rules[name] for name in cli_flags.evaluated() if name in rules}
    flags = vars(type(no_goals())(**given))
    assert {name: flags[name] for name in given} == given


@pytest.mark.parametrize(("command", "sentence"), WRONG.values(), ids=WRONG)
def test_wrong_input_is_answered_by_one_sentence(
    reachlab: Shell, run: Path, tmp_path: Path, command: str, sentence: str
) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "young").mkdir()
    (tmp_path / "young" / "metrics.jsonl").write_text("")
    (tmp_path / "begun").mkdir()
    (tmp_path / "begun" / "config.json").write_text("{}")
    (tmp_path / "swept").mkdir()
    (tmp_path / "swept" / "sweep.json").write_text("{}")
    student = distillation("panda/precise", configure("precise"))
    (tmp_path / "taught.json").write_text(json.dumps(to_json(student)))
    (tmp_path / "broken.xml").write_text("<mujoco><worldbody>")
    (tmp_path / "mine.urdf.xacro").write_text("<robot/>")
    (tmp_path / "run").symlink_to(run)
    before = sorted(tmp_path.rglob("*"))
    said = reachlab(*command.split())
    assert said.status == cli.WRONG_INPUT
    assert said.out == ""
    assert said.err.startswith("reachlab: ")
    assert said.err.endswith("\n")
    assert said.err.count("\n") == 1, said.err
    assert re.search(sentence, said.err), said.err
    assert sorted(tmp_path.rglob("*")) == before


@dataclass(frozen=True)
class Short:
    """Flags of a command that refuses every name."""

    name: str = ""

    def __post_init__(self) -> None:
        raise InputError(f"name must be short, got {self.name!r}.")


def test_a_refusal_is_told_whole_however_long_it_is(reachlab: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(VERBS, "list", replace(VERBS["list"], flags=Short))
    said = reachlab("list", "--name", "x" * 200)
    assert said == Said(2, "", f"reachlab: name must be short, got '{'x' * 200}'. See `reachlab list --help`.\n")


def test_an_interruption_is_told_by_its_status(reachlab: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setitem(VERBS, "list", replace(VERBS["list"], run=interrupted))
    assert reachlab("list") == Said(130, "", "reachlab: interrupted.\n")


@pytest.mark.skipif(find_spec("pybullet") is None, reason="needs PyBullet")
def test_pybullet_prints_nothing_beside_a_result() -> None:
    words = "eval --task tutorial --agent ik --sim pybullet --episodes 2 --json"
    assert json.loads(in_a_process(*words.split()).out)["sim"] == "pybullet"


def test_a_backend_that_mujoco_does_not_know_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "bogus")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # where nothing is listed yet
    said = in_a_process("list")
    assert (said.status, said.out) == (cli.WRONG_INPUT, "")
    assert said.err.startswith("reachlab: MuJoCo does not load with MUJOCO_GL='bogus' (")
    assert said.err.count("\n") == 1


# --- train ----------------------------------------------------------------------------------------


def test_train_prints_one_json_object_and_nothing_else(trained: tuple[Path, Said]) -> None:
    out, said = trained
    assert said.status == 0, said.err
    result = json.loads(said.out)
    assert result == json.loads((out / "report.json").read_text())
    assert (result["agent"], result["steps"], result["episodes"]) == ("trained", 1024, 10)
    rows = read_metrics(out / "metrics.jsonl")
    assert [row["steps"] for row in rows] == [256, 512, 768, 1024], "without early stopping all steps are taken"
    assert result["validated"] is None
    assert not any("validation_success" in row for row in rows)
    assert "Next: reachlab eval" in said.err
    assert "Success: the tool comes within 100 mm of the target" in said.err
    lines = [line for line in said.err.splitlines() if "M steps" in line]
    assert lines
    assert all(re.match(r"0\.00M of 0\.00M steps  .*\d+ steps/s  \d+ s", line) for line in lines)


def test_flags_reach_the_configuration(trained: tuple[Path, Said]) -> None:
    config = RunDirectory(trained[0]).read_config()
    given = {"num_envs": 16, "rollout_steps": 16, "total_steps": 1024, "stop_early": False, "report_episodes": 10}
    given |= {
        "max_steps": 300,
        "seed": 4,
        "reward": "sparse",
        "action_repeat": 1,
        "clip_actions": False,
        "hidden": (16, 16),
    }
    asked = configure(**given)
    assert config == settled(asked, make_setup(asked))


def test_without_flags_the_tutorials_task_is_trained() -> None:
    assert cli._parse("train", Train, []).run == configure()


def test_of_a_flag_given_twice_the_last_one_counts() -> None:
    assert cli._parse("train", Train, ["--reward", "dense", "--reward=sparse"]).run == configure(reward="sparse")


def test_a_curve_for_which_there_is_no_place_is_told_of_and_nothing_else_is_lost(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert train_command._draw(run, run / "report.json" / "curve.png") == ()
    assert f"Once that is mended: reachlab plot {run}" in capsys.readouterr().err


def test_a_trained_run_has_its_curve_and_is_evaluated_and_drawn(trained: tuple[Path, Said], reachlab: Shell) -> None:
    out, _ = trained
    with Image.open(out / "curve.png") as picture:
        assert picture.format == "PNG"
    said = reachlab("eval", out, "--episodes", 10, "--json")
    assert said.status == 0, said.err
    assert json.loads(said.out)["agent"] == "trained"
    assert reachlab("plot", out).status == 0
    assert (out / "plots.png").exists()


# --- eval -----------------------------------------------------------------------------------------


def evaluated(reachlab: Shell, run: Path, *words: object) -> Any:
    said = reachlab("eval", run, "--episodes", 20, "--json", *words)
    assert said.status == 0, said.err
    return json.loads(said.out)


def test_eval_prints_and_saves_reports_which_repeat_themselves(reachlab: Shell, run: Path) -> None:
    report = evaluated(reachlab, run, "--agent", "ik", "--seed", 7)
    assert (report["agent"], report["seed"], report["episodes"], report["sim"]) == ("ik", 7, 20, "kinematic")
    assert report["success_rate"] == 1
    assert json.loads((run / "reports" / "kinematic-ik-7.json").read_text()) == report
    again, idle = evaluated(reachlab, run, "--agent", "ik", "zero", "--seed", 7)
    assert again | {"wall_s": 0} == report | {"wall_s": 0}
    assert (idle["agent"], idle["success_rate"]) == ("zero", 0)
    assert (run / "reports" / "kinematic-zero-7.json").exists()


def test_of_all_simulators_there_is_what_there_is_where_one_is_missing_and_another_fails(
    reachlab: Shell, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise FloatingPointError("the engine's state is not finite")

    monkeypatch.setitem(sys.modules, "pybullet", None)
    monkeypatch.setattr(MujocoSimulator, "reset", fail)
    said = reachlab("eval", run, "--sim", "all", "--agent", "ik", "--episodes", 20, "--seed", 9)
    assert said.status == cli.WRONG_INPUT
    assert "│ ik    │ kinematic │" in said.out
    lines = said.err.splitlines()
    assert lines[0].startswith("pybullet: "), "before time is spent on the others"
    assert "pip install" in lines[0]
    assert "mujoco: the engine's state is not finite" in said.err
    assert lines[-1] == "reachlab: no result in pybullet, mujoco: the reason is above."
    assert json.loads((run / "reports" / "kinematic-ik-9.json").read_text())["episodes"] == 20


def test_several_runs_are_in_one_table_with_the_baselines_once(reachlab: Shell, run: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(run, other)  # of the same seed: a mean would say nothing
    said = reachlab("eval", run, other, "--agent", "trained", "ik", "--episodes", 10, "--json")
    assert [(report["run"], report["agent"]) for report in json.loads(said.out)] == [
        *((str(run), "trained"), ("", "ik"), (str(other), "trained"))
    ]
    assert "is named twice" in reachlab("eval", run, run).err
    said = reachlab("eval", run, "panda/tutorial")
    assert (said.status, "one table is of one robot" in said.err) == (cli.WRONG_INPUT, True)


def test_a_person_sees_a_table_and_progress_though_the_run_cannot_be_written_of_which_a_warning_tells(
    reachlab: Shell, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_only(self: RunDirectory, name: str, *_: object) -> None:
        raise InputError(f"report '{self.reports / name}.json' cannot be written: Read-only file system.")

    monkeypatch.setattr(RunDirectory, "write_report", read_only)
    said = reachlab("eval", run, "--agent", "ik", "--episodes", 20)
    assert said.status == 0
    assert "100.00 %" in said.out
    assert "Success: the tool comes within 100 mm of the target" in said.out
    told, warning = said.err.splitlines()[-2:]
    assert told.startswith("ik in kinematic: 20 of 20 episodes, ")
    assert re.search("Warning: report .* cannot be written: Read-only file system", warning)


# --- video ----------------------------------------------------------------------------------------


def test_video_tells_what_it_filmed(reachlab: Shell, run: Path) -> None:
    said = reachlab("video", run, "--agent", "ik", "--episodes", 1, "--fps", 2, "--out", "film.gif", "--json")
    if "pictures need OpenGL" in said.err:
        pytest.skip(said.err)
    clip = json.loads(said.out)
    assert (said.status, clip["out"], clip["episodes"], clip["successes"]) == (0, "film.gif", 1, 1)
    with Image.open("film.gif") as picture:
        assert (picture.format, picture.n_frames) == ("GIF", clip["frames"])  # type: ignore[attr-defined]
    assert re.fullmatch(r"film of ik in kinematic: 1 of 1 episodes, \d+ s\n", said.err)
