"""Redundant rows of the holonomic constraints: those that the other rows imply.

A planar loop that a hinge closes in space has five rows of which two hold it; the other three hold anyway.
With all five the multipliers are not unique and the equations singular. What is redundant is found by rank,
at the initial pose and at poses around it: at a singular pose, rows may be dependent that elsewhere are not.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import partial

import numpy as np

from mbocp._arrays import Array, null_space, select_spanning_rows
from mbocp._text import quote_all
from mbocp.exceptions import UnsupportedRobot
from mbocp.robot.loops.kinds.constraint import Constraint
from mbocp.robot.loops.projection import REDUNDANT_ROW_TOLERANCE, gauss_newton
from mbocp.robot.mechanism import Mechanism

_log = logging.getLogger(__name__)

_NUM_POSES = 5  # around the initial one
_POSE_SPREAD = 0.3  # [rad, m] typical distance of a joint from its initial position
_RANK_TOLERANCE = 1e-4  # relative: six digits in a file leave singular values up to this
_MIN_INDEPENDENT_VALUE = 1e-2  # rows whose smallest singular value is larger are independent at every pose
_SCORE_TIE_RATIO = 0.5  # rows chosen at another pose are preferred if their score is twice as high
_SINGULAR_RATIO = 1e-3  # smallest singular value by its largest along the motion, at a singular pose
_CROSSING_RATIO = 0.3  # above it, the smallest singular value does not vanish before the next node
_MIN_VECTOR_COSINE = 0.7  # of singular vectors at two nodes that belong to the same singular value
_MIN_ROW_SHARE = 0.3  # component of the singular vector from which a row is named

_independent = partial(select_spanning_rows, tolerance=_RANK_TOLERANCE)


def redundant_rows(robot: Mechanism) -> tuple[int, ...]:
    """Rows that the others imply, counted over all constraints.

    Parameters
    ----------
    robot : Mechanism
        With all rows; its initial pose closes the loops.

    Raises
    ------
    UnsupportedRobot
        If a constraint as a whole is implied by the others or holds nothing that moves, or if the constraints
        leave nothing that moves, naming them.
    """
    first = _scale(robot, robot.closure_jacobian(robot.q0))
    if len(first) < robot.nv and np.linalg.svd(first, compute_uv=False)[-1] > _MIN_INDEPENDENT_VALUE:
        return ()
    jacobians = [_scale(robot, robot.closure_jacobian(q)) for q in _poses(robot)]
    best = _best_choice(jacobians)
    redundant = tuple(i for i in range(len(robot.closure_labels)) if i not in best)
    _check_constraints(robot, redundant, jacobians)
    if len(best) == robot.nv:
        names = quote_all(constraint.name for constraint in robot.constraints)
        raise UnsupportedRobot(
            f"robot {robot.name!r}: its constraints ({names}) leave nothing that moves: {len(best)} "
            f"independent rows on {robot.nv} velocities; take one out, or close the loop with a type that "
            'holds less (a planar loop with "hinge" in place of "weld")'
        )
    if redundant:
        labels = robot.closure_labels
        _log.info(
            "robot %r: redundant rows left out: %s", robot.name, quote_all(labels[i].name for i in redundant)
        )
    return redundant


def _best_choice(jacobians: Sequence[Array]) -> tuple[int, ...]:
    """Rows that are independent at all poses, those of the first pose unless others are far better."""
    choices = [tuple(_independent(jacobian)) for jacobian in jacobians]
    rank = max(map(len, choices))
    best, best_score = tuple[int, ...](), -1.0
    for choice in choices:
        score = _score(choice, jacobians) if len(choice) == rank else -1.0
        if (_SCORE_TIE_RATIO if best else 1.0) * score > best_score:
            best, best_score = choice, score
    return best


def singular_closure(robot: Mechanism, qs: Array) -> str:
    """Message about a pose of a motion at which the kept constraints depend on each other.

    There their multipliers are not unique, and the mechanism may change its assembly mode. A singular pose
    between two nodes shows as the singular vectors of the smallest value changing their sign.

    Parameters
    ----------
    qs : ndarray, shape (n, nq)
        Configurations along the motion.

    Returns
    -------
    words : str
        Empty if there is no such pose.
    """
    if not robot.nc or not len(qs) or not np.isfinite(qs).all():
        return ""
    residuals, jacobians = robot.closure_along(qs)
    if np.abs(residuals[:, list(robot.kept_rows)]).max() > REDUNDANT_ROW_TOLERANCE:
        return ""  # no motion of this mechanism
    rows = _alike(robot, jacobians)
    kept = rows[:, list(robot.kept_rows)]
    smallest = np.asarray(np.linalg.svd(kept, compute_uv=False)[:, -1], dtype=np.float64)
    return _describe_rows_left_out(robot, residuals, rows) or _near_singular(robot, kept, smallest)


def singular_pose(robot: Mechanism, q: Array) -> str:
    """Message about constraints that lose or gain rank at q; empty at a regular pose."""
    if not robot.nc:
        return ""
    residuals, jacobians = robot.closure_along(q[None])
    rows = _alike(robot, jacobians)
    kept = rows[0, list(robot.kept_rows)]
    singular = np.linalg.svd(kept, compute_uv=False)
    if singular[-1] < _SINGULAR_RATIO * singular[0]:
        return f"in this pose of robot {robot.name!r} {_dependence(robot, kept)}"
    return _describe_rows_left_out(robot, residuals, rows)


def _describe_rows_left_out(robot: Mechanism, residuals: Array, rows: Array) -> str:
    """Message if redundant rows are violated, or independent of the others, at any of the poses."""
    redundant = list(robot.redundant_rows)
    if not redundant:
        return ""
    violated = np.abs(residuals[:, redundant])
    node, row = (int(i) for i in np.unravel_index(int(violated.argmax()), violated.shape))
    label = robot.closure_labels[redundant[row]]
    if violated[node, row] > REDUNDANT_ROW_TOLERANCE:
        words = f"is violated by {violated[node, row]:.2g} {label.unit}"
    else:
        sizes = np.linalg.svd(rows, compute_uv=False)
        if sizes.shape[1] <= robot.nc or sizes[:, robot.nc].max() <= _MIN_INDEPENDENT_VALUE:
            return ""
        node = int(sizes[:, robot.nc].argmax())
        kept = np.linalg.svd(rows[node, list(robot.kept_rows)], full_matrices=False)[2]
        own = rows[node, redundant] - rows[node, redundant] @ kept.T @ kept
        label = robot.closure_labels[redundant[int(np.linalg.norm(own, axis=1).argmax())]]
        words = "is independent of them"
    where = f" at node {node}" if len(rows) > 1 else " there"
    return f"the constraint {label.name!r}, left out because the others imply it, {words}{where}"


def _near_singular(robot: Mechanism, rows: Array, smallest: Array) -> str:
    node, largest = int(smallest.argmin()), float(smallest.max())
    where = f"near a singular configuration at node {node}"
    if smallest[node] > _SINGULAR_RATIO * largest:
        passed = _first_pass(rows, smallest)
        if passed is None:
            return ""
        where = f"through a singular configuration between nodes {passed} and {passed + 1}"
        node = passed + int(smallest[passed + 1] < smallest[passed])
    return (
        f"{where}: there {_dependence(robot, rows[node])} "
        f"(smallest singular value {smallest[node]:.1e}, elsewhere up to {largest:.1e}), multipliers are "
        "not unique, and the mechanism may go on in another assembly mode: see whether it moves as meant"
    )


def _first_pass(rows: Array, smallest: Array) -> int | None:
    """First node after which the smallest singular value would change its sign, if it had one."""
    low = smallest < _CROSSING_RATIO * smallest.max()
    steps = np.flatnonzero(low[:-1] & low[1:])
    if not steps.size:
        return None
    first, last = steps[0], steps[-1] + 2
    left, _, right = np.linalg.svd(rows[first:last], full_matrices=False)
    pairs = left[:, :, -1], right[:, -1]
    cosines = np.array([np.einsum("ni,ni->n", vectors[:-1], vectors[1:]) for vectors in pairs])
    has_turned = (np.abs(cosines).min(axis=0) > _MIN_VECTOR_COSINE) & (cosines.prod(axis=0) < 0.0)
    found = steps[has_turned[steps - first]]
    return int(found[0]) if found.size else None


def _dependence(robot: Mechanism, rows: Array) -> str:
    """Clause of a message: the kept rows that depend on each other the most."""
    weights = np.abs(np.linalg.svd(rows, full_matrices=False)[0][:, -1])
    names = [robot.constraint_labels[i].name for i in np.flatnonzero(weights > _MIN_ROW_SHARE)]
    if len(names) == 1:
        return f"the constraint {names[0]!r} holds nothing"
    return f"the constraints {quote_all(names)} depend on each other"


def _poses(robot: Mechanism) -> list[Array]:
    """The initial pose, and poses around it that close the loops."""
    rng = np.random.default_rng(0)
    everything = np.ones(robot.nv, dtype=np.bool_)
    basis = null_space(_scale(robot, robot.closure_jacobian(robot.q0)), _RANK_TOLERANCE)
    found = [np.array(robot.q0)]
    for _ in range(_NUM_POSES):
        away = basis @ rng.normal(scale=_POSE_SPREAD, size=basis.shape[1])
        q = gauss_newton(robot, robot.integrate(robot.q0, away), everything, robot.kept_rows)
        if np.abs(robot.closure_residual(q)).max() < REDUNDANT_ROW_TOLERANCE:
            found.append(q)
    return found


def _scale(robot: Mechanism, jacobian: Array) -> Array:
    """Rows of unit length; rows of round-off become zero."""
    return jacobian / _lengths(robot, np.linalg.norm(jacobian, axis=1))[:, None]


def _alike(robot: Mechanism, jacobians: Array) -> Array:
    """Rows at many poses, each divided by its largest length over all of them."""
    there = np.linalg.norm(jacobians, axis=2).max(axis=0)
    at_first = np.linalg.norm(robot.closure_jacobian(robot.q0), axis=1)
    return jacobians / _lengths(robot, np.maximum(there, at_first))[:, None]


def _lengths(robot: Mechanism, norms: Array) -> Array:
    """Lengths of rows, infinite for rows of round-off."""
    units = np.array([label.unit for label in robot.closure_labels])
    floor = np.full(norms.size, 1e-12)
    floor[units == "rad"] = _RANK_TOLERANCE
    floor[units == "m"] = _RANK_TOLERANCE * norms[units == "m"].max(initial=0.0)
    return np.where(norms > np.maximum(floor, 1e-12), norms, np.inf)


def _score(choice: Sequence[int], jacobians: Sequence[Array]) -> float:
    """Smallest singular value of the chosen rows over all poses but the first; infinite without rows."""
    if not choice:
        return np.inf
    judged = jacobians[1:] or jacobians
    smallest = [float(np.linalg.svd(J[list(choice)], compute_uv=False)[-1]) for J in judged]
    return min(smallest)


def _check_constraints(robot: Mechanism, redundant: Sequence[int], jacobians: Sequence[Array]) -> None:
    for constraint, rows in zip(robot.constraints, robot.constraint_rows, strict=True):
        if not all(row in redundant for row in rows):
            continue
        if not any(J[list(rows)].any() for J in jacobians):
            reason = "holds nothing that moves: the joints between its frames cannot violate it"
        else:
            reason = _describe_implication(robot, constraint, jacobians)
        raise UnsupportedRobot(
            f"robot {robot.name!r}: constraint {constraint.name!r} {reason}; take it out, or one "
            "that says the same"
        )


def _describe_implication(robot: Mechanism, constraint: Constraint, jacobians: Sequence[Array]) -> str:
    """Clause of a message: the constraint that implies this one, or that all others together do."""
    pairs = zip(robot.constraints, robot.constraint_rows, strict=True)
    rows = {one.name: list(places) for one, places in pairs}
    own = rows.pop(constraint.name)
    for name, other in rows.items():
        if all(len(_independent(J[other])) == len(_independent(J[other + own])) for J in jacobians):
            return f"is a duplicate: {name!r} implies it"
    return f"follows from the others ({quote_all(rows)})"
