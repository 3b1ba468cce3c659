"""Figure 12 of [Manara2017]_: accuracy of the controls against the time of an iteration."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from mbocp.solution.atomic import replace_file
from mbocp.view.figures.style import GREY, PALETTE, new_figure
from mbocp_papers.so3.accuracy import METHODS, SUFFIXES, Curve, accuracy_curves
from mbocp_papers.so3.request import Request, Say

_CROSSES = 1e4  # where the paper draws what makes no sense
_FLOOR = 1e-16
_TITLES = {"quaternion": "(a) quaternion", "dcm": "(b) DCM"}
_COLOURS = dict(zip((scheme for scheme, _ in METHODS), PALETTE, strict=False))
_LOOKS: dict[str, dict[str, Any]] = {
    "plain": {"ls": "-", "marker": "o", "markerfacecolor": "white"},
    "baumgarte": {"ls": (0, (4, 1.5)), "marker": "s", "markerfacecolor": "white"},
    "munthe_kaas": {"ls": (0, (1, 1.1)), "marker": "D"},
}


def accuracy_figure(request: Request, say: Say = str) -> Figure:
    """Solve what the figure shows, and draw it."""
    return draw_curves(_curves(request.quick, request.workers, say))


def accuracy_file(request: Request, say: Say = str) -> list[Path]:
    """Write the numbers behind the figure as JSON."""
    curves = _curves(request.quick, request.workers, say)
    facts = [
        {"rotations": c.rotations, "integrator": c.label, "points": [p.to_dict() for p in c.points]}
        for c in curves
    ]
    words = json.dumps(facts, indent=1, allow_nan=False) + "\n"
    return [replace_file(request.folder / "so3_fig12.json", words.encode())]


_made: dict[tuple[bool, int | None], list[Curve]] = {}


def _curves(quick: bool, workers: int | None, say: Say) -> list[Curve]:
    """Solved once a process."""
    key = (quick, workers)
    if key not in _made:
        _made[key] = accuracy_curves(quick=quick, workers=workers, say=say)
    return _made[key]


def draw_curves(curves: Sequence[Curve]) -> Figure:
    """Both panels; a point for each number of steps, crosses where nothing sensible was found."""
    figure = new_figure(9.6, 4.4)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, rotations in zip(panels, ("quaternion", "dcm"), strict=True):
        for curve in curves:
            if curve.rotations == rotations:
                _draw(axes, curve)
        axes.set(xscale="log", yscale="log")
        axes.set_title(_TITLES[rotations], loc="left")
        axes.set_xlabel("time of a Newton iteration [ms]")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.axhline(_CROSSES, color=GREY, lw=0.6, zorder=0)
    panels[0].set_ylabel(r"$\|u - u^*\|_2^2$")
    shown = {curve.scheme for curve in curves}
    schemes = [Line2D([], [], color=_COLOURS[scheme], lw=2.5) for scheme, _ in METHODS if scheme in shown]
    names = [word for scheme, word in METHODS if scheme in shown]
    kinds = [Line2D([], [], color="#444444", markersize=4, **_LOOKS[lie]) for lie, _ in SUFFIXES]
    words = ["plain", "+BG (Baumgarte)", "-MK (Munthe-Kaas)"]
    cross = Line2D([], [], color="#444444", ls="none", marker="x", markersize=5)
    figure.legend(
        [*schemes, *kinds, cross],
        [*names, *words, "no meaningful solution"],
        loc="outside lower center",
        ncols=len(schemes) + len(kinds) + 1,
        columnspacing=1.3,
    )
    return figure


def _draw(axes: Axes, curve: Curve) -> None:
    colour, look = _COLOURS[curve.scheme], _LOOKS[curve.lie]
    times = [point.milliseconds for point in curve.points]
    heights = [max(point.accuracy, _FLOOR) if point.is_meaningful else _CROSSES for point in curve.points]
    axes.plot(times, heights, color=colour, ls=look["ls"], lw=1.1, zorder=2)
    for point, x, y in zip(curve.points, times, heights, strict=True):
        if math.isnan(x):
            continue
        if point.is_meaningful:
            face = look.get("markerfacecolor", colour)
            axes.plot(x, y, color=colour, marker=look["marker"], markersize=4, markerfacecolor=face, zorder=3)
        else:
            axes.plot(x, y, color=colour, marker="x", markersize=5.5, zorder=3)
