"""Figures 3 to 12 of [Manara2017]_, drawn again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from mbocp.view.figures.style import house_style, save_figure
from mbocp_papers.numbers import check_number
from mbocp_papers.so3.accuracy_figure import accuracy_figure, accuracy_file
from mbocp_papers.so3.drift_figure import drift_figure
from mbocp_papers.so3.lattice_figures import bar_figure, convergence_figure, success_figure
from mbocp_papers.so3.path_figures import components_figure, path_figure, path_replay
from mbocp_papers.so3.request import Request, Say, lattice_outcomes

Write = Callable[[Request, Say], list[Path]]


@dataclass(frozen=True)
class FigureSpec:
    """A figure: what it shows, and the function that makes its picture.

    Attributes
    ----------
    title : str
    draw : callable
    page : callable, optional
        Writes what a figure has beside its picture: a replay.
    """

    title: str
    draw: Callable[[Request, Say], Figure]
    page: Write | None = None


def _convergence(request: Request, say: Say) -> Figure:
    return convergence_figure(lattice_outcomes(request, say))


def _success(request: Request, say: Say) -> Figure:
    return success_figure(lattice_outcomes(request, say))


def _bars(name: str, title: str, ylabel: str) -> Callable[[Request, Say], Figure]:
    def draw(request: Request, say: Say) -> Figure:
        return bar_figure(lattice_outcomes(request, say), name, title, ylabel)

    return draw


def _path(number: int) -> tuple[Callable[[Request, Say], Figure], Write]:
    def draw(_request: Request, say: Say) -> Figure:
        return path_figure(number, say)

    def page(request: Request, _say: Say) -> list[Path]:
        return path_replay(number, request)

    return draw, page


FIGURES: Mapping[int, FigureSpec] = {
    3: FigureSpec("iterations over the number of tests", _convergence),
    4: FigureSpec("cost of the solutions", _bars("cost", "Cost", "cost")),
    5: FigureSpec("motion with quaternions: time lapse, replay", *_path(5)),
    6: FigureSpec("motion with rotation matrices: time lapse, replay", *_path(6)),
    7: FigureSpec("components of the quaternion, controls", components_figure),
    8: FigureSpec("rate of success", _success),
    9: FigureSpec("drift off the manifolds", drift_figure),
    10: FigureSpec(
        "iterations to convergence", _bars("iterations", "Iterations to convergence", "iterations")
    ),
    11: FigureSpec("CPU time to convergence", _bars("seconds", "CPU time to convergence", "time")),
    12: FigureSpec("accuracy against the time of an iteration", accuracy_figure, accuracy_file),
}
LATTICE_FIGURES = (3, 4, 8, 10, 11)
_SKETCHES = (1, 2)


def check_figure(number: int) -> None:
    """Refuse a number that no figure with results has.

    Raises
    ------
    InvalidValue
    """
    check_number("--figure", number, FIGURES, _SKETCHES)


def write_figure(number: int, request: Request, say: Say = str) -> list[Path]:
    """Make a figure and write it as so3_fig<number> into the request's folder, which is made if need be."""
    check_figure(number)
    spec, folder = FIGURES[number], request.folder
    with house_style():
        figure = spec.draw(request, say)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [
        save_figure(figure, folder / f"so3_fig{number}{suffix}", dpi=request.dpi)
        for suffix in request.suffixes
    ]
    return paths + (spec.page(request, say) if spec.page is not None else [])
