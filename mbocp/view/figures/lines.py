"""Curves over time: which of them share a panel, and how such a panel is drawn.

Undamped adjoints of index 3 jump to one side and the other of a smooth mean, which is drawn in their place.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes

from mbocp._arrays import Array, dataclass
from mbocp.solution import Column, Solution
from mbocp.view.figures.style import (
    GREY,
    LineStyle,
    calm_limits,
    finish_axes,
    mark_time,
    note_beside_title,
    plain_text,
    shorten,
)
from mbocp.view.marks import in_time

FEW = 4  # curves whose names fit over a panel
_ROUND_OFF = 1e-6  # relative, by which a solver may miss a limit that it keeps
_BAND = 0.2
_FAINT: Any = {"alpha": 0.3, "linewidth": 0.6}
_MAX_STEPS = 60  # beyond, steps are too short to be seen, and dashes too long
SHORT_NOTE = "mean of neighbours; faint: as computed"
_FEWEST = 8  # values of which one can say that they zigzag
_MOST_TIMES = 3
_ALTERNATES = 0.9  # part of the steps at which the sign changes; of noise it is two thirds
_VISIBLE = 0.02  # of the range of the mean: smaller jumps are drawn as they are
_FORCE = "J/m"  # unit of multipliers of positions: newtons


@dataclass(frozen=True, eq=False)
class LinePanel:
    """Several curves over time, in one unit.

    Attributes
    ----------
    title, ylabel : str
    names : tuple of str
        One for each curve.
    t : ndarray, shape (m,)
        Time [s]; of the left ends if `step`.
    values : ndarray, shape (m, len(names))
    step : bool
        Whether the values are constant between the times; then `t` has one entry more.
    limits : ndarray, shape (2, len(names)), or None
        Lower and upper limits, infinite where there are none; dashed.
    faint : ndarray, shape (m, len(names)), or None
        Values as computed, of which `values` are means; drawn faintly where they differ.
    bands : ndarray, shape (m, len(names)), or None
        How far values stray, drawn as bands about the curves; NaN where nobody says.
    """

    title: str
    ylabel: str
    names: tuple[str, ...]
    t: Array
    values: Array
    step: bool = False
    limits: Array | None = None
    faint: Array | None = None
    bands: Array | None = None

    def draw(self, axes: Axes, styles: Sequence[LineStyle]) -> list[Any]:
        """Draw the curves; the caller adds the legend, for which this returns the handles."""
        t, drawstyle = self.t, "default"
        if self.step and len(self.values) <= _MAX_STEPS:
            drawstyle = "steps-post"
        elif self.step:
            t = (t[:-1] + t[1:]) / 2
        values = self._until_the_end(self.values, drawstyle)
        handles = [
            axes.plot(t, values[:, i], drawstyle=drawstyle, **style._asdict())[0]
            for i, style in enumerate(styles)
        ]
        calm_limits(axes, values)
        if self.bands is not None:
            steps: Literal["post"] | None = "post" if drawstyle == "steps-post" else None
            bands = self._until_the_end(self.bands, drawstyle)
            for line, middle, width in zip(handles, values.T, bands.T, strict=True):
                sides = middle - width, middle + width
                axes.fill_between(t, *sides, step=steps, color=line.get_color(), alpha=_BAND, linewidth=0)
        if self.faint is not None:
            axes.set_ylim(axes.get_ylim())  # what is computed may be larger by orders
            faint = self._until_the_end(self.faint, drawstyle)
            for i, style in enumerate(styles):
                if (self.faint[:, i] != self.values[:, i]).any():
                    axes.plot(t, faint[:, i], drawstyle=drawstyle, color=style.color, **_FAINT)
        finish_axes(axes, title=self.title, ylabel=self.ylabel)
        mark_time(axes, self.t)
        self._draw_limits(axes, styles)
        return handles

    def _until_the_end(self, values: Array, drawstyle: str) -> Array:
        """The last value of a step holds until its end."""
        return np.vstack([values, values[-1:]]) if drawstyle == "steps-post" else values

    def _draw_limits(self, axes: Axes, styles: Sequence[LineStyle]) -> None:
        """Draw limits dashed where the motion comes near them; else say where they are."""
        if self.limits is None or not np.isfinite(self.limits).any():
            return
        values = np.nan_to_num(self.values, posinf=0.0, neginf=0.0)
        # Limits far away would squash the curves, and many are no help: then just a note.
        near = np.abs(self.limits) <= 2 * np.max(np.abs(values), axis=0, initial=0.0)
        far = np.isfinite(self.limits) & ~near
        words = []
        if len(np.unique(np.abs(self.limits[near]))) > FEW:
            near, far = np.zeros_like(near), near | far
        elif near.any():
            words.append("limits dashed")
        for limit in np.unique(self.limits[near]):
            owners = np.flatnonzero((near & (self.limits == limit)).any(axis=0))
            color = styles[owners[0]].color if len(owners) == 1 else GREY
            axes.axhline(limit, color=color, linestyle=(0, (6, 3)), linewidth=0.9, alpha=0.8)
        far &= ~np.isin(self.limits, self.limits[near])  # drawn for another curve
        slack = _ROUND_OFF * np.maximum(1.0, np.abs(self.limits))  # infinite where nothing is limited
        outside = (values < self.limits[0] - slack[0]) | (values > self.limits[1] + slack[1])
        if outside.any():
            words.append(f"{np.count_nonzero(outside.any(axis=0))} beyond their limit")
        if far.any():
            nearest = np.abs(self.limits[far]).min()
            sign = "±" if (self.limits[0] == -self.limits[1]).all() else ""
            words.append(f"limits from {sign}{nearest:.3g} not shown")
        note_beside_title(axes, "; ".join(words))


def _groups(columns: Sequence[Column]) -> list[list[int]]:
    """Group columns by unit; where these are many, a joint with several columns ("root_joint.x") apart."""
    groups: dict[tuple[str, str], list[int]] = {}
    for i, column in enumerate(columns):
        groups.setdefault((column.unit, ""), []).append(i)
    for (unit, _), members in list(groups.items()):
        if len(members) > FEW:
            del groups[unit, ""]
            for i in members:
                joint, dot, _ = columns[i].name.rpartition(".")
                alone = not dot or sum(columns[k].name.startswith(joint + ".") for k in members) == 1
                groups.setdefault((unit, "" if alone else joint), []).append(i)
    return list(groups.values())


def line_panels(
    title: str,
    symbol: str,
    columns: Sequence[Column],
    t: Array,
    values: Array,
    *,
    step: bool = False,
    limits: Array | None = None,
    bands: Array | None = None,
) -> list[LinePanel]:
    """Distribute columns over panels by unit; `limits` has the shape (2, columns)."""
    panels = []
    for members in _groups(columns):
        unit = columns[members[0]].unit.replace("^2", "²").replace("^3", "³")
        prefix, names = shorten([columns[i].name for i in members])
        panels.append(
            LinePanel(
                title=plain_text(f"{title}, {prefix}" if prefix else title),
                ylabel=f"{symbol} [{plain_text(unit)}]" if unit not in ("", "1", "-") else symbol,
                names=tuple(plain_text(name) for name in names),
                t=t,
                values=values[:, members],
                step=step,
                limits=None if limits is None else limits[:, members],
                bands=None if bands is None else bands[:, members],
            )
        )
    return panels


def without_zigzag(values: Array) -> Array:
    """Return the columns that zigzag as weighted means of neighbours, the others as they are.

    Means are taken until they zigzag no more, three times at most: each takes away what alternates with an
    amplitude linear in time. The two values at each end, where start and goal have equations of their own,
    follow the line through the next two means.

    Parameters
    ----------
    values : ndarray, shape (m, k)

    Returns
    -------
    ndarray, shape (m, k)
        `values` itself where no column zigzags.
    """
    if len(values) < _FEWEST or not np.isfinite(values).all():
        return values
    means = values
    for _ in range(_MOST_TIMES):
        smoother = _means(means)
        if smoother is means:
            break
        means = smoother
    return means


def _means(values: Array) -> Array:
    jumps = (values[:-2] - 2 * values[1:-1] + values[2:]) / 4
    inner = (values[1:-1] + jumps)[1:-1]
    lead, tail = inner[0] - inner[1], inner[-1] - inner[-2]
    means = np.vstack([inner[0] + 2 * lead, inner[0] + lead, inner, inner[-1] + tail, inner[-1] + 2 * tail])
    alternates = np.mean(jumps[:-1] * jumps[1:] < 0, axis=0) > _ALTERNATES
    visible = np.median(np.abs(jumps), axis=0) > _VISIBLE * np.ptp(means, axis=0)
    found = alternates & visible
    return np.where(found, means, values) if found.any() else values


def force_panels(solution: Solution) -> list[LinePanel]:
    """Return one panel with the size of each force [N]; none where nothing is held, and no force is bounded.

    Impulses are no forces: in steps of no duration the force of the step before goes on.
    """
    asked = {*solution.facts.held, *solution.facts.contacts}
    columns: dict[str, list[int]] = {}
    for k, column in enumerate(solution.labels.lam):
        owner = column.name if column.name in asked else column.name.rpartition(".")[0]
        if owner in asked and column.unit == _FORCE:
            columns.setdefault(owner, []).append(k)
    if not columns:
        return []
    sizes = [np.linalg.norm(solution.lams[:, found], axis=1) for found in columns.values()]
    values = in_time(np.column_stack(sizes), np.diff(solution.t))
    names = tuple(plain_text(name) for name in columns)
    return [LinePanel("Forces of constraints", "$|f|$ [N]", names, solution.t, values, step=True)]
