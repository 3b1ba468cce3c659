r"""Configuration space of a Pinocchio model: the product of its joints' Lie groups.

`integrate` is :math:`q \exp(v)` and `difference` :math:`\log(q_0^{-1} q_1)`, with Pinocchio's coordinates and
conventions (quaternion xyzw, (cos, sin) pairs, body-frame tangents, linear before angular) and the same
values. Its own symbolic functions are not used for Newton's method: their logarithm takes arccosines of
numbers at 1, whose derivatives are infinite in the branch that is not taken.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import pinocchio as pin

from mbocp.exceptions import UnsupportedRobot
from mbocp.lie.functions import half_angle_sinc, log_factor, one_minus_cos, sinc, theta_minus_sin, v_inverse

__all__ = ["ConfigurationSpace"]

_Integrate = Callable[[ca.SX, ca.SX], ca.SX]
_Difference = Callable[[ca.SX, ca.SX], ca.SX]


class ConfigurationSpace:
    """Symbolic retraction and tangent-space difference of a model's configurations.

    Parameters
    ----------
    model : pinocchio.Model
        Its joints' types decide the groups.

    Raises
    ------
    UnsupportedRobot
        If a joint's group is not known here; the message names the joint.
    """

    def __init__(self, model: pin.Model) -> None:
        self.nq, self.nv = model.nq, model.nv
        self._parts = [_part(model, index) for index in range(1, model.njoints)]

    def integrate(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Configuration (nq,) reached from `q` along the tangent vector `v` (nv,)."""
        moved = [part.integrate(q[part.at_q], v[part.at_v]) for part in self._parts if part.nv]
        return ca.vertcat(*moved) if moved else ca.SX.zeros(0, 1)

    def difference(self, q0: ca.SX, q1: ca.SX) -> ca.SX:
        """Tangent vector (nv,) at `q0` that leads to `q1`."""
        between = [part.difference(q0[part.at_q], q1[part.at_q]) for part in self._parts if part.nv]
        return ca.vertcat(*between) if between else ca.SX.zeros(0, 1)


class _Part:
    """One joint: where its numbers are, and its group's two maps."""

    def __init__(self, joint: pin.JointModel, integrate: _Integrate, difference: _Difference) -> None:
        self.nv = joint.nv
        self.at_q = slice(joint.idx_q, joint.idx_q + joint.nq)
        self.at_v = slice(joint.idx_v, joint.idx_v + joint.nv)
        self.integrate, self.difference = integrate, difference


def _part(model: pin.Model, index: int) -> _Part:
    joint = model.joints[index]
    kind = (joint.nq, joint.nv)
    if joint.shortname() == "JointModelMimic":
        return _Part(
            joint, _vector_integrate, _vector_difference
        )  # moves with another joint: no numbers of its own
    if joint.nq == joint.nv and "Composite" not in joint.shortname():
        return _Part(joint, _vector_integrate, _vector_difference)
    known: dict[tuple[int, int], tuple[_Integrate, _Difference]] = {
        (2, 1): (_circle_integrate, _circle_difference),
        (4, 3): (_planar_integrate, _planar_difference),
        (7, 6): (_free_integrate, _free_difference),
    }
    if "Spherical" in joint.shortname():
        known[(4, 3)] = (_sphere_integrate, _sphere_difference)
    if "Composite" in joint.shortname() or kind not in known:
        raise UnsupportedRobot(
            f"joint {model.names[index]!r} is of type {joint.shortname()}, whose configuration space is not "
            "supported; split it into simple joints, or lock it"
        )
    return _Part(joint, *known[kind])


def _vector_integrate(q: ca.SX, v: ca.SX) -> ca.SX:
    return q + v


def _vector_difference(q0: ca.SX, q1: ca.SX) -> ca.SX:
    return q1 - q0


def _circle_integrate(q: ca.SX, v: ca.SX) -> ca.SX:
    c, s = ca.cos(v), ca.sin(v)
    return ca.vertcat(q[0] * c - q[1] * s, q[1] * c + q[0] * s)


