"""Figures 2, 3 and 4: the pendulums in space."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mbocp._arrays import Array
from mbocp_papers.pendulums import figure_space as space
from mbocp_papers.pendulums.figure_parts import (
    FBSM,
    LINES,
    MONOLITHIC,
    Look,
    components,
    finish_panel,
    look_legend,
    page,
    remark,
    round_off,
)
from mbocp_papers.pendulums.motions import Motion, Pair, Say, free_space, motion_pair, penalty_or_lagrange

_SPACE = ("$x$ [m]", "$y$ [m]", "$z$ [m]")


def figure_2(say: Say = str) -> Figure:
    """3D elastic pendulum: state, adjoint, control, path, control Hamiltonian, control angular momentum."""
    pair = motion_pair("elastic_pendulum", "lagrange", say)
    penalty = penalty_or_lagrange("elastic_pendulum", "penalty", say)
    figure, grid = page((2.3, 2.3, 3.3, 2.1))
    _time_panels(figure, grid, pair, penalty)
    _path_in_space(figure.add_subplot(grid[2, 1], projection="3d"), pair)
    looks = [MONOLITHIC, FBSM, Look("penalty form, scaled with $1/\\alpha$", "other")]
    look_legend(figure, looks)
    remark(figure, "Fig. 2   Minimal effort manoeuvring of the 3D elastic pendulum", [pair.remark])
    return figure


def figure_3(say: Say = str) -> Figure:
    """3D rigid pendulum, penalty form; the Lagrange form as filled markers."""
    pair = motion_pair("rigid_pendulum", "penalty", say)
    lagrange = penalty_or_lagrange("rigid_pendulum", "lagrange", say)
    figure, grid = page((2.4, 2.4, 2.4, 2.2))
    _time_panels(figure, grid, pair, lagrange)
    _violation(figure.add_subplot(grid[2, 1]), pair, lagrange)
    looks = [MONOLITHIC, FBSM, Look("Lagrange form", "other")]
    look_legend(figure, looks)
    remark(figure, "Fig. 3   Minimal effort manoeuvring of the 3D rigid pendulum", [pair.remark])
    return figure


def figure_4(say: Say = str) -> Figure:
    """3D rigid pendulum in free space: control angular momentum, and both paths on the sphere."""
    gravity = penalty_or_lagrange("rigid_pendulum", "lagrange", say)
    free = free_space(say)
    figure = Figure(figsize=(8.4, 4.2), layout="constrained")
    grid = figure.add_gridspec(1, 2, width_ratios=(1, 1.1))
    axes = figure.add_subplot(grid[0])
    handles = _curves(axes, free, None, lambda m: m.t, lambda m: m.xi)
    names = [rf"$\xi_{c}$" for c in "xyz"]
    t = free.monolithic.t
    finish_panel(axes, "a", "control angular momentum, $a = 0$", r"$\xi$ [cost]", t, handles, names)
    drift = float(np.abs(free.monolithic.xi - free.monolithic.xi[0]).max())
    axes.annotate(
        f"largest change {drift:.0e}", (0.97, 0.66), xycoords="axes fraction", ha="right", fontsize=8
    )
    _paths_on_sphere(figure.add_subplot(grid[1], projection="3d"), gravity, free)
    look_legend(figure, [MONOLITHIC, FBSM])
    remark(figure, "Fig. 4   The 3D rigid pendulum in free space", [free.remark])
    return figure


def _time_panels(figure: Figure, grid: Any, pair: Pair, other: Motion) -> None:
    """Panels (a) to (e), (g), (h), which Figures 2 and 3 have in common."""
    t, scaled = pair.monolithic.t, "" if pair.monolithic.scale == 1.0 else "/\\alpha"
    panels: list[tuple[Any, str, str, str, str, Callable[[Motion], Array]]] = [
        (grid[0, 0], "a", "position", "$q$ [m]", "q", lambda m: m.solution.qs),
        (grid[0, 1], "b", "momentum", "$p$ [kg m/s]", "p", lambda m: m.solution.ps),
        (
            grid[1, 0],
            "c",
            "adjoint of the position",
            rf"$\mu^q{scaled}$ [cost/m]",
            r"\mu^q",
            lambda m: m.mu_q,
        ),
        (
            grid[1, 1],
            "d",
            "adjoint of the momentum",
            rf"$\mu^p{scaled}$ [cost/(kg m/s)]",
            r"\mu^p",
            lambda m: m.mu_p,
        ),
    ]
    for place, letter, title, ylabel, symbol, values in panels:
        axes = figure.add_subplot(place)
        handles = _curves(axes, pair, other, lambda m: m.t, values)
        finish_panel(axes, letter, title, ylabel, t, handles, [f"${symbol}_{c}$" for c in "xyz"])
    axes = figure.add_subplot(grid[2, 0])
    handles = _curves(axes, pair, other, lambda m: m.t[:-1], lambda m: m.solution.us)
    finish_panel(axes, "e", "control", "$u$ [N]", t, handles, [f"$u_{c}$" for c in "xyz"])
    axes = figure.add_subplot(grid[3, 0])
    _curves(axes, pair, other, lambda m: m.t[:-1], lambda m: m.hamiltonian[:, None])
    finish_panel(axes, "g", "control Hamiltonian", rf"$\mathcal{{H}}{scaled}$ [cost/s]", t, [], [])
    axes = figure.add_subplot(grid[3, 1])
    handles = _curves(axes, pair, other, lambda m: m.t, lambda m: m.xi)
    names = [rf"$\xi_{c}$" for c in "xyz"]
    finish_panel(axes, "h", "control angular momentum", rf"$\xi{scaled}$ [cost]", t, handles, names)


def _curves(
    axes: Any,
    pair: Pair,
    other: Motion | None,
    times: Callable[[Motion], Array],
    values: Callable[[Motion], Array],
) -> list[Line2D]:
    """Lines for the monolithic solver, open markers for FBSM-Newton, filled ones for the other form."""
    handles = components(axes, times(pair.monolithic), values(pair.monolithic), MONOLITHIC)
    if pair.fbsm is not None:
        components(axes, times(pair.fbsm), values(pair.fbsm), FBSM)
    if other is not None:
        components(axes, times(other), values(other), Look("", "other"))
    return handles


def _path_in_space(axes: Any, pair: Pair) -> None:
    s = pair.monolithic.solution
    path, color = s.qs, LINES[0]
    lower = path.min(axis=0) - np.array([1.5, 0.5, 1.5])
    upper = path.max(axis=0) + np.array([1.5, 1.0, 1.0])
    space.ground_projection(axes, path, lower[2])
    space.draw_path(axes, path, s.ps, color, 0.3 * float((upper - lower).max()))
    if pair.fbsm is not None:
        space.draw_markers(axes, pair.fbsm.solution.qs, color)
    space.draw_ends(axes, path, color)
    space.equal_box(axes, lower, upper, 1.1)
    space.finish_space(axes, "(f) path, arrows: momentum", _SPACE, (24, -55))


def _paths_on_sphere(axes: Any, gravity: Motion, free: Pair) -> None:
    radius = float(np.linalg.norm(gravity.solution.qs[0]))
    space.sphere(axes, radius)
    handles = []
    for motion, color, width in ((gravity, LINES[0], 4.0), (free.monolithic, LINES[1], 1.6)):
        s = motion.solution
        handles.append(space.draw_path(axes, s.qs, s.ps, color, 0.5 * radius, num=7, width=width))
        space.draw_ends(axes, s.qs, color)
    if free.fbsm is not None:
        space.draw_markers(axes, free.fbsm.solution.qs, LINES[1])
    limit = np.full(3, 1.08 * radius)
    space.equal_box(axes, -limit, limit, 1.15)
    space.finish_space(axes, "(b) paths on the sphere, arrows: momentum", _SPACE, (2, 28))
    names = [f"gravity, $a = {-gravity.problem.robot.model.gravity.linear[2]:g}$ m/s²", "free space, $a = 0$"]
    axes.legend(handles, names, loc="upper right", bbox_to_anchor=(1.12, 1.02))


def _violation(axes: Any, pair: Pair, other: Motion) -> None:
    curves = [("Monolithic", "lines", pair.monolithic.violation[:, 0])]
    if pair.fbsm is not None:
        curves.append(("FBSM-Newton", "fbsm", pair.fbsm.violation[:, 0]))
    curves.append(("Lagrange form", "other", other.violation[:, 0]))
    round_off(axes, pair.monolithic.t, curves, "f", "holonomic constraint")
