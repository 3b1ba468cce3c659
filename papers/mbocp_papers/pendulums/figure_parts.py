"""What the paper's figures share: components as lines and markers, panel titles, one legend a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from mbocp._arrays import Array
from mbocp.view.figures.style import GREY, PALETTE, calm_limits, finish_axes, mark_time, strip_legend

_DASHES: tuple[Any, ...] = ("-", (0, (5, 1.6)), (0, (1.2, 1.1)), (0, (5, 1.2, 1, 1.2)))
_SHAPES = {"fbsm": (">", "s", "o", "d"), "other": ("D", "*", (6, 2, 0), "P")}
_SIZES = {">": 4.6, "s": 4.2, "o": 4.2, "d": 4.6, "D": 3.8, "*": 7.5, (6, 2, 0): 5.6, "P": 4.6}
_MARKS = 13  # along a curve
LINES = PALETTE[:4]


@dataclass(frozen=True)
class Look:
    """How the curves of one way to solve are drawn: "lines", "fbsm" (open markers) or "other" (filled)."""

    name: str
    kind: str


MONOLITHIC = Look("Monolithic", "lines")
FBSM = Look("FBSM-Newton", "fbsm")


def components(
    axes: Axes, t: Array, values: Array, look: Look, colors: Sequence[str] = LINES
) -> list[Line2D]:
    """Draw the columns of `values` over `t`; markers stand at some of the nodes only."""
    handles = []
    for i in range(values.shape[1]):
        if look.kind == "lines":
            (line,) = axes.plot(t, values[:, i], color=colors[i], linestyle=_DASHES[i], linewidth=1.3)
        else:
            at = marks(len(t), look.kind, i)
            (line,) = axes.plot(t[at], values[at, i], **marker_style(look.kind, i, colors[i]))
        handles.append(line)
    return handles


def marks(num: int, kind: str, component: int) -> Array:
    """Nodes that bear a marker; those of different kinds and components are apart."""
    apart = num / _MARKS
    first = apart * (0.15 + 0.12 * component + (0.5 if kind == "other" else 0.0))
    return np.unique(np.clip(np.round(first + apart * np.arange(_MARKS)), 0, num - 1).astype(int))


def marker_style(kind: str, component: int, color: str) -> dict[str, Any]:
    """Open markers of the paper for FBSM-Newton, filled ones for the other form."""
    shape = _SHAPES[kind][component]
    return {
        "linestyle": "none",
        "marker": shape,
        "markersize": _SIZES[shape],
        "color": color,
        "markerfacecolor": "white" if kind == "fbsm" else color,
        "markeredgewidth": 0.9 if kind == "fbsm" or shape == (6, 2, 0) else 0.3,
        "markeredgecolor": color if kind == "fbsm" or shape == (6, 2, 0) else "white",
        "zorder": 3,
    }


def round_off(
    axes: Axes, t: Array, curves: Sequence[tuple[str, str, Array]], letter: str, title: str
) -> None:
    """Draw what is zero up to round-off: points and no lines, in a scale of its own.

    Parameters
    ----------
    curves : sequence of (name, look, values)
    """
    largest = max(float(np.abs(values).max()) for *_, values in curves)
    power = math.floor(math.log10(max(largest, 1e-16)))
    handles = []
    for i, (_, kind, values) in enumerate(curves):
        size = {"lines": 3.0, "fbsm": 3.6, "other": 2.4}[kind]
        (points,) = axes.plot(
            t,
            values / 10.0**power,
            linestyle="none",
            marker={"lines": ".", "fbsm": "o", "other": "D"}[kind],
            markersize=size,
            color=LINES[i],
            markerfacecolor="none" if kind == "fbsm" else LINES[i],
            markeredgewidth=0.6,
            zorder=3 - 0.1 * size,
        )
        handles.append(points)
    finish_axes(axes, title=f"({letter}) {title}", ylabel=rf"$\Phi(q)$ [$10^{{{power}}}$ m$^2$]")
    mark_time(axes, t)
    limit = 1.3 * max(largest / 10.0**power, 1.0)
    axes.set_ylim(-limit, limit)
    strip_legend(axes, handles, [name for name, *_ in curves])


def finish_panel(
    axes: Axes,
    letter: str,
    title: str,
    ylabel: str,
    t: Array,
    handles: Sequence[Line2D],
    names: Sequence[str],
) -> None:
    """Title with the paper's letter, labels, names of the components above the axes."""
    finish_axes(axes, title=f"({letter}) {title}", ylabel=ylabel)
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
    mark_time(axes, t)
    shown = [np.asarray(line.get_ydata(), dtype=float) for line in axes.get_lines()]
    if shown:
        calm_limits(axes, np.concatenate(shown))
    if names:
        strip_legend(axes, handles, names)


def look_legend(figure: Figure, looks: Sequence[Look], count: int = 3) -> None:
    """One legend below everything: what lines, open and filled markers stand for."""
    handles: list[Any] = []
    for look in looks:
        if look.kind == "lines":
            handles.append(tuple(Line2D([], [], color=LINES[i], linestyle=_DASHES[i]) for i in range(count)))
        else:
            handles.append(
                tuple(Line2D([], [], **marker_style(look.kind, i, LINES[i])) for i in range(count))
            )
    figure.legend(
        handles,
        [look.name for look in looks],
        loc="outside lower center",
        ncols=len(looks),
        handler_map={tuple: HandlerTuple(ndivide=None, pad=0.6)},
        handlelength=6.5,
        columnspacing=3.0,
        fontsize=9,
    )


def page(heights: Sequence[float], columns: int = 2) -> tuple[Figure, Any]:
    """Figure with a grid of panels; `heights` of the rows [inch]."""
    figure = Figure(figsize=(4.0 * columns, sum(heights) + 0.8), layout="constrained")
    return figure, figure.add_gridspec(len(heights), columns, height_ratios=heights)


def remark(figure: Figure, title: str, words: Sequence[str]) -> None:
    """Title of the page; remarks in small letters below it."""
    figure.suptitle(title, fontsize=11, fontweight="bold")
    said = [word for word in words if word]
    if said:
        figure.text(0.005, 0.002, "; ".join(said), fontsize=6.5, color=GREY, ha="left", va="bottom")
