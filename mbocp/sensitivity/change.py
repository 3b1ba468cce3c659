"""What moves of parameters make of the numbers that a programme holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields

import numpy as np

from mbocp._arrays import Array
from mbocp._dataclass import dataclass
from mbocp.formulation import Formulation, formulate
from mbocp.formulation.build import parameter_values
from mbocp.formulation.formulate import implied_end_rows, pieces_of
from mbocp.formulation.layout import places
from mbocp.formulation.pieces import Pieces
from mbocp.formulation.state_bounds import state_bounds
from mbocp.problem import Problem
from mbocp.programme import StagewiseProgramme
from mbocp.sensitivity.kkt import call

# Differences of fourth order: of numbers that depend on the move linearly or smoothly, right to 1e-11.
_STEP = 2.0**-9
_WEIGHTS = ((1.0, 8.0 / 12.0), (-1.0, -8.0 / 12.0), (2.0, -1.0 / 12.0), (-2.0, 1.0 / 12.0))
POINTS = tuple((at * _STEP, weight / _STEP) for at, weight in _WEIGHTS)  # moves, and their weights


@dataclass(frozen=True, eq=False)
class Change:
    """Derivatives of a programme's numbers in k parameters.

    Attributes
    ----------
    start : ndarray, shape (k, ndx)
        Of the given state, in its tangent.
    theta, rho, rho_terminal : ndarray, shapes (k, size)
    lower, upper : ndarray, shape (k, N, nx + nu + nh)
        Of the bounds.
    """

    start: Array
    theta: Array
    rho: Array
    rho_terminal: Array
    lower: Array
    upper: Array

    @classmethod
    def none(cls, programme: StagewiseProgramme, k: int) -> Change:
        """Zeros, to be filled in."""
        kind = programme.kind
        limits = (k, *programme.bounds.has_limit.shape)
        return cls(
            start=np.zeros((k, kind.ndx)),
            theta=np.zeros((k, programme.theta.size)),
            rho=np.zeros((k, programme.rho.size)),
            rho_terminal=np.zeros((k, programme.rho_terminal.size)),
            lower=np.zeros(limits),
            upper=np.zeros(limits),
        )

    @classmethod
    def join(cls, changes: list[Change]) -> Change:
        """Those of several parameters, one after the other."""
        return cls(*(np.concatenate([getattr(c, f.name) for c in changes]) for f in fields(cls)))

    def along(self, weights: Array) -> Change:
        """That along one move of all parameters."""
        return type(self)(*(np.tensordot(weights, getattr(self, f.name), 1)[None] for f in fields(self)))


def fourth_order(values: Callable[[float], Array]) -> Array:
    """Derivative at zero of a smooth function of a number of which one is a move of ordinary size."""
    return np.sum([weight * values(at) for at, weight in POINTS], axis=0)


def change_along(formulation: Formulation, problem_at: Callable[[float], Problem]) -> Change:
    """Change of the numbers with a move of a problem, whose functions stay the same, formulated anew.

    Parameters
    ----------
    formulation : Formulation
    problem_at : callable
        Returns the problem after a move of some size.
    """
    programme = formulation.programme
    has_all = len(pieces_of(formulation.problem).end_rows.of_joints) == len(formulation.end_rows.of_joints)
    without = () if has_all else implied_end_rows(formulate(formulation.problem))

    def numbers(size: float) -> Array:
        moved = _numbers(pieces_of(problem_at(size), without), formulation)
        return np.concatenate([moved[f.name].ravel() for f in fields(Change)])

    flat, first, found = fourth_order(numbers), 0, {}
    for f in fields(Change):
        shape = getattr(Change.none(programme, 1), f.name).shape
        count = int(np.prod(shape))
        found[f.name] = flat[first : first + count].reshape(shape)
        first += count
    return Change(**found)


def _numbers(moved: Pieces, base: Formulation) -> dict[str, Array]:
    theta, rho, rho_terminal = parameter_values(moved)
    (away,) = call(base.programme.functions, "difference", 1, [base.programme.x_start, moved.x_start])
    bounds = state_bounds(moved)
    return {
        "start": away.dense(base.programme.kind.ndx),
        "theta": theta,
        "rho": rho,
        "rho_terminal": _align(rho_terminal, base),
        "lower": _finite(bounds.lower),
        "upper": _finite(bounds.upper),
    }


def _finite(side: Array) -> Array:
    return np.where(np.isfinite(side), side, 0.0)


def _align(rho_terminal: Array, base: Formulation) -> Array:
    """Numbers of the end with projections turned as near to those of the base as they can be.

    Rows of a projection span a space, and which rows they are is a matter of round-off.
    """
    at, found = places(base.pieces.parameters.terminal), np.array(rho_terminal)
    nv = base.pieces.space.nv
    for name in ("D_q", "D_rate"):
        D = found[at[name]].reshape(nv, -1).T  # by columns
        D_base = base.programme.rho_terminal[at[name]].reshape(nv, -1).T
        if not np.array_equal(D, D_base):
            left, _, right = np.linalg.svd(D_base @ D.T)
            found[at[name]] = (left @ right @ D).ravel(order="F")
    return found
