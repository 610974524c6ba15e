"""Learning curves."""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from reachlab.config import InputError
from reachlab.plots import plot_curves


def row(number: int, episodes: float = 60.0, **more: float) -> dict[str, float]:
    share = min(1.0, number / 10)
    return {
        "steps": 8192 * number,
        "wall_s": 0.1 * number,
        "episodes": episodes,
        "success_rate": share,
        "final_distance": 0.5 - 0.4 * share,
        **more,
    }


def make_run(path: Path, rows: list[dict[str, float]]) -> Path:
    path.mkdir()
    (path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return path


@pytest.fixture
def run(tmp_path: Path) -> Path:
    rows = [row(number) for number in range(1, 13)]
    rows[-1]["validation_success"] = 1.0
    return make_run(tmp_path / "first-run", rows)


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Figures in the order in which they are saved."""
    saved: list[Figure] = []
    save = Figure.savefig

    def keep(self: Figure, *args: object, **settings: object) -> None:
        saved.append(self)
        save(self, *args, **settings)  # type: ignore[arg-type]

    monkeypatch.setattr(Figure, "savefig", keep)
    return saved


def curves(figure: Figure, axis: int) -> dict[str, np.ndarray]:
    """Named lines `[N, 2]` of an axis that have points."""
    lines = figure.axes[axis].get_lines()
    return {str(line.get_label()): np.array(line.get_xydata()) for line in lines if len(np.array(line.get_xydata()))}


def test_a_png_is_a_picture_with_a_curve_in_it(run: Path, tmp_path: Path) -> None:
    plot_curves([run], tmp_path / "curve.png")
    with Image.open(tmp_path / "curve.png") as picture:
        assert picture.format == "PNG"
        assert picture.size[0] > 2 * picture.size[1] > 800
        assert np.asarray(picture.convert("L")).std() > 5


def test_an_svg_is_a_drawing_with_the_runs_name(run: Path, tmp_path: Path) -> None:
    with mpl.rc_context({"svg.fonttype": "none"}):
        plot_curves([run], tmp_path / "curve.svg")
    text = (tmp_path / "curve.svg").read_text()
    assert "<svg" in text
    assert "first-run" in text
    assert "environment steps" in text


def test_curves_show_success_in_percent_and_distance_in_millimetres(
    run: Path, tmp_path: Path, figures: list[Figure]
) -> None:
    plot_curves([run], tmp_path / "curve.png")
    steps, seconds, distance = (curves(figures[0], axis)["first-run"] for axis in range(3))
    assert steps[0] == pytest.approx((8192, 10))
    assert steps[-1] == pytest.approx((12 * 8192, 100))
    assert seconds[-1] == pytest.approx((1.2, 100))
    assert distance[0] == pytest.approx((8192, 460))
    assert distance[-1] == pytest.approx((12 * 8192, 100))


def test_validations_are_marked(run: Path, tmp_path: Path, figures: list[Figure]) -> None:
    plot_curves([run], tmp_path / "curve.png")
    marks = [line for line in figures[0].axes[0].get_lines() if line.get_marker() == "."]
    points = np.concatenate([np.array(line.get_xydata()) for line in marks])
    assert points.tolist() == [[12 * 8192, 100]]


def test_runs_are_drawn_beside_each_other(run: Path, tmp_path: Path, figures: list[Figure]) -> None:
    other = make_run(tmp_path / "second-run", [row(number) for number in range(1, 6)])
    plot_curves([run, other], tmp_path / "both.png")
    named = curves(figures[0], 0)
    assert {"first-run", "second-run"} <= set(named)
    assert len(named["second-run"]) == 5


def test_few_episodes_are_pooled_by_their_number(tmp_path: Path, figures: list[Figure]) -> None:
    rows = [row(1, 0), row(2, 10, success_rate=0.0), row(3, 40, success_rate=1.0), row(4, 10)]
    plot_curves([make_run(tmp_path / "few", rows)], tmp_path / "few.png")
    assert curves(figures[0], 0)["few"] == pytest.approx(np.array([[3 * 8192, 80.0]]))


def test_a_last_line_that_was_cut_off_is_left_out(run: Path, tmp_path: Path, figures: list[Figure]) -> None:
    with (run / "metrics.jsonl").open("a") as file:
        file.write('{"steps": 9999, "wall')
    plot_curves([run], tmp_path / "curve.png")
    assert len(curves(figures[0], 0)["first-run"]) == 12


@pytest.mark.parametrize("rows", [[], [row(1, 0)]], ids=["no row", "no episode"])
def test_a_training_that_has_hardly_begun_can_be_drawn(tmp_path: Path, rows: list[dict[str, float]]) -> None:
    plot_curves([make_run(tmp_path / "young", rows)], tmp_path / "young.png")
    assert (tmp_path / "young.png").stat().st_size > 1000


def test_a_run_without_metrics_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no metrics.jsonl: train one with `reachlab train --out"):
        plot_curves([tmp_path / "nothing"], tmp_path / "curve.png")
    assert not (tmp_path / "curve.png").exists()


@pytest.mark.parametrize("name", ["curve.xyz", "missing/curve.png"])
def test_a_picture_that_cannot_be_written_is_refused(run: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="the picture cannot be written to") as refused:
        plot_curves([run], tmp_path / name)
    assert "\n" not in str(refused.value)
    assert not (tmp_path / name).exists()


def test_metrics_that_are_none_are_refused(tmp_path: Path) -> None:
    strange = make_run(tmp_path / "strange", [{"colour": 1.0}])
    with pytest.raises(InputError):
        plot_curves([strange], tmp_path / "curve.png")
