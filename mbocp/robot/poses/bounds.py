"""Bounds of joints in a search for a configuration: what is at one, what a random configuration may be."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, IntArray
from mbocp.robot import joints

_AT_BOUND = 1e-9  # [rad, m]
_SPREAD = 1.0  # [m] of random displacements that have no bounds


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

    def touching(self, q: Array) -> IntArray:
        """Positions in q of the joints that are at a bound."""
        values = q[self.at_q]
        found: IntArray = self.at_q[(values <= self.lower + _AT_BOUND) | (values >= self.upper - _AT_BOUND)]
        return found

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
    vector: Array = pin.log3(pin.Quaternion(numbers / np.linalg.norm(numbers)).matrix())
    return vector
