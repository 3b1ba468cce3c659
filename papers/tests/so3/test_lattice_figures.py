"""Figures 3, 4, 8, 10, 11 from made-up rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from mbocp_papers.so3.experiment import Lattice
from mbocp_papers.so3.figures import FIGURES, LATTICE_FIGURES, check_figure, write_figure
from mbocp_papers.so3.lattice_figures import bar_figure, convergence_figure, success_figure
from mbocp_papers.so3.outcomes import outcomes_of
from mbocp_papers.so3.request import Request

from mbocp.exceptions import InvalidValue

from . import rows


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return rows.random_rows(tmp_path / "rows.jsonl", Lattice(3, 4))


@pytest.mark.parametrize("number", LATTICE_FIGURES)
def test_a_figure_is_written_from_rows(number: int, path: Path, tmp_path: Path) -> None:
    request = Request(folder=tmp_path / "out", results=path, suffixes=(".png", ".pdf"), dpi=50)
    said: list[str] = []
    png, pdf = write_figure(number, request, said.append)
    assert (png.name, pdf.name) == (f"so3_fig{number}.png", f"so3_fig{number}.pdf")
    assert imread(png)[..., :3].min() < 0.5
    assert not said  # nothing had to be solved


def test_bars_are_the_means(path: Path) -> None:
    outcomes = outcomes_of(rows.loaded(path))
    axes = bar_figure(outcomes, "iterations", "Iterations", "iterations").axes[0]
    heights = [bar.get_height() for bar in axes.patches]
    assert np.allclose(heights, [runs.spread("iterations").mean for runs in outcomes.runs])
    assert axes.get_xticklabels()[0].get_text() == "Q RK"


def test_times_have_a_readable_unit(path: Path) -> None:
    outcomes = outcomes_of(rows.loaded(path))
    axes = bar_figure(outcomes, "seconds", "CPU time", "time").axes[0]
    assert axes.get_ylabel() == "time [ms]"
    assert axes.patches[0].get_height() == pytest.approx(250.0)


def test_success_is_stacked_with_half_turns(path: Path) -> None:
    outcomes = outcomes_of(rows.loaded(path))
    axes = success_figure(outcomes).axes[0]
    first, others = axes.patches[:6], axes.patches[6:12]
    for runs, bar, more in zip(outcomes.runs, first, others, strict=True):
        assert bar.get_height() == pytest.approx(100 * runs.success_rate)
        assert more.get_height() == pytest.approx(100 * runs.counts["half-turn"] / len(runs.ends))


def test_convergence_has_a_panel_for_each_formulation(path: Path) -> None:
    figure = convergence_figure(outcomes_of(rows.loaded(path)))
    titles = [axes.get_title(loc="left") or axes.get_title() for axes in figure.axes]
    assert len(titles) == 6


def test_formulations_without_success_are_drawn(tmp_path: Path) -> None:
    def make(index: int, label: str) -> dict[str, object]:
        return {**rows.row(index, label), "converged": False, "iterations": None, "cost": None}

    request = Request(
        folder=tmp_path, results=rows.written(tmp_path / "rows.jsonl", Lattice(1, 2), make), dpi=40
    )
    for number in LATTICE_FIGURES:
        assert write_figure(number, request)[0].exists()


def test_unknown_figures_are_refused() -> None:
    assert list(FIGURES) == [3, 4, 5, 6, 7, 8, 9, 10, 11, 12]
    with pytest.raises(InvalidValue, match=r"got 2, expected one of 3, 4, .*; figure 2 is a sketch"):
        check_figure(2)
    with pytest.raises(InvalidValue, match="--figure: got 13"):
        check_figure(13)


def test_requests_are_checked() -> None:
    with pytest.raises(InvalidValue, match="--variant: got wrong, expected one of corrected, as_printed"):
        Request(variant="wrong")
    with pytest.raises(InvalidValue, match="--solver: got auto, expected one of ipopt, fatrop, monolithic"):
        Request(solver="auto")
    assert Request(folder=Path("a")).rows == Path("a/so3_13x13x12_corrected_monolithic.jsonl")
