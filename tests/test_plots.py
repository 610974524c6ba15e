"""Pictures of runs."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from reachlab.agents import AGENTS
from reachlab.envs.presets import configure
from reachlab.runs.directory import RunDirectory
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import to_json
from reachlab.settings.validation import InputError
from reachlab.watch.plots import plot
from reachlab.watch.results import band, group_runs, read_evaluations


def row(number: int, episodes: float = 120.0, **more: float) -> dict[str, float]:
    share = min(1.0, number / 10)
    return {
        "steps": 8192 * number,
        "wall_s": 0.1 * number,
        "episodes": episodes,
        "success_rate": share,
        "final_distance": 0.5 - 0.4 * share,
        **more,
    }


def make_run(path: Path, rows: list[dict[str, float]], config: RunConfig | None = None) -> Path:
    path.mkdir()
    if config:
        (path / "config.json").write_text(json.dumps(to_json(config)))
    (path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return path


@pytest.fixture
def run(tmp_path: Path) -> Path:
    rows = [row(number) for number in range(1, 13)]
    rows[-1]["validation_success"] = 1.0
    return make_run(tmp_path / "first-run", rows)


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Figures in the order in which they would be saved: drawing them is what takes long."""
    saved: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: saved.append(figure))
    return saved


def curves(figure: Figure, axis: int) -> dict[str, np.ndarray]:
    """Named lines `[N, 2]` of an axis that have points."""
    lines = figure.axes[axis].get_lines()
    return {str(line.get_label()): np.array(line.get_xydata()) for line in lines if len(np.array(line.get_xydata()))}


def test_a_png_is_a_picture_with_a_curve_in_it(run: Path, tmp_path: Path) -> None:
    plot([run], tmp_path / "curve.png")
    with Image.open(tmp_path / "curve.png") as picture:
        assert picture.format == "PNG"
        assert picture.size[0] > 2 * picture.size[1] > 800
        assert np.asarray(picture.convert("L")).std() > 5


def test_an_svg_is_a_drawing_with_the_runs_name(run: Path, tmp_path: Path) -> None:
    with mpl.rc_context({"svg.fonttype": "none"}):
        plot([run], tmp_path / "curve.svg")
    text = (tmp_path / "curve.svg").read_text()
    assert "<svg" in text
    assert "first-run" in text
    assert "environment steps" in text


def test_a_name_is_no_formula(tmp_path: Path) -> None:
    named = make_run(tmp_path / r"run $\frac{$ x", [row(number) for number in range(1, 6)])
    plot([named], tmp_path / "curve.svg")
    assert r"run $\frac{$ x" in (tmp_path / "curve.svg").read_text()


def test_curves_show_success_in_percent_and_distance_in_millimetres(
    run: Path, tmp_path: Path, figures: list[Figure]
) -> None:
    plot([run], tmp_path / "curve.png")
    steps, seconds, distance = (curves(figures[0], axis)["first-run"] for axis in range(3))
    assert steps[0] == pytest.approx((8192, 10))
    assert steps[-1] == pytest.approx((12 * 8192, 100))
    assert seconds[-1] == pytest.approx((1.2, 100))
    assert distance[0] == pytest.approx((8192, 460))
    assert distance[-1] == pytest.approx((12 * 8192, 100))
    marks = [line for line in figures[0].axes[0].get_lines() if line.get_marker() == "."]
    points = np.concatenate([np.array(line.get_xydata()) for line in marks])
    assert points.tolist() == [[12 * 8192, 100]], "validations are marked"


def test_runs_are_drawn_beside_each_other(run: Path, tmp_path: Path, figures: list[Figure]) -> None:
    other = make_run(tmp_path / "second-run", [row(number) for number in range(1, 6)])
    plot([run, other], tmp_path / "both.png")
    named = curves(figures[0], 0)
    assert {"first-run", "second-run"} <= set(named)
    plot(str(other), tmp_path / "alone.png")
    assert "second-run" in curves(figures[1], 0)
    assert len(named["second-run"]) == 5


