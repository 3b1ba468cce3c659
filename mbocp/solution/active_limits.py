"""Which limits a motion touches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.problem.timeline.times import least_time
from mbocp.solution.details import Column
from mbocp.solution.loads import rms_of
from mbocp.solution.problem_facts import Facts, PathRow
from mbocp.solution.solution_data import SolutionData
from mbocp.terms.rates import PLACES, RATE_TERMS, name_at

_TOUCHES = 1e-5  # relative: interior-point methods stay inside by about the square root of their tolerance
_OF_TIME = ("duration", "time", "phase")  # relative to themselves: there are short motions
_PULLS = 1e-6  # part of the largest multiplier or adjoint; less is what a barrier leaves over


@dataclass(frozen=True)
class ActiveLimit:
    """A limit that the motion touches.

    Attributes
    ----------
    kind : str
        "control", "velocity", "position", "path", "duration", "time" or "way" of a via point, or a key of
        `mbocp.terms.rates.RATE_TERMS`; "phase" for its duration; "parameter". A way takes
        the least time that its steps may have.
    name : str
        Of the control, joint, path constraint or via point; "horizon" of a free duration, "end" of the way to
        it.
    side : str
        "lower" or "upper".
    bound : float
        NaN for a path constraint of a result that does not say which problem it solves.
    unit : str
    count, total : int
        At how many of the nodes or steps.
    """

    kind: str
    name: str
    side: str
    bound: float
    unit: str
    count: int
    total: int


def active_limits(solution: SolutionData) -> tuple[ActiveLimit, ...]:
    """Limits that the motion touches, in the order control, velocity, position, path, duration, time, way.

    Path constraints that are equations are none: every motion touches them.
    """
    labels, facts = solution.labels, solution.facts
    found: list[ActiveLimit] = []
    for kind, letter, columns, values, limits in (
        ("control", "u", labels.u, _nearest(solution, facts), solution.limits_u),
        ("velocity", "v", labels.v, solution.vs[1:], solution.limits_v),
        ("position", "q", labels.q, solution.qs[1:], solution.limits_q),
    ):
        along = facts.limits_along(letter)
        if along is None:
            found += _touch(kind, columns, values, limits)
        else:
            found += _limits_along(kind, columns, values, along)
    pulls = _PULLS * max(_largest(solution.lam_path), _largest(solution.mus))
    rows, rates = {row.name: row for row in facts.path}, _rate_bounds(solution, facts)
    for name, multipliers in zip(solution.path_names, solution.lam_path.T, strict=True):
        if name in rates:
            found += _pull(rates[name], multipliers, pulls)
            continue
        row = rows.get(name) or PathRow(name, np.nan, np.nan, "", solution.num_steps)
        for side, bound, active in (
            ("lower", row.lower, multipliers < -pulls),
            ("upper", row.upper, multipliers > pulls),
        ):
            if active.any() and not row.is_equation:
                count = int(np.count_nonzero(active))
                found.append(ActiveLimit("path", name, side, bound, row.unit, count, row.total))
    if facts.effort_rms:
        sides = np.array([np.full(solution.nu, -np.inf), facts.effort_rms])
        found += _touch("effort_rms", labels.u, rms_of(solution)[None], sides)
    if facts.duration_range is not None:
        bounds_of_it = np.array(facts.duration_range)[:, None]
        taken = np.array([[solution.duration]])
        found += _touch("duration", (Column("horizon", "s"),), taken, bounds_of_it)
    return (*found, *_of_via(solution, facts), *_of_phases(solution), *_of_parameters(facts))


def _of_parameters(facts: Facts) -> Iterator[ActiveLimit]:
    """Bounds of numbers of the robot that were found."""
    for one in facts.parameters:
        away = _TOUCHES * (one.upper - one.lower)
        for side, bound in (("lower", one.lower), ("upper", one.upper)):
            if abs(one.value - bound) <= away:
                yield ActiveLimit("parameter", one.name, side, bound, one.unit, 1, 1)


def _nearest(solution: SolutionData, facts: Facts) -> Array:
    """Of the values of each control in a step the one that is nearest to a limit, shape (N, nu)."""
    if solution.has_constant_controls:
        return solution.us
    values, along = solution.u_values, facts.limits_along("u")
    lower, upper = solution.limits_u[:, None] if along is None else along
    room = np.minimum(values - lower[:, None], upper[:, None] - values)
    return np.take_along_axis(values, room.argmin(axis=1)[:, None], axis=1)[:, 0]


def _of_phases(solution: SolutionData) -> Iterator[ActiveLimit]:
    """Bounds of durations of phases that were found."""
    for place in solution.named_phases:
        if place.is_free:
            taken = (solution.t[place.last] - solution.t[place.first]).reshape(1, 1)
            sides = np.array([[place.shortest], [place.longest]])
            yield from _touch("phase", (Column(place.name, "s"),), taken, sides)


def _limits_along(kind: str, columns: Sequence[Column], values: Array, along: Array) -> Iterator[ActiveLimit]:
    """Limits that differ along the motion, shape (2, N, n): each that there is, where it holds."""
    for i, column in enumerate(columns):
        for side, bounds in enumerate(along[:, :, i]):
            for bound in np.unique(bounds[np.isfinite(bounds)]):
                sides = np.array([[-np.inf], [np.inf]])
                sides[side] = bound
                where = bounds == bound
                yield from _touch(kind, (column,), values[where, i : i + 1], sides)


def _of_via(solution: SolutionData, facts: Facts) -> Iterator[ActiveLimit]:
    """Bounds of times that were found, and ways between via points on which hardly any time is left."""
    t, N = solution.t - solution.t[0], solution.num_steps
    places = [place for place in facts.via if place.node < N]
    for place in places:
        if place.is_found and place.earliest < place.latest:
            sides = np.array([[place.earliest or -np.inf], [place.latest]])
            at = t[place.node].reshape(1, 1)
            yield from _touch("time", (Column(place.name, "s"),), at, sides)
    if not any(place.is_found for place in places):
        return
    whole = float(t[-1]) if facts.duration_range is None else facts.duration_range[0]
    first = 0
    for name, last in (*((place.name, place.node) for place in places), ("end", N)):
        least = least_time(last - first, N, whole)
        if t[last] - t[first] <= least * (1.0 + _TOUCHES):
            yield ActiveLimit("way", name, "lower", least, "s", 1, 1)
        first = last


def _rate_bounds(solution: SolutionData, facts: Facts) -> dict[str, tuple[str, str, float, float, str]]:
    """Kind, name, bounds and unit of limited rates, and of speeds within steps, by the name of their row."""
    found: dict[str, tuple[str, str, float, float, str]] = {}
    for column, low, high in zip(solution.labels.v, *solution.limits_v, strict=True):
        found |= _bounds_within("velocity", column.name, low, high, column.unit)
    for key, (lower, upper) in facts.rates.items():
        term = RATE_TERMS[key]
        columns = solution.labels.v if term.over == "v" else solution.labels.u
        for column, low, high in zip(columns, lower, upper, strict=True):
            unit = term.unit(column.unit)
            found[term.row_name(column.name)] = (key, column.name, low, high, unit)
            found |= _bounds_within(key, column.name, low, high, unit)
    return found


def _bounds_within(
    key: str, name: str, low: float, high: float, unit: str
) -> dict[str, tuple[str, str, float, float, str]]:
    """What limits of a velocity or acceleration say where they hold within steps."""
    return {
        name_at(key, name, place): (key, f"{name} {place}", low, high, unit) for place in PLACES.get(key, ())
    }


def _pull(row: tuple[str, str, float, float, str], multipliers: Array, pulls: float) -> Iterator[ActiveLimit]:
    """Sides of a limited rate whose multipliers, times the limit, count beside the adjoints."""
    kind, name, lower, upper, unit = row
    for side, bound, sign in (("lower", lower, -1.0), ("upper", upper, 1.0)):
        if np.isfinite(bound):
            count = int(np.count_nonzero(sign * multipliers * max(1.0, abs(bound)) > pulls))
            if count:
                yield ActiveLimit(kind, name, side, float(bound), unit, count, len(multipliers))


def _largest(values: Array) -> float:
    """Largest finite absolute value."""
    return float(np.abs(np.where(np.isfinite(values), values, 0.0)).max(initial=0.0))


def _touch(kind: str, columns: Sequence[Column], values: Array, limits: Array) -> Iterator[ActiveLimit]:
    for i, column in enumerate(columns):
        lower, upper = limits[:, i]
        for side, bound, sign in (("lower", lower, -1.0), ("upper", upper, 1.0)):
            if np.isfinite(bound):
                size = abs(bound) if kind in _OF_TIME else max(1.0, abs(bound))
                margin = _TOUCHES * (min(size, upper - lower) or size)  # small robots have narrow ranges
                count = int(np.count_nonzero(sign * (values[:, i] - bound) >= -margin))
                if count:
                    yield ActiveLimit(kind, column.name, side, float(bound), column.unit, count, len(values))
