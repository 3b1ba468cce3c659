"""Figures 2, 3, 4, 6, 7, 8 of the paper, drawn again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from mbocp.view.figures.style import house_style, save_figure
from mbocp_papers.numbers import check_number
from mbocp_papers.pendulums.figure_cart import figure_6, figure_7, figure_8
from mbocp_papers.pendulums.figure_pendulum import figure_2, figure_3, figure_4
from mbocp_papers.pendulums.motions import Say


@dataclass(frozen=True)
class FigureSpec:
    """A figure: what it shows, and the function that solves and draws it."""

    title: str
    draw: Callable[[Say], Figure]


FIGURES: Mapping[int, FigureSpec] = {
    2: FigureSpec("3D elastic pendulum: state, adjoint, control, path, invariants", figure_2),
    3: FigureSpec("3D rigid pendulum: state, adjoint, control, constraint, invariants", figure_3),
    4: FigureSpec("3D rigid pendulum in free space: control angular momentum, paths", figure_4),
    6: FigureSpec("2D rigid pendulum on a cart: state, adjoint, control, invariants", figure_6),
    7: FigureSpec("2D rigid pendulum on a cart: constraint manifold, snapshots", figure_7),
    8: FigureSpec("2D elastic pendulum on a cart: state, adjoint, control", figure_8),
}
_SKETCHES = (1, 5)


def check_figure(number: int) -> None:
    """Refuse a number that no figure with results has.

    Raises
    ------
    InvalidValue
    """
    check_number("--figure", number, FIGURES, _SKETCHES)


def draw_figure(number: int, say: Say = str) -> Figure:
    """Solve what a figure needs, and draw it.

    Parameters
    ----------
    number : int
    say : callable
        Told what is being worked on.
    """
    check_figure(number)
    with house_style():
        return FIGURES[number].draw(say)


def write_figure(
    number: int,
    folder: str | Path,
    *,
    suffixes: Sequence[str] = (".png",),
    dpi: int = 160,
    say: Say = str,
) -> list[Path]:
    """Draw a figure and write it as paper_fig<number> into a folder, which is made if need be."""
    figure = draw_figure(number, say)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return [save_figure(figure, folder / f"paper_fig{number}{suffix}", dpi=dpi) for suffix in suffixes]
