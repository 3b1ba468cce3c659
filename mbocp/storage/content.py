"""What goes into a result file and comes back, before it means anything."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from mbocp._arrays import Array

__all__ = ["ENTRIES", "OPTIONAL_ENTRIES", "Entry", "FileContent"]


class Entry(NamedTuple):
    """What a result file says of an array."""

    symbol: str
    description: str
    rows: str


_NODES = "nodes n = 0..N"
_STEPS = "steps n -> n+1, n = 0..N-1"
_SIDES = "lower, upper"

ENTRIES: dict[str, Entry] = {
    "t": Entry("t", "time of the nodes", _NODES),
    "qs": Entry("q", "configuration", _NODES),
    "vs": Entry("v", "velocity in the tangent space of the joints", _NODES),
    "ps": Entry("p", "momentum M(q) v", _NODES),
    "us": Entry("u", "control over its step; its mean where it varies", _STEPS),
    "lams": Entry("lambda", "multiplier of the holonomic constraints in the step", _STEPS),
    "mus": Entry("mu", "adjoint of the state: first of q, then of p", _NODES),
    "zetas": Entry("zeta", "adjoint of the holonomic constraints", _STEPS),
    "eta": Entry("eta", "multiplier of the exact end condition", "end conditions"),
    "control_hamiltonians": Entry("H", "control Hamiltonian, eq. (11)", _STEPS),
    "control_momenta": Entry("xi", "control momentum, eq. (15), one column a symmetry", _NODES),
}
OPTIONAL_ENTRIES: dict[str, Entry] = {
    "manifold_drifts": Entry("d", "distance of the rotations from their manifold", _NODES),
    "lam_us": Entry("lambda_u", "multiplier of the limits of u: positive at an upper one", _STEPS),
    "lam_qs": Entry("lambda_q", "multiplier of the limits of q: positive at an upper one", _NODES),
    "lam_vs": Entry("lambda_v", "multiplier of the limits of v: positive at an upper one", _NODES),
    "lam_path": Entry("lambda_h", "multiplier of the path constraints", "nodes n = 1..N"),
    "limits_u": Entry("u_min, u_max", "limits of the control", _SIDES),
    "limits_v": Entry("v_min, v_max", "limits of the velocity", _SIDES),
    "limits_q": Entry("q_min, q_max", "limits of the configuration", _SIDES),
    "u_values": Entry("u", "control at the shares of a step, second axis; between them a polynomial", _STEPS),
    "u_shares": Entry("c", "where in a step controls have values", "values"),
    "iterate_xs": Entry("x", "solver's states, for a warm start", _NODES),
    "iterate_ys": Entry("y", "solver's algebraic unknowns", _STEPS),
    "iterate_us": Entry("u", "solver's controls", _STEPS),
    "iterate_ms": Entry("m", "multiplier of the equations of a step, as the solver has it", _STEPS),
    "iterate_lam_xs": Entry("lambda_x", "multiplier of the limits of the solver's states", _NODES),
    "iterate_lam_us": Entry("lambda_u", "multiplier of the limits of the solver's controls", _STEPS),
    "iterate_lam_path": Entry("lambda_h", "multiplier of the solver's path constraints", "nodes n = 1..N"),
    "iterate_lam_guard": Entry("lambda_g", "multiplier of what guards the end condition", "guards"),
    "iterate_room": Entry("d", "what rows keep beyond margins [m]; -1: none", "pairs"),
    "gains": Entry("K", "feedback: what u, second axis, answers to moves of (q, v), third", _STEPS),
}


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