def test_few_episodes_are_pooled_by_their_number(tmp_path: Path, figures: list[Figure]) -> None:
    rows = [row(1, 0), row(2, 20, success_rate=0.0), row(3, 80, success_rate=1.0), row(4, 20)]
    plot([make_run(tmp_path / "few", rows)], tmp_path / "few.png")
    assert curves(figures[0], 0)["few"] == pytest.approx(np.array([[3 * 8192, 80.0]]))
    assert figures[0].axes[0].get_lines()[0].get_marker() == ".", "a single point is no line"


def test_a_last_line_that_was_cut_off_is_left_out(run: Path, tmp_path: Path, figures: list[Figure]) -> None:
    with (run / "metrics.jsonl").open("a") as file:
        file.write('{"steps": 9999, "wall')
    plot([run], tmp_path / "curve.png")
    assert len(curves(figures[0], 0)["first-run"]) == 12


@pytest.mark.parametrize("rows", [[], [row(1, 0)]], ids=["no row", "no episode"])
def test_a_training_that_has_hardly_begun_can_be_drawn(
    tmp_path: Path, figures: list[Figure], rows: list[dict[str, float]]
) -> None:
    plot([make_run(tmp_path / "young", rows)], tmp_path / "young.png")
    assert not curves(figures[0], 0)
    assert [text.get_text() for text in figures[0].axes[0].texts] == ["fewer than 100 episodes\nhave ended in training"]


def test_a_run_without_metrics_is_refused(tmp_path: Path) -> None:
    (tmp_path / "nothing").mkdir()
    with pytest.raises(InputError, match=r"holds no metrics.jsonl: train one with `reachlab train --out"):
        plot([tmp_path / "nothing"], tmp_path / "curve.png")
    assert not (tmp_path / "curve.png").exists()


@pytest.mark.parametrize("name", ["curve.xyz", "missing/curve.png", "."])
def test_a_picture_that_cannot_be_written_is_refused(run: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="the picture cannot be written to") as refused:
        plot([run], tmp_path / name)
    assert "\n" not in str(refused.value)
    assert list(tmp_path.iterdir()) == [run]


@pytest.mark.parametrize("name", ["config.json", "metrics.jsonl", "reports/a.safetensors"])
@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")])
def test_what_is_not_a_plain_file_is_refused_and_not_waited_for(
    run: Path, tmp_path: Path, name: str, make: Callable[[Path], object]
) -> None:
    (run / "reports").mkdir()
    (run / name).unlink(missing_ok=True)
    make(run / name)
    with pytest.raises(InputError) as refused:
        plot([run], tmp_path / "curve.png")
    assert str(run) in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("text", ["[]", "[" * 100_000])
def test_a_configuration_without_settings_is_refused(run: Path, tmp_path: Path, text: str) -> None:
    (run / "config.json").write_text(text)
    with pytest.raises(InputError, match=r"config.json' is not"):
        plot([run], tmp_path / "curve.png")


def test_a_row_of_words_is_refused(run: Path, tmp_path: Path) -> None:
    with (run / "metrics.jsonl").open("a") as file:
        file.write(json.dumps(row(13) | {"episodes": "many"}) + "\n")
    with pytest.raises(InputError, match=r"has no number 'episodes'"):
        plot([run], tmp_path / "curve.png")


# --- seeds and groups -----------------------------------------------------------------------------


def test_runs_that_differ_by_their_seeds_alone_are_one_group(tmp_path: Path) -> None:
    runs = [
        make_run(tmp_path / f"{reward}-{seed}", [row(1)], configure(reward=reward, seed=seed))
        for seed in (0, 1, 2)
        for reward in ("dense", "sparse")
    ]
    groups = group_runs([*runs, make_run(tmp_path / "other", [row(1)], configure(reward="sparse", gamma=0.8))])
    assert [group.label for group in groups] == [
        "gamma 0.98, reward dense, 3 seeds",
        "gamma 0.9, reward sparse, 3 seeds",
        "gamma 0.8, reward sparse",
    ]
    assert [run.name for run in groups[0].runs] == ["dense-0", "dense-1", "dense-2"]


