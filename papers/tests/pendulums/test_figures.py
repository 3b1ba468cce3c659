"""Every figure is drawn, from finite numbers, and two solvers agree on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from mbocp_papers.pendulums import figures
from mbocp_papers.pendulums.figure_cart import _planar_momenta
from mbocp_papers.pendulums.figures import FIGURES, FigureSpec, draw_figure, write_figure
from mbocp_papers.pendulums.motions import free_space, motion_pair, penalty_or_lagrange

from mbocp.exceptions import InvalidValue
from mbocp.view.figures.style import save_figure

PANELS = {2: "abcdefgh", 3: "abcdefgh", 4: "ab", 6: "abcdefgh", 7: "abcdef", 8: "abcdef"}


@pytest.mark.parametrize("number", FIGURES)
def test_figure_has_the_paper_s_panels(number: int, tmp_path: Path) -> None:
    figure = draw_figure(number)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert [title[1] for title in sorted(titles)] == list(PANELS[number])
    for axes in figure.axes:
        for line in axes.get_lines():
            assert np.isfinite(np.asarray(line.get_ydata(), dtype=float)).all()
    assert not any("another optimum" in text.get_text() for text in figure.texts)
    pixels = imread(save_figure(figure, tmp_path / "figure.png", dpi=40))
    assert pixels[..., :3].min() < 0.5


def test_figures_are_written_as_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    empty = FigureSpec("empty", lambda _say: Figure(figsize=(1, 1)))
    monkeypatch.setattr(figures, "FIGURES", {4: empty})
    png, pdf = write_figure(4, tmp_path / "new", suffixes=(".png", ".pdf"), dpi=60)
    assert (png.name, pdf.name) == ("paper_fig4.png", "paper_fig4.pdf")
    assert imread(png).shape[:2] == (60, 60)
    assert pdf.read_bytes().startswith(b"%PDF")


def test_free_space_starts_and_ends_as_in_the_paper() -> None:
    """Not the singular motion on the equator; all three components of xi are kept (Fig. 4a)."""
    pair = free_space()
    for motion in (pair.monolithic, pair.fbsm):
        assert motion is not None
        s = motion.solution
        assert np.allclose(s.qs[0], [5, 0, 0])
        assert np.allclose(s.qs[-1], [0, 0, -5], atol=1e-9)
        assert np.allclose(s.ps[-1], 0.0, atol=1e-9)
        assert np.ptp(motion.xi, axis=0).max() < 1e-9
        assert np.abs(motion.xi[0, :2]).min() > 100.0
    assert not pair.monolithic.problem.robot.model.gravity.linear.any()


@pytest.mark.parametrize(
    ("system", "form"), [("elastic_pendulum", "lagrange"), ("cart_pendulum_rigid", "tracking")]
)
def test_both_solvers_agree(system: str, form) -> None:
    pair = motion_pair(system, form)
    assert pair.fbsm is not None, pair.remark
    for name in ("mu_q", "mu_p", "hamiltonian"):
        ours, theirs = getattr(pair.monolithic, name), getattr(pair.fbsm, name)
        assert np.abs(ours - theirs).max() < 1e-6 * max(1.0, np.abs(ours).max())


def test_adjoints_of_the_penalty_form_are_scaled() -> None:
    lagrange = penalty_or_lagrange("elastic_pendulum", "lagrange")
    penalty = penalty_or_lagrange("elastic_pendulum", "penalty")
    assert np.abs(lagrange.mu_q - penalty.mu_q).max() < 5e-3 * np.abs(lagrange.mu_q).max()
    assert np.ptp(lagrange.xi[:, 2]) < 1e-9
    assert np.ptp(lagrange.xi[:, 0]) > 1.0


def test_the_cart_s_translation_is_kept() -> None:
    momenta = _planar_momenta(penalty_or_lagrange("cart_pendulum_elastic", "tracking"))
    assert np.ptp(momenta[:, 1]) < 1e-9
    assert np.ptp(momenta[:, 0]) > 1e-3


def test_unknown_figures_are_refused() -> None:
    with pytest.raises(InvalidValue, match="got 5, expected one of 2, 3, 4, 6, 7, 8; figure 5 is a sketch"):
        draw_figure(5)
    with pytest.raises(InvalidValue, match="got 9, expected one of 2"):
        draw_figure(9)
