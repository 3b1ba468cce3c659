"""Which rows of the holonomic constraints say something, and which follow from the others.

A planar loop that a hinge closes in space has five rows of which two hold it; the other three hold anyway.
With all five the multipliers are not unique and the equations singular. What is redundant is found by rank,
at the initial pose and at poses around it: at a singular pose, rows may be dependent that elsewhere are not.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array
from mbocp._linear import null_space
from mbocp.exceptions import UnsupportedRobot
from mbocp.robot.closing import SLACK, gauss_newton

if TYPE_CHECKING:
    from mbocp.robot.robot import Robot

__all__ = ["singular_closure", "without_redundant_rows"]

_log = logging.getLogger(__name__)

_POSES = 5  # around the initial one
_AROUND = 0.3  # [rad, m] typical distance of a joint from there
_RANK = 1e-4  # relative: singular values below come from six digits in a URDF, or are as good as zero
_CLEARLY = 1e-2  # smallest singular value of rows whose independence needs no further look
_NEARLY = 0.99  # of the largest pivot
_SAME = 0.5  # a choice of rows at another pose must be better by more than this to be preferred
_NEAR_SINGULAR = 1e-3  # of the largest along the motion


def without_redundant_rows(robot: Robot) -> Robot:
    """Return the robot without the rows that the others imply.

    Parameters
    ----------
    robot : Robot
        With all rows; its initial pose closes the loops.

    Raises
    ------
    UnsupportedRobot
        If a constraint as a whole is implied by the others or holds nothing that moves, or if the constraints
        leave nothing that moves, naming them.
    """
    first = _scaled(robot, robot.closure_jacobian(robot.q0))
    if len(first) < robot.nv and np.linalg.svd(first, compute_uv=False)[-1] > _CLEARLY:
        return robot
    jacobians = [_scaled(robot, robot.closure_jacobian(q)) for q in _poses(robot)]
    choices = [_independent(jacobian) for jacobian in jacobians]
    rank = max(len(choice) for choice in choices)
    best = choices[0] if len(choices[0]) == rank else ()
    best_score = _score(best, jacobians) if best else -1.0
    for choice in choices:
        score = _score(choice, jacobians) if len(choice) == rank else -1.0
        if _SAME * score > best_score:
            best, best_score = choice, score
    redundant = tuple(i for i in range(len(robot.closure_labels)) if i not in best)
    _check_constraints(robot, redundant, jacobians)
    if rank == robot.nv:
        names = _quoted(constraint.name for constraint in robot.constraints)
        raise UnsupportedRobot(
            f"robot {robot.name!r}: its constraints ({names}) leave nothing that moves: {rank} independent "
            f"rows on {robot.nv} velocities; take one out, or close the loop with a type that holds less (a "
            'planar loop with "hinge" in place of "weld")'
        )
    if redundant:
        labels = robot.closure_labels
        _log.info(
            "robot %r: redundant rows left out: %s", robot.name, _quoted(labels[i].name for i in redundant)
        )
    return replace(robot, redundant_rows=redundant)


def singular_closure(robot: Robot, qs: Array) -> str:
    """Words about where a motion comes near a pose at which the kept constraints depend on each other.

    There their multipliers are not unique, and the mechanism may change its assembly mode.

    Parameters
    ----------
    qs : ndarray, shape (n, nq)
        Configurations along the motion.

    Returns
    -------
    words : str
        Empty where there is nothing to tell.
    """
    if not robot.nc:
        return ""
    smallest = np.zeros(len(qs))
    for n, q in enumerate(qs):
        rows = _scaled(robot, robot.closure_jacobian(q))[list(robot.kept_rows)]
        smallest[n] = np.linalg.svd(rows, compute_uv=False)[-1]
    node = int(smallest.argmin())
    if smallest[node] > _NEAR_SINGULAR * smallest.max():
        return ""
    rows = _scaled(robot, robot.closure_jacobian(qs[node]))[list(robot.kept_rows)]
    weights = np.abs(np.linalg.svd(rows)[0][:, -1])
    names = [robot.constraint_labels[i].name for i in np.flatnonzero(weights > 0.3)]
    return (
        f"near a singular configuration at node {node}: there the constraints {_quoted(names)} depend on "
        f"each other (smallest singular value {smallest[node]:.1e}, elsewhere up to {smallest.max():.1e}), "
        "and multipliers and the way on from there are not unique"
    )


def _poses(robot: Robot) -> list[Array]:
    """The initial pose, and poses around it that close the loops."""
    rng = np.random.default_rng(0)
    everything = np.ones(robot.nv, dtype=np.bool_)
    basis = null_space(_scaled(robot, robot.closure_jacobian(robot.q0)), _RANK)
    found = [np.array(robot.q0)]
    for _ in range(_POSES):
        away = basis @ rng.normal(scale=_AROUND, size=basis.shape[1])
        q = gauss_newton(robot, robot.integrate(robot.q0, away), everything, robot.kept_rows)
        if np.abs(robot.closure_residual(q)).max() < SLACK:
            found.append(q)
    return found


def _scaled(robot: Robot, jacobian: Array) -> Array:
    """Rows of unit length, and zeros for rows that hold nothing but round-off."""
    norms = np.linalg.norm(jacobian, axis=1)
    units = np.array([label.unit for label in robot.closure_labels])
    floor = np.full(norms.size, 1e-12)
    floor[units == "rad"] = _RANK
    floor[units == "m"] = _RANK * norms[units == "m"].max(initial=0.0)
    scale = np.where(norms > np.maximum(floor, 1e-12), norms, np.inf)
    scaled: Array = jacobian / scale[:, None]
    return scaled


def _independent(jacobian: Array) -> tuple[int, ...]:
    """Rows that span all of them, by Gram-Schmidt with pivots; of equally good ones the first."""
    rest, chosen = np.array(jacobian), []
    for _ in range(min(jacobian.shape)):
        sizes = np.linalg.norm(rest, axis=1)
        if sizes.max() < _RANK:
            break
        row = int(np.argmax(sizes > _NEARLY * sizes.max()))
        chosen.append(row)
        direction = rest[row] / sizes[row]
        rest -= np.outer(rest @ direction, direction)
    return tuple(sorted(chosen))


def _score(choice: Sequence[int], jacobians: Sequence[Array]) -> float:
    """How far the chosen rows are from depending on each other, at the worst of the poses but the first."""
    judged = jacobians[1:] or jacobians
    smallest = [float(np.linalg.svd(J[list(choice)], compute_uv=False)[-1]) for J in judged]
    return min(smallest)


def _check_constraints(robot: Robot, redundant: Sequence[int], jacobians: Sequence[Array]) -> None:
    start = 0
    for constraint in robot.constraints:
        rows = range(start, start + len(constraint.rows))
        start = rows.stop
        if not all(row in redundant for row in rows):
            continue
        if not any(J[list(rows)].any() for J in jacobians):
            reason = "holds nothing that moves: the joints between its frames cannot violate it"
        else:
            others = [c.name for c in robot.constraints if c is not constraint]
            reason = f"follows from the others ({_quoted(others)})"
        raise UnsupportedRobot(
            f"robot {robot.name!r}: constraint {constraint.name!r} {reason}; take it out, or one "
            "that says the same"
        )


def _quoted(names: Iterable[str]) -> str:
    return ", ".join(map(repr, names))
