"""Configurations and velocities that close the loops: projection in the kinetic metric, and continuation.

A projection takes Gauss-Newton steps that are the shortest in the norm of the mass matrix: light links follow
heavy ones. A continuation goes towards a target in small steps and closes the loops at each: the mechanism
stays in the assembly mode that it starts in (elbow up or down), where one long step might change it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbocp._arrays import Array, null_space
from mbocp._text import quote_all
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.exceptions import LoopNotClosed
from mbocp.robot.large import make_working_data
from mbocp.robot.loops.kinds.constraint import Constraint
from mbocp.robot.loops.reduction import CLOSURE_TOLERANCE, metrics_of, reduce_rows, shortest_steps
from mbocp.robot.mechanism import Mechanism

_OfOne: TypeAlias = Callable[[Mechanism, Array], Array]

REDUNDANT_ROW_TOLERANCE = 1e-4  # [m, rad, m^2] of rows that others imply: files have six digits

_MAX_ATTEMPTS = 4  # the first from the given pose, the others from around it
_STRIDE, _MIN_STRIDE = 0.1, 1e-3  # [rad, m] of one joint in a step of a continuation
_MAX_STRIDE = 1.0  # [rad, m] where the correction is below _STRAIGHT_RATIO of the step
_STRAIGHT_RATIO, _MAX_BEND_RATIO = 0.1, 0.5  # correction by length of the step
_MAX_KICKS = 4
_ARRIVAL_TOLERANCE = 1e-9  # [rad, m]
_MAX_WELD_ANGLE = 0.5  # [rad] beyond, the rows of a weld may vanish at another orientation (half turns)


def assemble(
    robot: Mechanism, q: Array, fixed: Sequence[str] = (), allowed: float = CLOSURE_TOLERANCE
) -> Array:
    """Nearest configuration that closes the loops but for `allowed`, see `Robot.assemble`."""
    free = ~components(robot, fixed)
    if not robot.constraints:
        return q
    rng = np.random.default_rng(0)
    nearest = q
    for attempt in range(_MAX_ATTEMPTS):
        # [m, rad] away from where the Jacobian is singular
        offset = np.where(free, 0.1 * attempt * rng.standard_normal(robot.nv), 0.0)
        found = gauss_newton(robot, robot.integrate(q, offset), free, robot.kept_rows)
        if not violations(robot, found, allowed):
            return found
        nearest = found if attempt == 0 else nearest
    raise _error(robot, nearest, fixed, allowed)


def components(robot: Mechanism, joints: Sequence[str]) -> NDArray[np.bool_]:
    """Velocity components of some joints, shape (nv,)."""
    chosen = np.zeros(robot.nv, dtype=np.bool_)
    for name in joints:
        chosen[robot.velocity_indices(name)] = True
    return chosen


def assemble_velocity(robot: Mechanism, q: Array, v: Array, held: NDArray[np.bool_]) -> Array:
    """Nearest velocity along the constraints, see `Robot.assemble_velocity`."""
    if not robot.nc:
        return v
    free = ~held
    jacobian, out = robot.constraint_jacobian(q), np.array(v)
    metric = metrics_of(robot, q[None])[:, free][:, :, free]
    for _ in range(2):  # the second removes the round-off of the first
        missing = -(jacobian @ out)[None]
        out[free] += shortest_steps(metric, jacobian[None, :, free], missing, np.zeros(1))[0]
    return out


def follow(
    robot: Mechanism, q: Array, target: Array, wanted: NDArray[np.bool_], *, max_kicks: int = _MAX_KICKS
) -> Array:
    """Continuation from `q` towards `target` in small steps, the loops closed at each.

    A step goes along the constraints in the direction nearest to the target. Where no step gets nearer, a few
    random kicks are tried.

    Parameters
    ----------
    q : ndarray, shape (nq,)
        Configuration that closes the loops.
    target : ndarray, shape (nq,)
        Configuration with the wanted components.
    wanted : ndarray of bool, shape (nv,)
        Velocity components of whole joints that have a target; the others follow.
    max_kicks : int
        How many.

    Returns
    -------
    q : ndarray, shape (nq,)
        At the target if the continuation arrives, else the nearest configuration of its path.
    """
    rng, kicks, step = np.random.default_rng(0), 0, _STRIDE
    nearest = q
    while (left := _distances(robot, q, target, wanted)).max(initial=0.0) > _ARRIVAL_TOLERANCE:
        found, bent = _stride(robot, q, target, wanted, step)
        if found is not None:
            q, step = found, min(2.0 * step, _MAX_STRIDE if bent < _STRAIGHT_RATIO else _STRIDE)
        elif step > _MIN_STRIDE:
            step /= 4.0
        else:
            if left.max() < _distances(robot, nearest, target, wanted).max():
                nearest = q
            if kicks == max_kicks:
                return nearest
            q, step, kicks = _kick(robot, nearest, rng), _STRIDE, kicks + 1
    placed = _with(robot, q, target, wanted)
    found = gauss_newton(robot, placed, ~wanted, robot.kept_rows)
    return q if violations(robot, found) else found


def gauss_newton(robot: Mechanism, q: Array, free: NDArray[np.bool_], rows: Sequence[int]) -> Array:
    """Reduce the residual of some rows as far as possible, by the free velocity components.

    Where frames of a weld are far from each other's orientation, first by the angle between them: the rows of
    the weld vanish at half turns, too.
    """
    chosen = list(rows)

    def reduce(q: Array, residual: _OfOne, jacobian: _OfOne) -> Array:
        def residuals(qs: Array) -> Array:
            return np.array([residual(robot, q)[chosen] for q in qs])

        def jacobians(qs: Array) -> Array:
            return np.array([jacobian(robot, q)[chosen] for q in qs])

        return reduce_rows(robot, q[None], free, residuals, jacobians)[0]

    if any(angle > _MAX_WELD_ANGLE for _, angle in _turns(robot, q)):
        q = reduce(q, residual_by_angle, jacobian_by_angle)
    return reduce(q, Mechanism.closure_residual, Mechanism.closure_jacobian)


def residual_by_angle(robot: Mechanism, q: Array) -> Array:
    """Residual of all rows, with rotation vectors in place of those that keep an attitude."""
    residual, data = np.array(robot.closure_residual(q)), make_working_data(robot.model)
    pin.framesForwardKinematics(robot.model, data, q)
    for constraint, where in attitude_rows(robot.constraints):
        residual[where] = pin.log3(_turn(data, constraint))
    return residual


def jacobian_by_angle(robot: Mechanism, q: Array) -> Array:
    """Derivative of `residual_by_angle` in tangent coordinates."""
    rows, model, data = np.array(robot.closure_jacobian(q)), robot.model, make_working_data(robot.model)
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    for constraint, where in attitude_rows(robot.constraints):
        in_a, in_b = (
            pin.getFrameJacobian(model, data, frame, pin.LOCAL).reshape(6, model.nv)[3:]
            for frame in constraint.frame_ids
        )
        turn = _turn(data, constraint)
        rows[where] = pin.Jlog3(turn) @ (in_a - turn.T @ in_b)
    return rows


def violations(
    robot: Mechanism, q: Array, allowed: float = CLOSURE_TOLERANCE
) -> list[tuple[str, float, str]]:
    """Name, residual and unit of each row that q violates, the worst first.

    Redundant rows may be violated by what six digits in a file leave. A weld whose frames are turned against
    each other where its rows vanish (half turns) is violated by the angle.
    """
    residual = robot.closure_residual(q)
    limits = np.full(residual.size, REDUNDANT_ROW_TOLERANCE)
    limits[list(robot.kept_rows)] = allowed
    labels = robot.closure_labels
    found = [
        (labels[i].name, float(residual[i]), labels[i].unit)
        for i in np.flatnonzero(np.abs(residual) > limits)
    ]
    found += [(one.name, angle, "rad") for one, angle in _turns(robot, q) if angle > _MAX_WELD_ANGLE]
    return sorted(found, key=lambda row: -abs(row[1]))


def attitude_rows(constraints: Iterable[Constraint]) -> Iterator[tuple[Constraint, slice]]:
    """Iterate over the constraints that keep an attitude, with its rows among those of all."""
    start = 0
    for constraint in constraints:
        if constraint.attitude is not None:
            rows = constraint.attitude
            yield constraint, slice(start + rows.start, start + rows.stop)
        start += len(constraint.rows)


def _turns(robot: Mechanism, q: Array) -> list[tuple[Constraint, float]]:
    """Angle between the frames of each constraint that keeps an attitude [rad]."""
    kept = [constraint for constraint, _ in attitude_rows(robot.constraints)]
    data = make_working_data(robot.model)
    if kept:
        pin.framesForwardKinematics(robot.model, data, q)
    return [(one, float(np.linalg.norm(pin.log3(_turn(data, one))))) for one in kept]


def _turn(data: pin.Data, constraint: Constraint) -> Array:
    """Axes of frame a in those of frame b."""
    a, b = constraint.frame_ids
    return data.oMf[b].rotation.T @ data.oMf[a].rotation


def _distances(robot: Mechanism, q: Array, target: Array, wanted: NDArray[np.bool_]) -> Array:
    """Distance of each wanted component from its target [rad, m]."""
    return np.abs(robot.difference(q, target)[wanted])


def _stride(
    robot: Mechanism, q: Array, target: Array, wanted: NDArray[np.bool_], longest: float
) -> tuple[Array | None, float]:
    """Configuration a step nearer to the target, or None; and the correction by the length of the step."""
    basis = null_space(robot.constraint_jacobian(q), RANK_TOLERANCE)
    missing = robot.difference(q, target)[wanted]
    ahead = basis @ np.linalg.lstsq(basis[wanted], missing, rcond=1e-6)[0]
    size = float(np.abs(ahead).max(initial=0.0))
    if size < _ARRIVAL_TOLERANCE:
        return None, np.inf
    guess = robot.integrate(q, ahead * min(1.0, longest / size))
    found = gauss_newton(robot, guess, np.ones(robot.nv, dtype=np.bool_), robot.kept_rows)
    corrected = float(np.abs(robot.difference(guess, found)).max())
    after = robot.difference(found, target)[wanted]
    nearer = np.linalg.norm(after) < np.linalg.norm(missing) * (1.0 - 1e-6)
    # A correction as long as the step itself may be another assembly mode.
    bent = corrected / min(size, longest)
    is_good = nearer and bent <= _MAX_BEND_RATIO and not violations(robot, found)
    return found if is_good else None, bent


def _kick(robot: Mechanism, q: Array, rng: np.random.Generator) -> Array:
    basis = null_space(robot.constraint_jacobian(q), RANK_TOLERANCE)
    away = basis @ rng.normal(scale=_STRIDE, size=basis.shape[1])
    found = gauss_newton(robot, robot.integrate(q, away), np.ones(robot.nv, dtype=np.bool_), robot.kept_rows)
    return q if violations(robot, found) else found


def _with(robot: Mechanism, q: Array, target: Array, chosen: NDArray[np.bool_]) -> Array:
    """Configuration q with some joints, whole ones, as in the target."""
    out = np.array(q)
    for name in robot.joint_names:
        where = robot.velocity_indices(name)
        if where.stop > where.start and chosen[where].all():
            out[robot.configuration_indices(name)] = target[robot.configuration_indices(name)]
    return out


def _error(robot: Mechanism, q: Array, fixed: Sequence[str], allowed: float) -> LoopNotClosed:
    bad = violations(robot, q, allowed)
    words = ", ".join(f"{name!r} by {value:.3g} {unit}" for name, value, unit in bad[:3])
    with_held = f" with {quote_all(fixed)} held" if fixed else ""
    advice = (
        f"give other positions of {quote_all(fixed)}, or leave one of them out"
        if fixed
        else "begin nearer to a configuration that closes, or correct the frames and lengths"
    )
    rows, residual = [row[0] for row in bad], [row[1] for row in bad]
    reason = f"the loops cannot be closed{with_held}: the nearest configuration violates {words}; {advice}"
    return LoopNotClosed(robot.name, rows, residual, reason)
