"""What goes into a result file and comes back, before it means anything."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from mbocp._arrays import Array

_ROWS = {  # what the first axis runs over
    "node": "nodes n = 0..N",
    "later node": "nodes n = 1..N",
    "step": "steps n -> n+1, n = 0..N-1",
    "side": "lower, upper",
    "condition": "end conditions",
    "share": "values",
    "guard": "guards",
    "pair": "pairs",
    "one": "ones",
}


class StoredQuantity(NamedTuple):
    """An array of a result: what it is, over what it runs, and what its columns are.

    Attributes
    ----------
    symbol, description : str
    axes : tuple of str
        The first is a key of `_ROWS`; "any" is an axis of no given length.
    columns : str
        Names and units of the last axis: a field of `mbocp.solution.Labels`; "dual " before one: multipliers
        of bounds on these; "symmetries", "path", "moves": names that the solution has; "numbers": there are
        none; else of a vector the name and unit of its only column.
    absent : float, optional
        Value of all numbers where nobody has worked them out; None: they must be there, or may be empty.
    may_lack : bool
        Whether it is left out of files where it says nothing.
    heading : str, optional
        How names of its columns begin in CSV tables; None: it is in none.
    """

    symbol: str
    description: str
    axes: tuple[str, ...]
    columns: str
    absent: float | None = None
    may_lack: bool = False
    heading: str | None = None

    @property
    def rows(self) -> str:
        """What its first axis runs over, in words."""
        return _ROWS[self.axes[0]]

    @property
    def has_one_column(self) -> bool:
        """Whether it is a vector of one quantity."""
        return len(self.axes) == 1 and self.columns != "numbers"


def _limit(letter: str, what: str) -> StoredQuantity:
    axes, symbol = ("side", letter), f"{letter}_min, {letter}_max"
    return StoredQuantity(symbol, f"limits of the {what}", axes, letter, math.inf, may_lack=True)


def _of_limit(letter: str, row: str) -> StoredQuantity:
    words, axes = f"multiplier of the limits of {letter}: positive at an upper one", (row, letter)
    return StoredQuantity(f"lambda_{letter}", words, axes, f"dual {letter}", 0.0, True, f"lam_{letter}")


def _spread(letter: str, row: str) -> StoredQuantity:
    words, symbol = f"standard deviation of {letter} about the plan", f"sigma_{letter}"
    return StoredQuantity(symbol, words, (row, letter), letter, may_lack=True, heading=symbol)


# A row is all that files, tables, datasets and checks know of a quantity: a new one is a row here, a field
# of `mbocp.solution.solution_data.SolutionData`, and the place where it is worked out.
QUANTITIES: Mapping[str, StoredQuantity] = MappingProxyType(
    {
        "t": StoredQuantity("t", "time of the nodes", ("node",), "t [s]"),
        "qs": StoredQuantity("q", "configuration", ("node", "q"), "q", heading="q"),
        "vs": StoredQuantity(
            "v", "velocity in the tangent space of the joints", ("node", "v"), "v", heading="v"
        ),
        "ps": StoredQuantity("p", "momentum M(q) v", ("node", "p"), "p", heading="p"),
        "us": StoredQuantity(
            "u", "control over its step; its mean where it varies", ("step", "u"), "u", heading="u"
        ),
        "u_values": StoredQuantity(
            "u",
            "control at the shares of a step, second axis; between them a polynomial",
            ("step", "share", "u"),
            "u",
            may_lack=True,
            heading="u",
        ),
        "u_shares": StoredQuantity(
            "c", "where in a step controls have values", ("share",), "share", may_lack=True
        ),
        "lams": StoredQuantity(
            "lambda",
            "multiplier of the holonomic constraints in the step",
            ("step", "lam"),
            "lam",
            0.0,
            heading="lam",
        ),
        "mus": StoredQuantity(
            "mu", "adjoint of the state: first of q, then of p", ("node", "mu"), "mu", heading="mu"
        ),
        "zetas": StoredQuantity(
            "zeta", "adjoint of the holonomic constraints", ("step", "zeta"), "zeta", 0.0, heading="zeta"
        ),
        "eta": StoredQuantity("eta", "multiplier of the exact end condition", ("condition",), "numbers"),
        "control_hamiltonians": StoredQuantity(
            "H", "control Hamiltonian, eq. (11)", ("step",), "H [cost/s]", math.nan, heading=""
        ),
        "control_momenta": StoredQuantity(
            "xi",
            "control momentum, eq. (15), one column a symmetry",
            ("node", "symmetry"),
            "symmetries",
            0.0,
            heading="xi",
        ),
        "manifold_drifts": StoredQuantity(
            "d", "distance of the rotations from their manifold", ("node",), "drift", math.nan, may_lack=True
        ),
        "lam_us": _of_limit("u", "step"),
        "lam_qs": _of_limit("q", "node"),
        "lam_vs": _of_limit("v", "node"),
        "lam_path": StoredQuantity(
            "lambda_h",
            "multiplier of the path constraints",
            ("later node", "path"),
            "path",
            0.0,
            may_lack=True,
            heading="lam_path",
        ),
        "limits_u": _limit("u", "control"),
        "limits_v": _limit("v", "velocity"),
        "limits_q": _limit("q", "configuration"),
        "gains": StoredQuantity(
            "K",
            "feedback: what u, second axis, answers to moves of (q, v), third",
            ("step", "answer", "move"),
            "moves",
            may_lack=True,
        ),
        "sigma_qs": StoredQuantity(
            "sigma_q", "standard deviation of q along its tangent", ("node", "v"), "numbers", may_lack=True
        ),
        "sigma_vs": _spread("v", "node"),
        "sigma_us": _spread("u", "step"),
    }
)


def _part(symbol: str, description: str, *axes: str) -> StoredQuantity:
    return StoredQuantity(symbol, description, axes, "numbers" if len(axes) > 1 else "", may_lack=True)


ITERATE: Mapping[str, StoredQuantity] = MappingProxyType(  # of the solver's last iterate
    {
        "iterate_xs": _part("x", "solver's states, for a warm start", "node", "any"),
        "iterate_ys": _part("y", "solver's algebraic unknowns", "step", "any"),
        "iterate_us": _part("u", "solver's controls", "step", "any"),
        "iterate_ms": _part(
            "m", "multiplier of the equations of a step, as the solver has it", "step", "any"
        ),
        "iterate_lam_xs": _part("lambda_x", "multiplier of the limits of the solver's states", "node", "any"),
        "iterate_lam_us": _part(
            "lambda_u", "multiplier of the limits of the solver's controls", "step", "any"
        ),
        "iterate_lam_path": _part(
            "lambda_h", "multiplier of the solver's path constraints", "later node", "any"
        ),
        "iterate_lam_guard": _part("lambda_g", "multiplier of what guards the end condition", "guard"),
        "iterate_room": _part("d", "what rows keep beyond margins [m]; -1: none", "pair"),
        "iterate_q_end": _part("q_N", "where conditions of the end were chosen", "one"),
        "iterate_q_start": _part("q_0", "start that a solve of a robot that is found began with", "one"),
        "iterate_first": _part("rho", "first values of what is found of the robot", "one"),
        "iterate_within": _part("w", "1: limits of speeds hold within steps, too", "one"),
    }
)


class FileContent(NamedTuple):
    """What goes into a result file and comes back.

    Arrays; names and units of their columns; values, structures, texts; for some arrays a line on each
    column; and what is said of a robot's files, with their compressed contents by digest.
    """

    arrays: Mapping[str, Array]
    columns: Mapping[str, tuple[tuple[str, str], ...]]
    summary: Mapping[str, str | int | float]
    structures: Mapping[str, Any]
    texts: Mapping[str, str]
    meanings: Mapping[str, tuple[str, ...]]
    robot_list: Mapping[str, Any] | None = None
    robot_contents: Mapping[str, bytes] = MappingProxyType({})