@pytest.mark.parametrize(
    ("settings", "label"),
    [({"reward": "sparse"}, "reward sparse"), ({"observation": "image"}, "observation image")],
)
def test_settings_that_follow_from_others_are_not_named(tmp_path: Path, settings: dict[str, Any], label: str) -> None:
    runs = [make_run(tmp_path / str(i), [row(1)], configure(**given)) for i, given in enumerate(({}, settings))]
    assert group_runs(runs)[1].label == label


def test_a_single_group_is_called_by_its_run_or_its_task(tmp_path: Path) -> None:
    runs = [make_run(tmp_path / f"run-{seed}", [row(1)], configure(seed=seed)) for seed in (0, 1)]
    assert [group.label for group in group_runs(runs)] == ["tutorial task, 2 seeds"]
    assert [group.label for group in group_runs(runs[:1])] == ["run-0"]


def test_the_interval_is_students() -> None:
    curves = [[{"x": 0.0, "y": 1.0}, {"x": 2.0, "y": value}] for value in (1.0, 2.0, 3.0)]
    found = band(curves, "x", "y")
    assert found.low is not None
    assert found.high is not None
    assert found.mean == pytest.approx([1.0, 2.0])
    # Student's 97.5 % quantile with 2 degrees of freedom, and a standard deviation of 1.
    half = 4.302653 / 3**0.5
    assert found.high == pytest.approx([1.0, 2.0 + half], rel=1e-6)
    assert found.low == pytest.approx([1.0, 0.0]), "nothing that is drawn is negative"
    assert band(curves[:1], "x", "y").low is None, "a single run has none"
    limited = band(curves, "x", "y", most=2.5)
    assert limited.high == pytest.approx([1.0, 2.5])


def test_curves_are_joined_where_all_have_begun_and_keep_their_last_value() -> None:
    long = [{"x": at, "y": at} for at in (0.0, 2.0, 4.0)]
    short = [{"x": at, "y": 0.0} for at in (1.0, 2.0)]
    found = band([long, short], "x", "y")
    assert found.x == pytest.approx([1, 2, 4])
    assert found.mean == pytest.approx([0.5, 1, 2])


def test_seeds_are_drawn_as_one_curve_with_its_interval(tmp_path: Path, figures: list[Figure]) -> None:
    runs = [
        make_run(
            tmp_path / f"run-{seed}", [row(n, success_rate=0.5 + 0.1 * seed) for n in (1, 2)], configure(seed=seed)
        )
        for seed in (0, 1)
    ]
    plot(runs, tmp_path / "seeds.png")
    success = curves(figures[0], 0)["tutorial task, 2 seeds"]
    assert success[:, 1] == pytest.approx([55, 55])
    assert len(figures[0].axes[0].collections) == 1


# --- evaluations ----------------------------------------------------------------------------------

SIDE = 20


