"""A study's summary as bars: success, iterations, time and cost of each group."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from mbocp.exceptions import StudyError
from mbocp.study.summary import Spread, Summary, TaskGroup
from mbocp.view.figures.style import GREY, PALETTE, house_style, new_figure, plain_text, save_figure

_WIDTH, _BAR, _FRAME = 2.5, 0.3, 1.1  # [inch] of a panel, a bar, and what stands around the bars
_MIN_BARS, _MAX_BARS = 3, 100  # bars for whose height there is room


class _Panel(NamedTuple):
    title: str
    unit: str
    spread: Callable[[TaskGroup], Spread]


def plot_summary(summary: Summary, path: str | Path, *, title: str = "") -> Path:
    """Draw a summary as PNG, PDF or SVG, by the suffix.

    Bars are means, the lines on them reach one standard deviation to either side.

    Raises
    ------
    StudyError
        If there is nothing to draw, or too much.
    ResultFileError
        If the file cannot be written.
    """
    count = len(summary.groups)
    if not count:
        raise StudyError("there are no rows yet, and nothing to draw")
    if count > _MAX_BARS:
        raise StudyError(f"{count} groups are too many for a picture; sum up by less")
    panels = _panels(summary.groups)
    with house_style():
        figure = new_figure(_WIDTH * len(panels) + 1.0, _BAR * max(count, _MIN_BARS) + _FRAME)
        axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
        for i, (panel, place) in enumerate(zip(panels, axes, strict=True)):
            _draw(place, panel, summary.groups, PALETTE[i])
        axes[0].set_yticks(range(count), [plain_text(group.label) for group in summary.groups])
        axes[0].set_ylim(max(count, _MIN_BARS) - 0.5, -0.5)  # the first on top
        axes[0].set_ylabel(plain_text(", ".join(summary.by)))
        if title:
            figure.suptitle(plain_text(title), fontsize=11, fontweight="bold")
        return save_figure(figure, path)


def _panels(groups: Sequence[TaskGroup]) -> list[_Panel]:
    longest = max((g.seconds.mean for g in groups if math.isfinite(g.seconds.mean)), default=0.0)
    unit, scale = ("s", 1.0) if longest >= 1.0 else ("ms", 1e3)

    def seconds(group: TaskGroup) -> Spread:
        return Spread(scale * group.seconds.mean, scale * group.seconds.deviation)

    return [
        _Panel("success", "% of tasks", lambda g: Spread(100 * g.success_rate, math.nan)),
        _Panel("iterations", "", lambda g: g.iterations),
        _Panel("time per task", unit, seconds),
        _Panel("cost", "", lambda g: g.cost),
    ]


def _draw(axes: Axes, panel: _Panel, groups: Sequence[TaskGroup], color: str) -> None:
    spreads = [panel.spread(group) for group in groups]
    means = np.array([spread.mean for spread in spreads])
    deviations = np.array([spread.deviation for spread in spreads])
    places = np.arange(len(groups))
    axes.barh(places, np.nan_to_num(means), height=0.66, color=color, alpha=0.85)
    shown = np.isfinite(means) & np.isfinite(deviations)
    axes.errorbar(
        means[shown], places[shown], xerr=deviations[shown], fmt="none", ecolor="#222222", capsize=2.5, lw=0.9
    )
    for place, mean in zip(places, means, strict=True):
        if not math.isfinite(mean):
            axes.annotate(
                "no success",
                (0, place),
                (3, 0),
                textcoords="offset points",
                va="center",
                color=GREY,
                fontsize=7,
            )
    axes.set_title(panel.title, loc="left")
    axes.set_xlabel(panel.unit)
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]))
    if panel.title == "success":
        axes.set_xlim(0.0, 104.0)
    elif np.all(np.nan_to_num(means) >= 0.0):
        axes.set_xlim(left=0.0)
