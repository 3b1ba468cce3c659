"""Bounds of a nonlinear programme, and what fatrop makes of them."""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.programme import StagewiseProgramme
from mbocp.solvers.nlp.layout import NlpLayout

_FATROP_RELAXES = 1e-8  # relative to a bound, absolute below one
_INSTEAD = 'take "monolithic" or "ipopt"'


def bounds_of(programme: StagewiseProgramme, lay: NlpLayout) -> dict[str, Array]:
    """Bounds of unknowns and rows, under the names of a solver's arguments."""
    given = programme.bounds
    lbx, ubx = np.full(lay.num_unknowns, -np.inf), np.full(lay.num_unknowns, np.inf)
    lbx[lay.xs[1:]], ubx[lay.xs[1:]] = given.x_lower, given.x_upper
    lbx[lay.us], ubx[lay.us] = given.u_lower, given.u_upper
    lbg, ubg = np.zeros(lay.num_rows), np.zeros(lay.num_rows)
    lbg[lay.path], ubg[lay.path] = given.path_lower, given.path_upper
    ubg[lay.guards] = np.inf
    return {"lbx": lbx, "ubx": ubx, "lbg": lbg, "ubg": ubg}


def miss(values: Array, bounds: dict[str, Array], letter: str) -> Array:
    """By how much values miss their bounds, those of the unknowns ("x") or of the rows ("g")."""
    lower, upper = bounds[f"lb{letter}"], bounds[f"ub{letter}"]
    by: Array = np.maximum(lower - values, 0.0) + np.maximum(values - upper, 0.0)
    return by


def kinds_of_bounds(programme: StagewiseProgramme) -> bytes:
    """Tell one programme from another by which bounds there are, and which of them are equations."""
    bounds = programme.bounds
    is_equation = bounds.lower == bounds.upper
    return b"".join(kinds.tobytes() for kinds in (bounds.lower > -np.inf, bounds.upper < np.inf, is_equation))


def tighten(bounds: dict[str, Array]) -> dict[str, Array]:
    """Bounds less the part by which fatrop relaxes them, so that those given are kept."""
    found: dict[str, Array] = {}
    for letter in "xg":
        lower, upper = _inside(bounds[f"lb{letter}"], bounds[f"ub{letter}"])
        found |= {f"lb{letter}": lower, f"ub{letter}": upper}
    return found


def _inside(lower: Array, upper: Array) -> tuple[Array, Array]:
    is_range = lower < upper
    sides = []
    for bound, sign in ((lower, 1.0), (upper, -1.0)):
        is_relaxed = np.isfinite(bound) & is_range
        by = np.where(is_relaxed, _FATROP_RELAXES * np.maximum(1.0, np.abs(bound)), 0.0)
        sides.append(bound + sign * by)
    return sides[0], sides[1]


def check_fatrop_takes(programme: StagewiseProgramme) -> None:
    """Refuse what fatrop cannot solve, whatever the guess.

    Raises
    ------
    ProblemError
        If there are more equations than unknowns at the last node, which has no controls; or if a range is
        narrower than what fatrop relaxes it by, so that nothing would be left of it.
    """
    bounds, nx = programme.bounds, programme.kind.nx
    of_path = int(np.count_nonzero(bounds.path_lower[-1] == bounds.path_upper[-1]))
    ng = programme.ng
    if ng + of_path > nx:
        raise ProblemError(
            f'solver.method: "fatrop" takes at most {nx} equations at the last node, got {ng} of the '
            f"goal and {of_path} of path constraints; end these before it, or {_INSTEAD}"
        )
    lower, upper = _inside(bounds.lower, bounds.upper)
    narrow = np.argwhere((bounds.lower < bounds.upper) & (lower >= upper))
    if narrow.size:
        node, row = (int(place) for place in narrow[0])
        raise ProblemError(
            f'solver.method: "fatrop" relaxes limits by {_FATROP_RELAXES:g}, and {_name(programme, row)} may '
            f"vary by {bounds.upper[node, row] - bounds.lower[node, row]:.3g} alone; widen the limit, or "
            f"{_INSTEAD}"
        )


def _name(programme: StagewiseProgramme, row: int) -> str:
    """What a row of states, controls and path functions is called."""
    nx, nu = programme.bounds.x_lower.shape[1], programme.bounds.u_lower.shape[1]
    if row < nx:
        return f"entry {row} of the states"
    return f"control {row - nx}" if row < nx + nu else programme.describe_path(row - nx - nu)