def evaluate(
    run: Path, agent: str = "trained", sim: str = "kinematic", *, spread: bool = False, **changed: object
) -> None:
    """Keep 400 episodes of a grid of targets, of which the farthest row fails."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(0.3, 0.7, SIDE), np.linspace(-0.3, 0.3, SIDE)))
    failed = x > 0.69
    rows = {
        "goal": np.stack([x, y, np.linspace(0, 0.4, SIDE**2) if spread else np.full_like(x, -0.01)], axis=-1),
        "distance": np.where(failed, 0.25, 0.05),
        "success": ~failed,
        **changed,
    }
    RunDirectory(run).write_report(f"{sim}-{agent}-1", {"sim": sim, "agent": agent}, rows)


@pytest.fixture
def evaluated(tmp_path: Path) -> Path:
    run = make_run(tmp_path / "evaluated", [row(n) for n in (1, 2)], configure())
    evaluate(run)
    return run


def titles(figure: Figure) -> list[str]:
    return [axes.get_title("left") for axes in figure.axes]


def test_what_varied_makes_an_evaluation_of_its_own(evaluated: Path) -> None:
    rows = {"goal": np.zeros((1, 3)), "distance": np.zeros(1), "success": np.ones(1, bool)}
    for name in ("dynamics", "view"):
        report = {"sim": "kinematic", "agent": "trained", "randomised": [name]}
        RunDirectory(evaluated).write_report(f"kinematic-trained-1-{name}", report, rows)
    found = read_evaluations(group_runs([evaluated])[0])
    assert {(evaluation.label, len(evaluation.goal)) for evaluation in found} == {
        ("trained, kinematic", 400),
        ("trained (dynamics randomised), kinematic", 1),
        ("trained (view randomised), kinematic", 1),
    }


def test_errors_are_drawn_as_the_share_of_episodes_within(
    evaluated: Path, tmp_path: Path, figures: list[Figure]
) -> None:
    plot([evaluated], tmp_path / "all.png")
    axes = figures[0].axes[titles(figures[0]).index("Error on held-out targets")]
    line = np.array(next(line for line in axes.get_lines() if line.get_label() == "trained, kinematic").get_xydata())
    assert line[line[:, 0] <= 100, 1].max() == pytest.approx(0.95)
    assert line[:, 0].max() == pytest.approx(250)
    assert axes.get_xscale() == "log"


def test_every_failure_is_marked_where_its_target_was(evaluated: Path, tmp_path: Path, figures: list[Figure]) -> None:
    plot([evaluated], tmp_path / "all.png")
    name = "Workspace from above\ntrained, kinematic: 20 of 400 missed"
    cells, marks = figures[0].axes[titles(figures[0]).index(name)].collections
    where = np.asarray(marks.get_offsets())
    assert len(where) == SIDE
    assert where[:, 1] == pytest.approx(np.full(SIDE, 0.7)), "x is up, as seen from above"
    assert sorted(where[:, 0]) == pytest.approx(np.linspace(-0.3, 0.3, SIDE))
    rates = np.ma.compressed(np.ma.asarray(cells.get_array()))
    assert rates.max() == 100
    assert figures[0].axes[titles(figures[0]).index(name)].xaxis_inverted(), "y grows to the left, as seen from above"
    assert 0 < rates.min() < 90, "the cells of the farthest row"


def test_targets_of_many_heights_are_seen_from_two_sides(
    evaluated: Path, tmp_path: Path, figures: list[Figure]
) -> None:
    plot([evaluated], tmp_path / "flat.png")
    evaluate(evaluated, spread=True)
    plot([evaluated], tmp_path / "high.png")
    views = [[title.split("\n")[0] for title in titles(figure) if "Workspace" in title] for figure in figures]
    assert views == [["Workspace from above"], ["Workspace from above", "Workspace from the front"]]


def test_evaluations_of_a_groups_seeds_are_pooled_and_the_trained_agent_comes_first(tmp_path: Path) -> None:
    runs = [make_run(tmp_path / f"run-{seed}", [row(1)], configure(seed=seed)) for seed in (0, 1)]
    for run in runs:
        for agent in ("ik", "trained"):
            evaluate(run, agent)
    found = read_evaluations(group_runs(runs)[0])
    assert [evaluation.agent for evaluation in found] == ["trained", "ik"]
    assert found[0].goal.shape == (2 * SIDE**2, 3)
    assert found[0].error.max() == pytest.approx(250)


def errors_of(figure: Figure) -> dict[str, tuple[object, str]]:
    """Colour and kind of each named line among the errors."""
    axes = figure.axes[titles(figure).index("Error on held-out targets")]
    lines = {str(line.get_label()): (line.get_color(), str(line.get_linestyle())) for line in axes.get_lines()}
    return {label: look for label, look in lines.items() if "," in label or ":" in label}


def test_every_agent_and_simulator_of_a_run_is_drawn_and_told_apart(
    evaluated: Path, tmp_path: Path, figures: list[Figure]
) -> None:
    sims = ("kinematic", "mujoco", "pybullet")
    evaluate(evaluated, "ik")
    plot([evaluated], tmp_path / "some.png")
    for agent in AGENTS:
        for sim in sims:
            evaluate(evaluated, agent, sim)
    assert plot([evaluated], tmp_path / "all.png") == []
    some, looks = map(errors_of, figures)
    assert some["ik, kinematic"] == looks["ik, kinematic"], "whatever else was evaluated"
    assert {f"{agent}, {sim}" for agent in AGENTS for sim in sims} <= looks.keys()
    assert len(set(looks.values())) == len(looks)
    for agent in AGENTS:
        assert len({looks[f"{agent}, {sim}"][0] for sim in sims}) == 1, "an agent has one colour"


def test_a_group_has_one_colour_though_another_was_not_evaluated(tmp_path: Path, figures: list[Figure]) -> None:
    runs = [make_run(tmp_path / f"{seed}", [row(1), row(2)], configure(gamma=0.9 + seed / 100)) for seed in range(3)]
    for run in (runs[0], runs[2]):
        evaluate(run)
    evaluate(runs[0], "ik")
    left_out = plot(runs, tmp_path / "three.png")
    learning = {str(line.get_label()): line.get_color() for line in figures[0].axes[0].get_lines()}
    errors = {label.partition(":")[0]: look[0] for label, look in errors_of(figures[0]).items()}
    assert {label: learning[label] for label in ("gamma 0.9", "gamma 0.92")} == {
        label: errors[label] for label in ("gamma 0.9", "gamma 0.92")
    }
    assert left_out == [
        "of gamma 0.9: ik, kinematic (plot that run alone).",
        "errors of gamma 0.91: `reachlab eval` has kept none.",
    ]


@pytest.mark.parametrize("episodes", [1, 2, SIDE**2])
def test_a_map_without_a_failure_says_so_in_words_and_few_episodes_can_be_drawn(
    tmp_path: Path, figures: list[Figure], episodes: int
) -> None:
    run = make_run(tmp_path / "all", [row(1)], configure())
    goal = np.linspace((0.3, -0.2, 0.0), (0.6, 0.2, 0.0), episodes)
    evaluate(run, goal=goal, distance=np.full(episodes, 0.0), success=np.ones(episodes, bool))
    plot([run], tmp_path / "all.png")
    if episodes < SIDE:
        return
    name = "Workspace from above\ntrained, kinematic: all 400 reached"
    (targets,) = figures[0].axes[titles(figures[0]).index(name)].collections
    assert len(np.asarray(targets.get_offsets())) == episodes


def test_the_legend_speaks_of_validations_only_where_there_are_some(tmp_path: Path, figures: list[Figure]) -> None:
    for name, more in (("with", {"validation_success": 1.0}), ("without", {})):
        plot([make_run(tmp_path / name, [row(1), row(2, **more)])], tmp_path / f"{name}.png")
    texts = [[text.get_text() for text in figure.subfigs[0].legends[0].get_texts()] for figure in figures]
    assert texts == [["with", "validation"], ["without"]]


def test_damaged_episodes_are_refused(evaluated: Path, tmp_path: Path) -> None:
    (evaluated / "reports" / "kinematic-trained-1.safetensors").write_bytes(b"damaged")
    with pytest.raises(InputError, match=r"is damaged: evaluate again"):
        plot([evaluated], tmp_path / "all.png")
