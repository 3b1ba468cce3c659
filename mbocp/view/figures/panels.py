"""The panels that pictures of a solution are put together from: each draws into the axes it is given."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from mbocp._arrays import Array
from mbocp.mechanics.motion_rates import rates_along
from mbocp.robot import Robot
from mbocp.solution import Column, Solution
from mbocp.solution.details import dual_columns
from mbocp.terms.rates import RATE_TERMS
from mbocp.view.figures.lines import SHORT_NOTE, LinePanel, force_panels, line_panels, without_zigzag
from mbocp.view.figures.style import (
    GREY,
    PALETTE,
    calm_limits,
    finish_axes,
    line_style,
    mark_time,
    note_beside_title,
    plain_text,
    strip_legend,
)

_MAX_CONSTRAINTS = 6  # more would need a legend that is larger than the plot
_FINE = 4  # pieces in which the polynomial of a step is drawn
_MAX_MARKERS = 40  # more merge into a band
_MOST_ROWS = 8  # of path constraints in a panel
_PULLS = 1e-6  # part of the largest multiplier
_RATES = {  # title and symbol, by key in [limits]
    "acceleration": ("Acceleration", r"$\Delta v / \Delta t$"),
    "jerk": ("Jerk", r"$\Delta a / \Delta t$"),
    "effort_rate": ("Rate of the control", r"$\Delta u / \Delta t$"),
    "power": ("Power", "$P$"),
}


def state_panels(solution: Solution) -> list[LinePanel]:
    """Return the configuration, a panel for each unit."""
    columns, values = _with_angles(solution.labels.q, solution.qs)
    places = {column.name: i for i, column in enumerate(solution.labels.q)}
    free = np.array([-np.inf, np.inf])  # what became an angle has no limits
    limits = [solution.limits_q[:, places[c.name]] if c.name in places else free for c in columns]
    shown = np.column_stack(limits) if limits else None
    bands = _bands(solution, "q", [c.name for c in columns], [c.name for c in solution.labels.v])
    return line_panels("Configuration", "$q$", columns, solution.t, values, limits=shown, bands=bands)


def _bands(
    solution: Solution, letter: str, shown: Sequence[str] = (), names: Sequence[str] = ()
) -> Array | None:
    """How far a robust motion strays from its plan; of shown columns that have no name, nothing is known."""
    spread: Array = solution.sigmas * getattr(solution, f"sigma_{letter}s")
    if not spread.size or not shown:
        return spread if spread.size else None
    unknown = np.full(len(spread), np.nan)
    places = dict(zip(names, spread.T, strict=True))
    return np.column_stack([places.get(name, unknown) for name in shown])


def _with_angles(columns: Sequence[Column], values: Array) -> tuple[list[Column], Array]:
    """Put one angle, without jumps, in the place of the cos and sin of a joint that turns without end."""
    names = [column.name for column in columns]
    angles, curves = [], []
    for i, column in enumerate(columns):
        joint, _, suffix = column.name.rpartition(".")
        if joint and suffix == "cos" and names[i + 1 : i + 2] == [f"{joint}.sin"]:
            alone = sum(name.startswith(f"{joint}.") for name in names) == 2
            angles.append(Column(joint if alone else f"{joint}.angle", "rad"))
            curves.append(np.unwrap(np.arctan2(values[:, i + 1], values[:, i])))
        elif not (joint and suffix == "sin" and i and names[i - 1] == f"{joint}.cos"):
            angles.append(column)
            curves.append(values[:, i])
    return angles, np.column_stack(curves) if curves else values


def rate_panels(solution: Solution, rate: str) -> list[LinePanel]:
    """Return velocity ("v") or momentum ("p"), a panel for each unit."""
    if rate == "p":
        return line_panels("Momentum", "$p$", solution.labels.p, solution.t, solution.ps)
    labels, limits = solution.labels.v, solution.limits_v
    bands = _bands(solution, "v")
    return line_panels("Velocity", "$v$", labels, solution.t, solution.vs, limits=limits, bands=bands)


def control_panels(solution: Solution) -> list[LinePanel]:
    """Return the controls, a panel for each unit, with the limits that the problem enforces."""
    labels, limits = solution.labels.u, solution.limits_u
    if solution.has_constant_controls:
        bands, us = _bands(solution, "u"), solution.us
        return line_panels("Control", "$u$", labels, solution.t, us, step=True, limits=limits, bands=bands)
    t, values = _within_steps(solution)
    return line_panels("Control", "$u$", labels, t, values, limits=limits)


def _within_steps(solution: Solution) -> tuple[Array, Array]:
    """Times and controls that draw the polynomials of all steps; where controls leap a time comes twice."""
    inner = np.linspace(0.0, 1.0, _FINE + 1)
    values = solution.controls_within(inner)
    times = solution.t[:-1, None] + np.outer(np.diff(solution.t), inner)
    return times.ravel(), values.reshape(times.size, -1)


def rate_limit_panels(
    solution: Solution, robot: Robot | None = None, always: Collection[str] = ()
) -> list[LinePanel]:
    """Return accelerations, jerks and rates of controls that the problem limits, and powers with `robot`.

    `always`: keys of `mbocp.terms.RATE_TERMS` that are shown without limits, too.
    """
    found, facts = [], solution.facts
    keys = [key for key in RATE_TERMS if key in facts.rates or key in always]
    if not keys:
        return []
    linear = solution.u_values if solution.has_linear_controls else None
    ends = solution.us_at_ends
    before = np.array(facts.a_start) if facts.a_start else None
    motion = (solution.qs, solution.vs, solution.us, np.diff(solution.t), ends, linear)
    control = np.array(facts.u_start) if facts.u_start else None
    rates = rates_along(robot, *motion, before, control)
    for key in keys:
        term = RATE_TERMS[key]
        labels = solution.labels.v if term.over == "v" else solution.labels.u
        if key not in rates:
            continue
        none = np.outer([-np.inf, np.inf], np.ones(len(labels)))
        limits = facts.bounds_of_rate(key) if key in facts.rates else none
        columns = [Column(column.name, term.unit(column.unit)) for column in labels]
        title, symbol = _RATES[key]
        found += line_panels(title, symbol, columns, solution.t, rates[key], step=True, limits=limits)
    return found


def multiplier_panels(solution: Solution) -> list[LinePanel]:
    """Return forces, adjoints mu of q and p, lambda, zeta, multipliers of active limits, a panel each."""
    labels, nv, t = solution.labels, solution.nv, solution.t
    blocks = [
        ("Adjoint of the configuration", r"$\mu^q$", labels.mu[:nv], solution.mus[:, :nv], False),
        ("Adjoint of the momentum", r"$\mu^p$", labels.mu[nv:], solution.mus[:, nv:], False),
        ("Constraint multiplier", r"$\lambda$", labels.lam, solution.lams, True),
        ("Adjoint of the constraint", r"$\zeta$", labels.zeta, solution.zetas, True),
    ]
    found = [
        panel
        for title, symbol, columns, values, step in blocks
        if values.shape[1]
        for panel in line_panels(title, symbol, columns, t, values, step=step)
    ]
    return [*force_panels(solution), *(_calm(panel) for panel in found), *_limit_panels(solution)]


def _calm(panel: LinePanel) -> LinePanel:
    """A panel with the means of curves that zigzag before the curves themselves."""
    means = without_zigzag(panel.values)
    return panel if means is panel.values else replace(panel, values=means, faint=panel.values)


def _limit_panels(solution: Solution) -> list[LinePanel]:
    """Return the multipliers of limits and path constraints that are active."""
    labels, t = solution.labels, solution.t
    rows, path_title = _find_pulling_rows(solution)
    names = tuple(Column(solution.path_names[row], "") for row in rows)
    title = "Multiplier of the"
    blocks = [
        ("control", f"{title} limits of u", r"$\lambda^u$", dual_columns(labels.u), t, solution.lam_us),
        ("velocity", f"{title} limits of v", r"$\lambda^v$", dual_columns(labels.v), t, solution.lam_vs),
        ("position", f"{title} limits of q", r"$\lambda^q$", dual_columns(labels.q), t, solution.lam_qs),
        ("path", f"{title} {path_title}", r"$\lambda^h$", names, t[1:], solution.lam_path[:, rows]),
    ]
    active = {limit.kind for limit in solution.active_limits}  # the others are left over by the barrier
    active |= {"path"} if active & set(RATE_TERMS) else set()  # they are rows among those of the path
    return [
        panel
        for kind, words, symbol, columns, times, values in blocks
        if kind in active
        for panel in line_panels(words, symbol, columns, times, values, step=kind == "control")
        if _largest(panel.values) > _PULLS * _largest(values)  # the rest is what a barrier leaves over
    ]


def _largest(values: Array) -> float:
    return float(np.abs(np.nan_to_num(values)).max(initial=0.0))


def _find_pulling_rows(solution: Solution) -> tuple[list[int], str]:
    """Rows of path constraints with multipliers beyond what a barrier leaves over, and what they are called.

    Of many the largest: obstacles alone bring a hundred rows, most of them zero.
    """
    sizes = np.abs(np.nan_to_num(solution.lam_path)).max(axis=0, initial=0.0)
    rows = np.flatnonzero(sizes > _PULLS * sizes.max(initial=0.0))
    if len(rows) <= _MOST_ROWS:
        return [int(row) for row in rows], "path"
    largest = np.sort(rows[np.argsort(-sizes[rows], kind="stable")[:_MOST_ROWS]])
    return [int(row) for row in largest], f"path, {_MOST_ROWS} of {len(rows)}"


def _log_curve(axes: Axes, x: Array, y: Array, label: str, index: int, marker: str = "") -> None:
    if len(x) > _MAX_MARKERS:
        marker = ""
    positive = np.where(np.isfinite(y) & (y > 0), y, np.nan)
    if np.isfinite(positive).any():
        axes.semilogy(x, positive, marker=marker, markersize=3.5, label=label, **line_style(index)._asdict())


def _log_points(axes: Axes, x: Array, y: Array, label: str, index: int) -> None:
    """Draw points and no line: round-off jumps, and is often exactly zero, which no logarithm shows."""
    shown = np.isfinite(y) & (y > 0)
    if shown.any():
        color = line_style(index).color
        axes.semilogy(
            x[shown], y[shown], linestyle="none", marker=".", markersize=3, color=color, label=label
        )


def _empty(axes: Axes, words: str) -> None:
    axes.annotate(words, (0.5, 0.5), xycoords="axes fraction", ha="center", va="center", color=GREY)


def _mark_solves(axes: Axes, solution: Solution) -> None:
    """Draw a line where each further solve begins, and say how many there were."""
    counts = [phase.iterations + 1 for phase in solution.phases if phase.iterations]
    if len(counts) > 1:
        for first in np.cumsum(counts)[:-1]:
            axes.axvline(first - 0.5, color=GREY, linewidth=0.6, linestyle=":", zorder=0)
        note_beside_title(axes, f"{len(counts)} solves, one after the other")


def draw_convergence(solution: Solution, axes: Axes) -> None:
    """Draw residual and increment over the iterations."""
    k = np.arange(float(len(solution.history)))
    _mark_solves(axes, solution)
    for index, (name, marker) in enumerate({"residual": "o", "increment": "s"}.items()):
        y = np.array([getattr(record, name) for record in solution.history], dtype=float)
        _log_curve(axes, k, y, name, index, marker)
    tolerance = solution.options.get("tolerance")
    handles, labels = axes.get_legend_handles_labels()
    if handles and isinstance(tolerance, float) and tolerance > 0:
        handles.append(axes.axhline(tolerance, color=GREY, linestyle="--", linewidth=0.9))
        labels.append("tolerance")
    finish_axes(axes, title="Convergence", ylabel="Euclidean norm", xlabel="iteration")
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    if handles:
        strip_legend(axes, handles, labels)
    else:
        _empty(axes, "no history")


def draw_cost(solution: Solution, axes: Axes) -> None:
    """Draw the cost over the iterations."""
    cost = np.array([record.cost for record in solution.history], dtype=float)
    marker = "o" if len(cost) <= _MAX_MARKERS else ""
    axes.plot(np.arange(len(cost)), cost, marker=marker, markersize=3.5, color=PALETTE[0])
    calm_limits(axes, cost)
    finish_axes(axes, title="Cost", ylabel="$J$", xlabel="iteration")
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))


def draw_hamiltonian(solution: Solution, axes: Axes) -> None:
    """Draw the control Hamiltonian over time."""
    values = solution.control_hamiltonians
    means = without_zigzag(values[:, None])[:, 0]
    axes.plot(solution.t[:-1], means, color=PALETTE[0])
    calm_limits(axes, values)
    if (means != values).any() and np.isfinite(values).all():
        axes.plot(solution.t[:-1], values, color=PALETTE[0], alpha=0.3, linewidth=0.6)
        note_beside_title(axes, SHORT_NOTE)
    finish_axes(axes, title="Control Hamiltonian", ylabel=r"$\mathcal{H}$ [cost/s]")
    mark_time(axes, solution.t)
    if not np.isfinite(values).any():
        _empty(axes, "not evaluated")


def momentum_panel(solution: Solution) -> LinePanel:
    """Return the control momenta over time, a curve for each symmetry."""
    return LinePanel(
        "Control momentum",
        r"$\xi$ [cost]",
        tuple(plain_text(name) for name in solution.control_momentum_names),
        solution.t,
        solution.control_momenta,
    )


def _violations(solution: Solution, robot: Robot | None) -> list[tuple[str, Array]]:
    """Name and absolute value of each constraint of the robot, or of the worst where they are many."""
    if robot is None or not (solution.nc and robot.nc):
        return []
    violation = np.array([robot.constraint_residual(q) for q in solution.qs])
    count = violation.shape[1]
    if count > _MAX_CONSTRAINTS:
        return [(f"worst of {count}", np.abs(violation).max(axis=1))]
    # Natural coordinates have more constraints; those of the robot are the last, but for what phases hold.
    held = {*solution.facts.held}
    own = [c.name for c in solution.labels.lam if not {c.name, c.name.rpartition(".")[0]} & held]
    names = own[-count:]
    return [(name, np.abs(violation[:, i])) for i, name in enumerate(names)]


def draw_drift(solution: Solution, robot: Robot | None, axes: Axes) -> None:
    """Draw errors in logarithmic scale: drift of control momenta and rotations, constraints.

    Without `robot`, those of constraints are left out.
    """
    momenta = solution.control_momenta
    shown = momenta.shape[1]
    for i, name in enumerate(solution.control_momentum_names):
        _log_points(axes, solution.t, np.abs(momenta[:, i] - momenta[0, i]), rf"$\xi$ {plain_text(name)}", i)
    for name, values in _violations(solution, robot):
        _log_points(axes, solution.t, values, rf"$\Phi$ {plain_text(name)}", shown)
        shown += 1
    _log_points(axes, solution.t, solution.manifold_drifts, "rotations", shown)
    what = "Drift of invariants, violation of constraints" if solution.nc else "Drift of invariants"
    finish_axes(
        axes, title=what, ylabel=r"$|\xi_n - \xi_0|$, $|\Phi|$" if solution.nc else r"$|\xi_n - \xi_0|$"
    )
    mark_time(axes, solution.t)
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        strip_legend(axes, handles, labels, per_row=2)
    else:
        _empty(axes, "exactly zero" if momenta.size or solution.manifold_drift == 0.0 else "none")
