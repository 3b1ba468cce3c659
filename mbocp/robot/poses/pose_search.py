r"""A configuration within bounds that reaches poses, from a start near or far: damped Gauss-Newton steps.

.. math:: \left(J^T J + \mu I\right) \delta = -J^T e, \qquad q \leftarrow q \circ \exp(\delta)

The damping is a multiple of the cost [Sugihara2011]_, so that convergence is quadratic at a pose within
reach, also at singular configurations. Joints that a step would take beyond their bounds stop there, and
those at a bound that the gradient pushes outwards take no part in the step (a projected Newton's method).
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, IntArray
from mbocp.robot import joints

_MAX_ITERATIONS = 80  # six to fifteen are typical
_MAX_STEP = 1.0  # [rad, m] of one joint
_MIN_DAMPING = 1e-14  # of the largest diagonal entry: above round-off
_MIN_FACTOR, _MAX_FACTOR = 1e-3, 1e8  # damping by cost
_MAX_STALLED, _STALL_RATIO = 6, 0.98  # iterations in a row that leave more than this part of the cost
_MIN_GRADIENT = 1e-9  # [m, rad] by [rad, m]: at a local minimum, relative to the residual
_AT_BOUND = 1e-9  # [rad, m]
_SPREAD = 1.0  # [m] of random displacements that have no bounds


class ReachRows(Protocol):
    """What is to vanish, see `mbocp.robot.poses.pose_rows.PoseRows`."""

    @property
    def model(self) -> pin.Model:
        """Tree of joints."""

    def residual(self, q: Array) -> Array:
        """All rows at a configuration."""

    def jacobian(self, q: Array) -> Array:
        """Their derivative in tangent coordinates; `residual` has been called at the same q."""


def reach(
    rows: ReachRows, q: Array, bounds: JointBounds, held: BoolArray, tolerance: float
) -> tuple[Array, bool]:
    """Return the configuration that the steps from `q` lead to, and whether all rows vanish there.

    Parameters
    ----------
    rows : ReachRows
    q : ndarray, shape (nq,)
        Within the bounds.
    bounds : JointBounds
    held : ndarray of bool, shape (nv,)
        Velocity components of joints that stay where they are.
    tolerance : float
        Of each row [m, rad].
    """
    factor, stalled = 1.0, 0
    e = rows.residual(q)
    cost = float(e @ e)
    for _ in range(_MAX_ITERATIONS):
        has_arrived = np.abs(e).max() <= tolerance
        J = rows.jacobian(q)
        gradient = J.T @ e
        free = ~(bounds.blocks(q, gradient) | held)
        if not free.any() or np.abs(gradient[free]).max() <= _MIN_GRADIENT * np.sqrt(cost):
            return q, bool(has_arrived)
        found = _step(rows, q, J, gradient, free, factor * cost, bounds)
        e_found = rows.residual(found)
        cost_found = float(e_found @ e_found)
        if cost_found < cost:
            stalled = stalled + 1 if cost_found > _STALL_RATIO * cost else 0
            q, e, cost = found, e_found, cost_found
            factor = max(0.2 * factor, _MIN_FACTOR)
        else:
            factor, stalled = 8.0 * factor, stalled + 1
        if has_arrived or stalled > _MAX_STALLED or factor > _MAX_FACTOR:
            break
    return q, bool(np.abs(e).max() <= tolerance)


def _step(
    rows: ReachRows, q: Array, J: Array, gradient: Array, free: BoolArray, mu: float, bounds: JointBounds
) -> Array:
    step = np.zeros(gradient.size)
    columns = J if free.all() else J[:, free]
    normal = columns.T @ columns
    diagonal = normal.flat[:: len(normal) + 1]
    normal.flat[:: len(normal) + 1] = diagonal + mu + _MIN_DAMPING * diagonal.max()
    step[free] = -np.linalg.solve(normal, gradient[free])
    longest = np.abs(step).max()
    if longest > _MAX_STEP:
        step *= _MAX_STEP / longest
    moved: Array = pin.integrate(rows.model, q, step)
    return bounds.clip(moved)


class JointBounds(NamedTuple):
    """Bounds of the joints whose configuration is a plain vector, q + v."""

    at_q: IntArray  # (n,) where their numbers are in q
    at_v: IntArray  # (n,) and in v
    lower: Array  # (n,) [rad, m], infinite where there is none
    upper: Array  # (n,)
    angular: BoolArray  # (n,) whether a full turn leads to the same pose: revolute, and nothing follows it

    def clip(self, q: Array) -> Array:
        """Configuration with each joint within its bounds, shape (nq,)."""
        out = np.array(q)
        out[self.at_q] = np.minimum(np.maximum(out[self.at_q], self.lower), self.upper)
        return out

    def blocks(self, q: Array, gradient: Array) -> BoolArray:
        """Velocity components at a bound that a step against the gradient would take beyond it."""
        values, slope = q[self.at_q], gradient[self.at_v]
        mask = np.zeros(gradient.size, dtype=np.bool_)
        mask[self.at_v] = ((values <= self.lower) & (slope > 0.0)) | ((values >= self.upper) & (slope < 0.0))
        return mask

    def joints_at_bounds(self, q: Array) -> IntArray:
        """Positions in q of the joints that are at a bound."""
        values = q[self.at_q]
        return self.at_q[(values <= self.lower + _AT_BOUND) | (values >= self.upper - _AT_BOUND)]

    def unwind(self, q: Array, start: Array) -> Array:
        """The same pose, each angle in the turn nearest to the start within the bounds, shape (nq,)."""
        out, turn = np.array(q), 2.0 * np.pi
        at = self.at_q[self.angular]
        lower, upper = self.lower[self.angular], self.upper[self.angular]
        nearest = q[at] - turn * np.round((q[at] - start[at]) / turn)
        nearest = nearest + turn * (nearest < lower) - turn * (nearest > upper)
        out[at] = np.where((lower <= nearest) & (nearest <= upper), nearest, q[at])
        return out

    def random(self, model: pin.Model, start: Array, rng: np.random.Generator) -> Array:
        """A configuration within the bounds, angles within half a turn of the start where they may be."""
        step = rng.normal(scale=_SPREAD, size=model.nv)
        for joint in range(1, model.njoints):  # attitudes and angles of circles
            kind, at = joints.joint_kind(model, joint), joints.velocity_slice(model, joint)
            turning = np.array([unit == "rad" for _, unit in kind.v])
            if turning.any():
                step[at][turning] = _rotation(int(turning.sum()), rng)
        q: Array = np.array(pin.integrate(model, start, step))
        turn = np.minimum(2.0 * np.pi, self.upper - self.lower)
        first = np.minimum(np.maximum(start[self.at_q] - np.pi, self.lower), self.upper - turn)
        is_closed = np.isfinite(self.lower) & np.isfinite(self.upper)
        low = np.where(self.angular, first, np.where(is_closed, self.lower, q[self.at_q]))
        width = np.where(self.angular, turn, np.where(is_closed, self.upper - self.lower, 0.0))
        q[self.at_q] = low + rng.random(len(low)) * width
        return self.clip(q)


def joint_bounds(model: pin.Model, lower: Array, upper: Array, coupled: frozenset[int]) -> JointBounds:
    """Bounds of a model's plain joints.

    Parameters
    ----------
    lower, upper : ndarray, shape (nq,)
        [rad, m].
    coupled : frozenset of int
        Joints that others follow: their full turns count.
    """
    at_q: list[int] = []
    at_v: list[int] = []
    angular: list[bool] = []
    for joint in range(1, model.njoints):
        kind = joints.joint_kind(model, joint)
        if not kind.is_vector:
            continue
        q, v = joints.configuration_slice(model, joint), joints.velocity_slice(model, joint)
        at_q += range(q.start, q.stop)
        at_v += range(v.start, v.stop)
        angular += [kind.word == "revolute" and joint not in coupled] * (q.stop - q.start)
    where = np.array(at_q, dtype=np.intp)
    plain = np.array(at_v, dtype=np.intp), lower[where], upper[where], np.array(angular, dtype=np.bool_)
    return JointBounds(where, *plain)


def inside(model: pin.Model, q: Array, lower: Array, upper: Array) -> bool:
    """Whether all lengths and angles of q are within the bounds; parts of unit vectors have none."""
    plain = np.ones(q.size, dtype=np.bool_)
    for _, group in joints.unit_groups(model):
        plain[group] = False
    return bool(((q >= lower - _AT_BOUND) & (q <= upper + _AT_BOUND))[plain].all())


def _rotation(size: int, rng: np.random.Generator) -> Array:
    """Tangent vector to a rotation, each as likely as another: an angle, or a rotation vector."""
    if size == 1:
        return rng.uniform(-np.pi, np.pi, size=1)
    numbers = rng.normal(size=4)
    return pin.log3(pin.Quaternion(numbers / np.linalg.norm(numbers)).matrix())
