"""Figures 6, 7 and 8: the pendulums on a cart."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mbocp._arrays import Array
from mbocp_papers.pendulums import figure_space as space
from mbocp_papers.pendulums.cart_pictures import draw_manoeuvre, draw_snapshot
from mbocp_papers.pendulums.figure_parts import (
    FBSM,
    LINES,
    MONOLITHIC,
    components,
    finish_panel,
    look_legend,
    page,
    remark,
    round_off,
)
from mbocp_papers.pendulums.motions import Motion, Pair, Say, motion_pair, penalty_or_lagrange

_COORDINATES = ("1", "3", "4")  # q_1: cart, (q_3, q_4): bob; q_2 = 0 is the rail
_SNAPSHOTS = (0.0, 0.2, 0.5, 1.0, 2.0)  # [s]


def figure_6(say: Say = str) -> Figure:
    """Rigid rod: state, adjoint, control, constraint violation, control Hamiltonian, control momenta."""
    pair = motion_pair("cart_pendulum_rigid", "tracking", say)
    figure, grid = page((2.4, 2.4, 2.5, 2.2))
    _common_panels(figure, grid, pair)
    _violation(figure.add_subplot(grid[2, 1]), pair)
    _hamiltonian(figure.add_subplot(grid[3, 0]), "g", pair)
    _momenta(figure.add_subplot(grid[3, 1]), pair)
    look_legend(figure, [MONOLITHIC, FBSM])
    remark(figure, "Fig. 6   2D rigid pendulum on a cart: optimal trajectories", [pair.remark])
    return figure


def figure_7(say: Say = str) -> Figure:
    """Rigid rod: path over the constraint manifold, and snapshots."""
    motion = penalty_or_lagrange("cart_pendulum_rigid", "tracking", say)
    figure = Figure(figsize=(10.0, 6.8), layout="constrained")
    grid = figure.add_gridspec(2, 5, height_ratios=(4.2, 2.0))
    _path_on_manifold(figure.add_subplot(grid[0, :], projection="3d"), motion)
    for i, (letter, t) in enumerate(zip("bcdef", _SNAPSHOTS, strict=True)):
        draw_snapshot(figure.add_subplot(grid[1, i]), letter, motion, t, first=i == 0)
    remark(figure, "Fig. 7   2D rigid pendulum on a cart: constraint manifold and snapshots", [])
    return figure


def figure_8(say: Say = str) -> Figure:
    """Elastic spring: state, adjoint, control, control Hamiltonian."""
    pair = motion_pair("cart_pendulum_elastic", "tracking", say)
    figure, grid = page((2.4, 2.4, 2.5))
    _common_panels(figure, grid, pair)
    _hamiltonian(figure.add_subplot(grid[2, 1]), "f", pair)
    look_legend(figure, [MONOLITHIC, FBSM])
    remark(figure, "Fig. 8   2D elastic pendulum on a cart: optimal trajectories", [pair.remark])
    return figure


def _common_panels(figure: Figure, grid: Any, pair: Pair) -> None:
    """Panels (a) to (e)."""
    t = pair.monolithic.t
    panels: list[tuple[Any, str, str, str, str, Callable[[Motion], Array]]] = [
        (grid[0, 0], "a", "position", "$q$ [m]", "q", lambda m: m.solution.qs),
        (grid[0, 1], "b", "momentum", "$p$ [kg m/s]", "p", lambda m: m.solution.ps),
        (
            grid[1, 0],
            "c",
            "adjoint of the position",
            r"$\mu^q$ [cost/m]",
            r"\mu^q",
            lambda m: m.mu_q * m.scale,
        ),
        (
            grid[1, 1],
            "d",
            "adjoint of the momentum",
            r"$\mu^p$ [cost/(kg m/s)]",
            r"\mu^p",
            lambda m: m.mu_p * m.scale,
        ),
    ]
    for place, letter, title, ylabel, symbol, values in panels:
        axes = figure.add_subplot(place)
        handles = _curves(axes, pair, lambda m: m.t, values)
        finish_panel(axes, letter, title, ylabel, t, handles, [f"${symbol}_{c}$" for c in _COORDINATES])
    axes = figure.add_subplot(grid[2, 0])
    _curves(axes, pair, lambda m: m.t[:-1], lambda m: m.solution.us)
    finish_panel(axes, "e", "control force, and the manoeuvre", "$u$ [N]", t, [], [])
    draw_manoeuvre(axes.inset_axes((0.36, 0.42, 0.64, 0.58)), pair.monolithic)


def _curves(
    axes: Axes, pair: Pair, times: Callable[[Motion], Array], values: Callable[[Motion], Array]
) -> list[Line2D]:
    handles = components(axes, times(pair.monolithic), values(pair.monolithic), MONOLITHIC)
    if pair.fbsm is not None:
        components(axes, times(pair.fbsm), values(pair.fbsm), FBSM)
    return handles


def _hamiltonian(axes: Axes, letter: str, pair: Pair) -> None:
    _curves(axes, pair, lambda m: m.t[:-1], lambda m: m.hamiltonian[:, None] * m.scale)
    finish_panel(axes, letter, "control Hamiltonian", r"$\mathcal{H}$ [cost/s]", pair.monolithic.t, [], [])


def _violation(axes: Axes, pair: Pair) -> None:
    curves = [("Monolithic", "lines", pair.monolithic.violation[:, 0])]
    if pair.fbsm is not None:
        curves.append(("FBSM-Newton", "fbsm", pair.fbsm.violation[:, 0]))
    round_off(axes, pair.monolithic.t, curves, "f", "holonomic constraint")


def _momenta(axes: Axes, pair: Pair) -> None:
    """Control angular momentum about y, which gravity does not keep; control momentum along x, which is."""
    handles = _curves(axes, pair, lambda m: m.t, _planar_momenta)
    names = [r"$\xi_y$", r"$\mu^q_1 + \mu^q_3$ (translation)"]
    finish_panel(axes, "h", "control angular momentum", r"$\xi$ [cost]", pair.monolithic.t, handles, names)


def _planar_momenta(m: Motion) -> Array:
    """Eq. (15) in the plane: xi_y of cart and bob, and the sum of the adjoints along the rail."""
    _, q3, q4 = m.solution.qs.T
    _, p3, p4 = m.solution.ps.T
    (a1, a3, a4), (_, b3, b4) = m.mu_q.T * m.scale, m.mu_p.T * m.scale
    # The cart stays on z = 0 and its vertical adjoints are zero: it contributes nothing.
    return np.column_stack([q4 * a3 - q3 * a4 + p4 * b3 - p3 * b4, a1 + a3])


def _path_on_manifold(axes: Any, motion: Motion) -> None:
    s = motion.solution
    length = float(np.hypot(s.qs[0, 1] - s.qs[0, 0], s.qs[0, 2]))
    low, high = float(s.qs[:, 0].min()), float(s.qs[:, 0].max())
    space.tilted_tube(axes, length, (low - 0.15, high + 0.15))
    space.draw_path(axes, s.qs, s.vs, LINES[1], 0.45, num=9)
    space.draw_ends(axes, s.qs, LINES[1])
    lower = np.array([low - 0.2, low - length - 0.2, -length - 0.1])
    upper = np.array([high + 0.2, high + length + 0.2, length + 0.1])
    space.equal_box(axes, lower, upper, 1.25, stretch=(2.5, 1.0, 1.0))
    names = ("$q_1$ [m]", "$q_3$ [m]", "$q_4$ [m]")
    space.finish_space(axes, "(a) path on the manifold, arrows: velocity", names, (38, -66))
