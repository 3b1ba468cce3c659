"""Constraints and limits of a result in words: how well they are kept, which are touched, with what force."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.text import Text

from mbocp._arrays import BoolArray
from mbocp._tolerances import BOUND_TOLERANCE
from mbocp.problem.coordinates import COORDINATES
from mbocp.solution.loads import FORCES, largest_of, rms_of
from mbocp.solvers.records import Status

if TYPE_CHECKING:
    from mbocp.solution import ActiveLimit, Solution

_Rows = list[tuple[str, str | Text]]

_MAX_NAMES = 12  # more names than that are counted
_MAX_LIMITS = 8  # more lines than that nobody reads
_FORCES = {"J/m": "N", "J/rad": "N m", "J/m^2": "N/m"}  # what multipliers of constraints are
_AT_NODES = ("velocity", "position", "path")  # kinds of limits; the others hold in steps
_OF_SPHERE = "distance of "  # path constraints of `mbocp.problem.obstacles.clearance`: of a sphere of a link
_OF_SIDE = ": side "  # rows of `ViaConstraint`: which of both quaternions an attitude is
_OF_ONE = {  # kinds of limits of one number
    "effort_rms": "root mean square of {name} at its limit {bound:.6g} {unit}",
    "duration": "duration at its {side} bound {bound:.6g} s",
    "parameter": "{name} at its {side} bound {bound:.6g} {unit}",
    "time": "time of via {name} at its {side} bound {bound:.6g} s",
    "phase": "duration of phase {name} at its {side} bound {bound:.6g} s",
    "way": "way to {name} in the least time that its steps may have, {bound:.3g} s",
}


def limit_rows(solution: Solution) -> _Rows:
    """Return what a result says of them, ready for `print_rows`."""
    return [
        ("constraints", _constraints(solution)),
        *_forces(solution),
        ("rms effort", _mean_squares(solution)),
        ("peak effort", _peaks(solution)),
        ("limits", _limits(solution)),
        ("robust", _robust(solution)),
        ("clearance", _clearance(solution)),
        ("drift of rotations", _drift(solution)),
    ]


def _constraints(solution: Solution) -> str:
    if not solution.nc or _has_free_feet(solution):
        return "none"
    columns = solution.labels.lam
    named = ", ".join(c.name for c in columns)
    names = named if len(columns) <= _MAX_NAMES else f"all {len(columns)} of them"
    words = f"violated by {solution.constraint_violation:.2e} at most ({names})"
    more = (("their rates", solution.velocity_violation), ("within steps", solution.violation_within))
    return ", ".join([words, *(f"{what} by {size:.2e}" for what, size in more if not math.isnan(size))])


def _has_free_feet(solution: Solution) -> bool:
    """Whether all multipliers are forces of feet that may leave the ground, which nothing ties to it."""
    return bool(solution.facts.ties == 0 and solution.facts.contacts and not solution.facts.held)


def _forces(solution: Solution) -> _Rows:
    """The largest force and moment that constraints exert; nothing where multipliers are of rigid bodies."""
    known = COORDINATES.get(solution.coordinates)
    if not solution.nc or known is None or not known.has_robot_multipliers or not len(solution.lams):
        return []
    leaps = np.diff(solution.t) == 0.0
    rows: _Rows = [("forces", f"of constraints, at most {_largest(solution, ~leaps, '')}")]
    if leaps.any():
        rows.append(("impulses", f"of impacts, at most {_largest(solution, leaps, ' s')}"))
    return rows


def _largest(solution: Solution, steps: BoolArray, more: str) -> str:
    """The largest multipliers of each unit in some of the steps, with names."""
    sizes = np.abs(solution.lams[steps]).max(axis=0)
    found = dict[str, tuple[float, str]]()
    for size, column in zip(sizes.tolist(), solution.labels.lam, strict=True):
        unit = _FORCES.get(column.unit, column.unit) + more
        if size > found.get(unit, (-1.0, ""))[0]:
            found[unit] = (size, column.name)
    return ", ".join(f"{size:.4g} {unit} at {name}" for unit, (size, name) in found.items())


def _limits(solution: Solution) -> str:
    """Which limits the motion touches, and by how much it leaves them; nothing where there are none."""
    violation = solution.limit_violation
    is_left = violation >= BOUND_TOLERANCE
    touched = sorted(solution.active_limits, key=lambda limit: limit.kind != "duration")  # it comes first
    active = [_touches(limit) for limit in touched]
    if not (_is_bounded(solution) or is_left or active):
        return ""
    listed = "\n".join(active[:_MAX_LIMITS]) or "none is active"
    if len(active) > _MAX_LIMITS:
        listed += f"\nand {len(active) - _MAX_LIMITS} more"
    if is_left:
        listed += f"\nviolated by {violation:.2e} at most"
    elif violation < BOUND_TOLERANCE:  # not of what is not finite
        listed += "\nall are kept at the nodes"
    if solution.limit_excess > 0.0:
        more = " or more" if solution.status is Status.UNDER_RESOLVED else ""
        part, when = f"{100.0 * solution.limit_excess:.3g} %{more}", f"{solution.limit_excess_time:.4g} s"
        listed += f"\nbetween nodes the {solution.limit_excess_of} leaves its limit by {part}, at {when}"
    return listed


def _robust(solution: Solution) -> str:
    """Which limits leave most room for what is uncertain."""
    if math.isnan(solution.sigmas):
        return ""
    return f"limits keep off {solution.sigmas:.3g} standard deviations: {solution.tightest}"


def _mean_squares(solution: Solution) -> str:
    """Root mean squares of controls that are forces, with their limits."""
    limits = solution.facts.effort_rms or (math.inf,) * solution.nu
    columns = zip(rms_of(solution).tolist(), limits, strict=True)
    return _of_forces(
        solution,
        [f"{rms:.4g} of {most:.4g}" if math.isfinite(most) else f"{rms:.4g}" for rms, most in columns],
    )


def _peaks(solution: Solution) -> str:
    """Largest controls that are forces."""
    return _of_forces(solution, [f"{size:.4g}" for size in largest_of(solution).tolist()])


def _of_forces(solution: Solution, numbers: Sequence[str]) -> str:
    """Numbers of controls with their names and units, those of forces, as many as anybody reads."""
    columns = zip(solution.labels.u, numbers, strict=True)
    words = [f"{c.name} {number} {c.unit}" for c, number in columns if c.unit in FORCES]
    more = len(words) - _MAX_NAMES
    return ", ".join(words[:_MAX_NAMES]) + (f", and {more} more" if more > 0 else "")


def _is_bounded(solution: Solution) -> bool:
    bounds = (solution.limits_u, solution.limits_v, solution.limits_q)
    others = {row.name for row in solution.facts.path if row.is_equation or _OF_SIDE in row.name}
    if (
        not others.issuperset(solution.path_names)
        or solution.facts.effort_rms
        or solution.duration_range is not None
        or solution.named_phases
        or solution.facts.parameters
    ):
        return True
    return any(bool(np.isfinite(bound).any()) for bound in bounds)


def _touches(limit: ActiveLimit) -> str:
    if limit.kind in _OF_ONE:
        return _OF_ONE[limit.kind].format(**vars(limit))
    times = f"in {limit.count} of {limit.total} {'nodes' if limit.kind in _AT_NODES else 'steps'}"
    word, bound = "bound" if limit.kind == "path" else "limit", f" {limit.bound:.6g} {limit.unit}"
    name = limit.name
    if limit.kind == "path" and name.startswith(_OF_SPHERE):
        name = f"{_OF_SPHERE}sphere {name.removeprefix(_OF_SPHERE)}"
    return f"{limit.kind} {name} at its {limit.side} {word}{bound * (not math.isnan(limit.bound))} {times}"


def _clearance(solution: Solution) -> str:
    """How near the robot comes to obstacles, or its links to each other."""
    if math.isnan(solution.clearance):
        return ""
    size = f"{1e3 * abs(solution.clearance):.4g} mm"
    how = size if solution.clearance >= 0.0 else f"{size} in each other"
    nearest = f"{solution.clearance_between} at {solution.clearance_time:.4g} s"
    return f"{how}: {nearest}, of the pairs that are checked, shape to shape"


def _drift(solution: Solution) -> str:
    """How well rotations stay rotations, where there are any."""
    if solution.is_vector_space or math.isnan(solution.manifold_drift):
        return ""
    words = f"{solution.manifold_drift:.2e} at most"
    if not math.isnan(solution.manifold_drift_resimulated):
        words += f"; {solution.manifold_drift_resimulated:.2e} when simulated with the controls"
    return words