def _circle_difference(q0: ca.SX, q1: ca.SX) -> ca.SX:
    return ca.atan2(q0[0] * q1[1] - q0[1] * q1[0], q0[0] * q1[0] + q0[1] * q1[1])


def _planar_integrate(q: ca.SX, v: ca.SX) -> ca.SX:
    """SE(2): (x, y, cos, sin) with the tangent (v_x, v_y, omega) in the body."""
    x = v[2] ** 2
    a, b = sinc(x), v[2] * one_minus_cos(x)
    moved = ca.vertcat(a * v[0] - b * v[1], b * v[0] + a * v[1])
    rotated = ca.vertcat(q[2] * moved[0] - q[3] * moved[1], q[3] * moved[0] + q[2] * moved[1])
    return ca.vertcat(q[:2] + rotated, _circle_integrate(q[2:], v[2]))


def _planar_difference(q0: ca.SX, q1: ca.SX) -> ca.SX:
    d = q1[:2] - q0[:2]
    p = ca.vertcat(q0[2] * d[0] + q0[3] * d[1], -q0[3] * d[0] + q0[2] * d[1])
    omega = _circle_difference(q0[2:], q1[2:])
    half, a = omega / 2, 1 - omega**2 * v_inverse(omega**2)  # a = theta/2 cot(theta/2)
    return ca.vertcat(a * p[0] + half * p[1], -half * p[0] + a * p[1], omega)


def _sphere_integrate(q: ca.SX, w: ca.SX) -> ca.SX:
    """SU(2): q exp(w) for a quaternion xyzw and the body-frame rotation vector w."""
    x = ca.dot(w, w)
    return _multiplied(q, ca.vertcat(half_angle_sinc(x) * w, _cos_half(x)))


def _sphere_difference(q0: ca.SX, q1: ca.SX) -> ca.SX:
    d = _multiplied(ca.vertcat(-q0[:3], q0[3]), q1)
    sign = ca.if_else(d[3] < 0, -1, 1)  # q and -q are the same attitude
    imaginary, w = sign * d[:3], sign * d[3]
    return log_factor(ca.dot(imaginary, imaginary), w) * imaginary


def _free_integrate(q: ca.SX, v: ca.SX) -> ca.SX:
    """SE(3): position and quaternion, the tangent (linear, angular) in the body."""
    w = v[3:]
    x = ca.dot(w, w)
    moved = (
        v[:3] + one_minus_cos(x) * ca.cross(w, v[:3]) + theta_minus_sin(x) * ca.cross(w, ca.cross(w, v[:3]))
    )
    return ca.vertcat(q[:3] + _rotated(q[3:], moved), _sphere_integrate(q[3:], w))


def _free_difference(q0: ca.SX, q1: ca.SX) -> ca.SX:
    w = _sphere_difference(q0[3:], q1[3:])
    p = _rotated(ca.vertcat(-q0[3:6], q0[6]), q1[:3] - q0[:3])
    linear = p - ca.cross(w, p) / 2 + v_inverse(ca.dot(w, w)) * ca.cross(w, ca.cross(w, p))
    return ca.vertcat(linear, w)


def _cos_half(x: ca.SX) -> ca.SX:
    """cos(theta/2) = 1 - 2 sin^2(theta/4), smooth in x = theta^2."""
    return 1 - x / 8 * sinc(x / 16) ** 2


def _multiplied(a: ca.SX, b: ca.SX) -> ca.SX:
    """Product of quaternions xyzw."""
    imaginary = a[3] * b[:3] + b[3] * a[:3] + ca.cross(a[:3], b[:3])
    return ca.vertcat(imaginary, a[3] * b[3] - ca.dot(a[:3], b[:3]))


def _rotated(q: ca.SX, p: ca.SX) -> ca.SX:
    """Vector p turned by the unit quaternion q."""
    t = 2 * ca.cross(q[:3], p)
    return p + q[3] * t + ca.cross(q[:3], t)
