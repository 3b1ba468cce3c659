"""Figures 3, 4, 8, 10 and 11 of [Manara2017]_: what came of the lattice, formulation by formulation."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from mbocp._arrays import Array
from mbocp.study import Spread
from mbocp.view.figures.style import GREY, PALETTE, new_figure
from mbocp_papers.so3.outcomes import (
    ELSEWHERE,
    HALF_TURN,
    UPRIGHT,
    Outcomes,
    Runs,
    running_mean,
    settled_after,
)

BAND = 0.04  # of Figure 3

_Q, _DCM = PALETTE[0], PALETTE[1]
_SIZE = (5.2, 3.1)  # [inch]
_UNIT_OF_TIME = 1.0  # [s] longest mean from which on seconds read better than milliseconds


def colour_of(label: str) -> str:
    """Colour of a formulation: blue for quaternions, orange for rotation matrices."""
    return _Q if label.startswith("Q") else _DCM


def bar_figure(outcomes: Outcomes, name: str, title: str, ylabel: str) -> Figure:
    """Mean and standard deviation over the successes, Figures 4, 10 and 11.

    Parameters
    ----------
    outcomes : Outcomes
    name : {"cost", "iterations", "seconds"}
    title, ylabel : str
        The time's unit is chosen here.
    """
    spreads = [runs.spread(name) for runs in outcomes.runs]
    if name == "seconds":
        spreads, unit = _readable(spreads)
        ylabel = f"{ylabel} [{unit}]"
    figure = new_figure(*_SIZE)
    axes = figure.subplots()
    places = np.arange(len(spreads), dtype=float)
    means = np.array([spread.mean for spread in spreads])
    deviations = np.array([spread.deviation for spread in spreads])
    _bars(axes, places, means, outcomes.runs)
    shown = np.isfinite(means) & np.isfinite(deviations)
    axes.errorbar(
        places[shown], means[shown], yerr=deviations[shown], fmt="none", ecolor="#222222", capsize=3, lw=0.9
    )
    for place, spread in zip(places, spreads, strict=True):
        _annotate(axes, float(place), spread)
    _finish(axes, outcomes, title, ylabel)
    _leave_room(axes, means, np.nan_to_num(deviations))
    return figure


def success_figure(outcomes: Outcomes) -> Figure:
    """Rate of success, Figure 8; and, pale, converged solutions that end in another attitude."""
    figure = new_figure(*_SIZE)
    axes = figure.subplots()
    places = np.arange(len(outcomes.runs), dtype=float)
    rates = np.array([100 * runs.success_rate for runs in outcomes.runs])
    _bars(axes, places, rates, outcomes.runs)
    others = np.array(
        [100 * (r.counts[HALF_TURN] + r.counts[ELSEWHERE]) / len(r.ends) for r in outcomes.runs]
    )
    axes.bar(places, others, bottom=rates, width=0.66, color="white", edgecolor=GREY, hatch="////", lw=0.7)
    for place, rate in zip(places, rates, strict=True):
        axes.annotate(
            f"{rate:.1f} %",
            (place, rate),
            (0, -4),
            textcoords="offset points",
            ha="center",
            va="top",
            color="white" if rate > 12 else "#222222",
            fontsize=7,
            fontweight="bold",
        )
    _finish(axes, outcomes, "Rate of success", "tasks solved [%]")
    axes.set_ylim(0.0, 104.0)
    if others.any():
        handles = [Patch(color=GREY), Patch(facecolor="white", edgecolor=GREY, hatch="////")]
        figure.legend(handles, [UPRIGHT, "converged elsewhere"], loc="outside upper right", ncols=2)
    return figure


def convergence_figure(outcomes: Outcomes) -> Figure:
    """Mean number of iterations over the number of tests, with a band of 4 % around the last: Figure 3."""
    count = len(outcomes.runs)
    columns = min(3, count)
    rows = math.ceil(count / columns)
    figure = new_figure(2.5 * columns + 0.4, 1.75 * rows + 0.5)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
    for axes, runs in zip(panels, outcomes.runs, strict=False):
        _convergence(axes, runs)
    for axes in panels[count:]:
        axes.set_visible(False)
    for axes in panels[max(0, count - columns) : count]:
        axes.set_xlabel("number of tests")
    for axes in panels[:count:columns]:
        axes.set_ylabel("mean iterations")
    figure.suptitle(
        f"Iterations over the number of tests, in random order ({outcomes.words}); band: ±4 %", fontsize=8.5
    )
    return figure


def _convergence(axes: Axes, runs: Runs) -> None:
    means = running_mean(runs, "iterations")
    axes.set_title(runs.label)
    if not len(means):
        axes.annotate("no success", (0.5, 0.5), xycoords="axes fraction", ha="center", color=GREY)
        return
    last = float(means[-1])
    axes.axhspan((1 - BAND) * last, (1 + BAND) * last, color="#D9D9D9", lw=0, zorder=0)
    axes.axhline(last, color="#444444", ls=(0, (4, 2)), lw=0.9)
    tests = np.arange(1, len(means) + 1)
    axes.plot(tests, means, color=colour_of(runs.label))
    axes.set_xscale("log")
    settled = settled_after(means, BAND)
    axes.annotate(
        f"{last:.1f}; within 4 % from test {settled}",
        (0.98, 0.04),
        xycoords="axes fraction",
        ha="right",
        fontsize=6.5,
        color="#444444",
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
    )
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]))
    spread = max(float(np.abs(means[len(means) // 20 :] - last).max()), 3 * BAND * last)
    axes.set_ylim(max(0.0, last - 1.25 * spread), last + 1.25 * spread)


def _bars(axes: Axes, places: Array, heights: Array, runs: Sequence[Runs]) -> None:
    colours = [colour_of(one.label) for one in runs]
    axes.bar(places, np.nan_to_num(heights), width=0.66, color=colours, alpha=0.85)


def _annotate(axes: Axes, place: float, spread: Spread) -> None:
    if not math.isfinite(spread.mean):
        text, height = "no success", 0.0
    else:
        text, height = _number(spread), spread.mean + np.nan_to_num(spread.deviation)
    below = spread.mean < 0
    axes.annotate(
        text,
        (place, spread.mean - np.nan_to_num(spread.deviation) if below else height),
        (0, -4 if below else 4),
        textcoords="offset points",
        ha="center",
        va="top" if below else "bottom",
        fontsize=7,
        color="#222222",
    )


def _number(spread: Spread) -> str:
    digits = 0 if abs(spread.mean) >= 100 else 1 if abs(spread.mean) >= 10 else 2
    if math.isnan(spread.deviation):
        return f"{spread.mean:.{digits}f}"
    return f"{spread.mean:.{digits}f} ± {spread.deviation:.{digits}f}"


def _finish(axes: Axes, outcomes: Outcomes, title: str, ylabel: str) -> None:
    axes.set_xticks(range(len(outcomes.runs)), [runs.label for runs in outcomes.runs])
    axes.tick_params(axis="x", length=0)
    axes.grid(visible=False, axis="x")
    axes.set_title(title, loc="left")
    axes.set_ylabel(ylabel)
    axes.set_xlabel(outcomes.words, fontsize=7, color=GREY)
    axes.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))


def _leave_room(axes: Axes, means: Array, deviations: Array) -> None:
    """Between the bars' lines and the frame there are numbers to read."""
    finite = np.isfinite(means)
    if not finite.any():
        return
    low, high = float((means - deviations)[finite].min()), float((means + deviations)[finite].max())
    low, high = min(low, 0.0), max(high, 0.0)
    margin = 0.12 * (high - low or 1.0)
    axes.set_ylim(low - margin if low < 0 else 0.0, high + margin)
    axes.axhline(0.0, color="#555555", lw=0.7)


def _readable(spreads: Sequence[Spread]) -> tuple[list[Spread], str]:
    longest = max((spread.mean for spread in spreads if math.isfinite(spread.mean)), default=0.0)
    if longest >= _UNIT_OF_TIME:
        return list(spreads), "s"
    return [Spread(1e3 * spread.mean, 1e3 * spread.deviation) for spread in spreads], "ms"
