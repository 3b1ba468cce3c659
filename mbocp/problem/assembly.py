"""Start and goal of a robot with closed loops: what was written, and the joints that follow from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mbocp._arrays import Array, BoolArray
from mbocp._linear import null_space
from mbocp.exceptions import InconsistentStart
from mbocp.problem.consistency import CONSISTENCY_TOLERANCE, check_position, project_on_constraints
from mbocp.robot import Robot
from mbocp.robot.closing import follow, gauss_newton, violations

__all__ = ["assembled", "assembled_velocity", "closed_way", "complete_goal"]

_ARRIVED = 1e-6  # [rad, m] a continuation that comes so near has arrived
_LEAP = 0.3  # [rad, m] longer steps to the next configuration of a way are taken in smaller ones
_ATTEMPTS = 5  # the first from where the start is, the others from around it
_INDEPENDENT = 0.05  # part of a motion along the constraints that a driven joint must make


def assembled(robot: Robot, q: Array, active: BoolArray, *, assemble: bool, base: Array) -> Array:
    """Return `q` with its loops closed.

    Parameters
    ----------
    q : ndarray, shape (nq,)
    active : ndarray of bool, shape (nv,)
        Which directions were written. If those of some joints only, the others are found.
    assemble : bool
        Whether what was written in full may move; if not, it is left as it is.
    base : ndarray, shape (nq,)
        A configuration that closes the loops; the joints that were not written are looked for from there.

    Raises
    ------
    LoopNotClosed
        If no configuration with the written joints closes the loops, or none near one written in full.
    """
    if not violations(robot, q, CONSISTENCY_TOLERANCE):
        return q
    if active.all() or not active.any():
        return np.array(robot.assemble(q)) if assemble else q
    reached = follow(robot, base, q, active)
    if _distance(robot, reached, q, active) <= _ARRIVED:
        return reached
    written = [name for name in robot.joint_names if active[robot.velocity_indices(name)].any()]
    return np.array(robot.assemble(q, fixed=written))


def assembled_velocity(robot: Robot, q: Array, v: Array, active: BoolArray, *, assemble: bool) -> Array:
    """Return `v` along the constraints: the joints that were not written follow those that were."""
    if not robot.nc or np.abs(robot.constraint_jacobian(q) @ v).max() <= CONSISTENCY_TOLERANCE:
        return v
    if active.all():
        return np.array(robot.assemble_velocity(q, v)) if assemble else v
    written = [name for name in robot.joint_names if active[robot.velocity_indices(name)].any()]
    return np.array(robot.assemble_velocity(q, v, fixed=written))


def complete_goal(robot: Robot, q: Array, active: BoolArray, q_start: Array) -> tuple[Array, str]:
    """Return the goal with its free directions moved so that the constraints hold, and what is odd about it.

    The way leads from the start in small steps, the loops closed: the goal lies in the start's assembly mode.

    Returns
    -------
    q : ndarray, shape (nq,)
    words : str
        Empty, or that no way was found on which the mechanism stays closed.

    Raises
    ------
    InconsistentStart
        If no configuration with the wanted entries meets the constraints.
    """
    if not robot.nc or not active.any():
        return q, ""
    if active.all():
        check_position(robot, q, "goal.q")
        return q, _another_mode(robot, q_start, q)
    reached = follow(robot, q_start, q, active)
    if _distance(robot, reached, q, active) <= _ARRIVED:
        return reached, ""
    short = _short(robot, reached, q, active)
    found = _anywhere(robot, q, np.flatnonzero(~active))
    try:
        check_position(robot, found, "goal.q")
    except InconsistentStart as error:
        raise InconsistentStart(f"{error}; from the start, the mechanism comes as near as {short}") from None
    return found, (
        f"goal.q: closes the loops of robot {robot.name!r}, but on the way there from the start, closed, the "
        f"mechanism gets stuck ({short}): it may be another assembly mode"
    )


def closed_way(robot: Robot, q_start: Array, q_goal: Array, shares: Array) -> Array | None:
    """Configurations from start to goal with the loops closed all the way.

    The joints that drive the mechanism, those with motors first, are on the straight line; the others follow.

    Parameters
    ----------
    q_start, q_goal : ndarray, shape (nq,)
        They close the loops.
    shares : ndarray, shape (n,)
        How far along the line each configuration is; the last is 1.

    Returns
    -------
    qs : ndarray, shape (n, nq), or None
        None if this way gets stuck or leads elsewhere.
    """
    driving, whole = _driving(robot, q_start), robot.difference(q_start, q_goal)
    q, qs = q_start, []
    for share in shares:
        target = robot.integrate(q_start, share * whole)
        step = np.where(driving, robot.difference(q, target), 0.0)
        near = gauss_newton(robot, robot.integrate(q, step), ~driving, robot.kept_rows)
        is_near = np.abs(robot.difference(q, near)).max() < _LEAP and not violations(robot, near)
        q = near if is_near else follow(robot, q, target, driving)
        qs.append(q)
    everything = np.ones(robot.nv, dtype=np.bool_)
    return np.array(qs) if _distance(robot, q, q_goal, everything) <= _ARRIVED else None


def _anywhere(robot: Robot, q: Array, free: NDArray[np.intp]) -> Array:
    """Gauss-Newton on Phi(q) = 0 over the free directions, from several places."""
    rng = np.random.default_rng(0)
    found = q
    for attempt in range(_ATTEMPTS):
        offset = np.zeros(robot.nv)
        # [m, rad] away from where Phi_q is singular
        offset[free] = 0.1 * attempt * rng.standard_normal(free.size)
        found = project_on_constraints(robot, robot.integrate(q, offset), free)
        if not violations(robot, found, CONSISTENCY_TOLERANCE):
            break
    return found


def _another_mode(robot: Robot, q_start: Array, q: Array) -> str:
    """Words if no way from the start to a goal was found: straight ahead, or by driving some joints."""
    everything = np.ones(robot.nv, dtype=np.bool_)
    nearest = q_start
    for wanted in (everything, _driving(robot, q_start)):
        reached = follow(robot, q_start, q, wanted)
        if _distance(robot, reached, q, everything) <= _ARRIVED:
            return ""
        nearest = reached
    return (
        f"goal.q: may lie in another assembly mode of robot {robot.name!r} than the start, out of reach: no "
        f"way was found on which the loops stay closed (nearest: {_short(robot, nearest, q, everything)})"
    )


def _driving(robot: Robot, q: Array) -> BoolArray:
    """Joints whose motion determines that of the mechanism, those with a motor first."""
    basis = null_space(robot.constraint_jacobian(q), 1e-9)
    chosen = np.zeros(robot.nv, dtype=np.bool_)
    has_motor = np.abs(robot.actuation.selection).sum(axis=1) > 0.0
    slices = [robot.velocity_indices(name) for name in robot.joint_names]
    for where in sorted(slices, key=lambda s: not has_motor[s].any()):
        if basis.shape[1] == 0 or where.stop == where.start:
            continue
        rows = basis[where]
        if np.linalg.svd(rows, compute_uv=False)[: rows.shape[0]].min() < _INDEPENDENT:
            continue
        chosen[where] = True
        basis = basis @ null_space(rows, 1e-9)
    return chosen


def _distance(robot: Robot, q: Array, target: Array, active: BoolArray) -> float:
    return float(np.abs(robot.difference(q, target)[active]).max(initial=0.0))


def _short(robot: Robot, q: Array, target: Array, active: BoolArray) -> str:
    missing = np.where(active, robot.difference(q, target), 0.0)
    worst = int(np.abs(missing).argmax())
    label = robot.v_labels[worst]
    return f"{label.name} {abs(missing[worst]):.3g} {label.unit.removesuffix('/s')} off"
