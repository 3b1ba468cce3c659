r"""The groups that joints' configurations form, with their coordinates.

All maps are symbolic. z are the coordinates of an element: Pinocchio's (quaternion xyzw, (cos, sin) pairs),
or nine numbers of a rotation matrix, column by column, where that is the chosen representation. Tangent
vectors v are body-frame, linear before angular.

Each group also has what an explicit integrator needs that treats z as a plain vector and so leaves the group:
dz/dt, Baumgarte's stabilisation, and an end condition that is smooth everywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import casadi as ca

from mbocp.lie.angles import half_angle_sinc, log_factor, one_minus_cos, sinc, theta_minus_sin, v_inverse


class Group(Protocol):
    """A Lie group in coordinates."""

    nz: int  # coordinates
    nv: int  # dimension
    is_vector: bool  # whether it is a plain vector space

    def integrate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """Element z exp(v), shape (nz,)."""

    def difference(self, z0: ca.SX, z1: ca.SX) -> ca.SX:
        """Tangent vector log(z0^-1 z1), shape (nv,)."""

    def rate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """Derivative dz/dt of the coordinates along the body velocity v, shape (nz,)."""

    def bracket(self, a: ca.SX, b: ca.SX) -> ca.SX:
        """Lie bracket [a, b] in the algebra of body-frame tangents, shape (nv,)."""

    def dexp(self, w: ca.SX, dw: ca.SX) -> ca.SX:
        """Body velocity of z exp(w(t)) where w' = dw: the exponential's derivative, from the right, (nv,)."""

    def attraction(self, z: ca.SX, gamma_quaternion: ca.SX, gamma_dcm: ca.SX) -> ca.SX:
        """Baumgarte's fictitious dz/dt towards the group, Eqs. (46), (47), shape (nz,)."""

    def projection(self, goal: ca.SX, z: ca.SX) -> ca.SX:
        """Null-space projected W'(z - goal), Eq. (37), equal to `difference` to first order, (nv,)."""

    def guards(self, goal: ca.SX, z: ca.SX) -> list[ca.SX]:
        """What must not be negative for `projection` to vanish at the goal alone."""

    def defects(self, z: ca.SX) -> list[ca.SX]:
        """What vanishes on the group: its invariants c(z), Eqs. (10), (15)."""


class Vector:
    """R^n."""

    is_vector = True

    def __init__(self, size: int) -> None:
        self.nz = self.nv = size

    def integrate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """Sum."""
        return z + v

    def difference(self, z0: ca.SX, z1: ca.SX) -> ca.SX:
        """Ordinary difference."""
        return z1 - z0

    def rate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """The velocity itself."""
        return v

    def bracket(self, a: ca.SX, b: ca.SX) -> ca.SX:
        """Nothing: the group is commutative."""
        return ca.SX.zeros(self.nv)

    def dexp(self, w: ca.SX, dw: ca.SX) -> ca.SX:
        """The rate itself: the group is commutative."""
        return dw

    def attraction(self, z: ca.SX, gamma_quaternion: ca.SX, gamma_dcm: ca.SX) -> ca.SX:
        """Nothing: every vector is an element."""
        return ca.SX.zeros(self.nz)

    def projection(self, goal: ca.SX, z: ca.SX) -> ca.SX:
        """Ordinary difference."""
        return z - goal

    def guards(self, goal: ca.SX, z: ca.SX) -> list[ca.SX]:
        """None."""
        return []

    def defects(self, z: ca.SX) -> list[ca.SX]:
        """None."""
        return []


class Circle:
    """SO(2) as (cos, sin)."""

    nz, nv, is_vector = 2, 1, False

    def integrate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """Turned by v."""
        c, s = ca.cos(v), ca.sin(v)
        return ca.vertcat(z[0] * c - z[1] * s, z[1] * c + z[0] * s)

    def difference(self, z0: ca.SX, z1: ca.SX) -> ca.SX:
        """Angle in (-pi, pi]."""
        return ca.atan2(z0[0] * z1[1] - z0[1] * z1[0], z0[0] * z1[0] + z0[1] * z1[1])

    def rate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """(-sin, cos) v."""
        return ca.vertcat(-z[1] * v, z[0] * v)

    def bracket(self, a: ca.SX, b: ca.SX) -> ca.SX:
        """Nothing: the group is commutative."""
        return ca.SX.zeros(1)

    def dexp(self, w: ca.SX, dw: ca.SX) -> ca.SX:
        """The rate itself: the group is commutative."""
        return dw

    def attraction(self, z: ca.SX, gamma_quaternion: ca.SX, gamma_dcm: ca.SX) -> ca.SX:
        """As of a quaternion, Eq. (46)."""
        return gamma_quaternion * (1 / ca.dot(z, z) - 1) * z

    def projection(self, goal: ca.SX, z: ca.SX) -> ca.SX:
        """Sine of the angle between."""
        return goal[0] * z[1] - goal[1] * z[0]

    def guards(self, goal: ca.SX, z: ca.SX) -> list[ca.SX]:
        """Its cosine, which excludes the half-turn."""
        return [ca.dot(goal, z)]

    def defects(self, z: ca.SX) -> list[ca.SX]:
        """Norm less one."""
        return [ca.norm_2(z) - 1]


class Plane:
    """SE(2) as (x, y, cos, sin), with the tangent (v_x, v_y, omega) in the body."""

    nz, nv, is_vector = 4, 3, False

    def __init__(self) -> None:
        self._turn = Circle()

    def integrate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """Moved along a circular arc."""
        x = v[2] ** 2
        a, b = sinc(x), v[2] * one_minus_cos(x)
        moved = ca.vertcat(a * v[0] - b * v[1], b * v[0] + a * v[1])
        return ca.vertcat(z[:2] + self._turn_point(z, moved), self._turn.integrate(z[2:], v[2]))

    def difference(self, z0: ca.SX, z1: ca.SX) -> ca.SX:
        """Twist of the arc between."""
        p = self._turn_back(z0, z1[:2] - z0[:2])
        omega = self._turn.difference(z0[2:], z1[2:])
        half, a = omega / 2, 1 - omega**2 * v_inverse(omega**2)  # a = theta/2 cot(theta/2)
        return ca.vertcat(a * p[0] + half * p[1], -half * p[0] + a * p[1], omega)

    def rate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """Velocity in the world, and of (cos, sin)."""
        return ca.vertcat(self._turn_point(z, v[:2]), self._turn.rate(z[2:], v[2]))

    def bracket(self, a: ca.SX, b: ca.SX) -> ca.SX:
        """omega_a x v_b - omega_b x v_a."""
        return ca.vertcat(b[2] * a[1] - a[2] * b[1], a[2] * b[0] - b[2] * a[0], 0)

    def dexp(self, w: ca.SX, dw: ca.SX) -> ca.SX:
        """Rate of the arc's end, in the axes there."""
        still = ca.SX([0, 0, 1, 0])
        c, s = ca.cos(w[2]), ca.sin(w[2])
        along = _along(lambda v: self.integrate(still, v)[:2], w, dw)
        return ca.vertcat(self._turn_back(ca.vertcat(0, 0, c, s), along), dw[2])

    def attraction(self, z: ca.SX, gamma_quaternion: ca.SX, gamma_dcm: ca.SX) -> ca.SX:
        """Of (cos, sin)."""
        return ca.vertcat(ca.SX.zeros(2), self._turn.attraction(z[2:], gamma_quaternion, gamma_dcm))

    def projection(self, goal: ca.SX, z: ca.SX) -> ca.SX:
        """Displacement in the goal's axes, sine of the angle."""
        return ca.vertcat(self._turn_back(goal, z[:2] - goal[:2]), self._turn.projection(goal[2:], z[2:]))

    def guards(self, goal: ca.SX, z: ca.SX) -> list[ca.SX]:
        """Cosine of the angle."""
        return self._turn.guards(goal[2:], z[2:])

    def defects(self, z: ca.SX) -> list[ca.SX]:
        """Of (cos, sin)."""
        return self._turn.defects(z[2:])

    @staticmethod
    def _turn_point(z: ca.SX, p: ca.SX) -> ca.SX:
        return ca.vertcat(z[2] * p[0] - z[3] * p[1], z[3] * p[0] + z[2] * p[1])

    @staticmethod
    def _turn_back(z: ca.SX, p: ca.SX) -> ca.SX:
        return ca.vertcat(z[2] * p[0] + z[3] * p[1], -z[3] * p[0] + z[2] * p[1])


class Quaternion:
    """SU(2) as a unit quaternion xyzw; q and -q are the same attitude."""

    nz, nv, is_vector = 4, 3, False

    def integrate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """Product with the exponential of the rotation vector, Eq. (53)."""
        x = ca.dot(v, v)
        return _multiply(z, ca.vertcat(half_angle_sinc(x) * v, _cos_half(x)))

    def difference(self, z0: ca.SX, z1: ca.SX) -> ca.SX:
        """Rotation vector of the shorter way."""
        d = _multiply(ca.vertcat(-z0[:3], z0[3]), z1)
        sign = ca.if_else(d[3] < 0, -1, 1)  # q and -q are the same attitude
        imaginary, w = sign * d[:3], sign * d[3]
        return log_factor(ca.dot(imaginary, imaginary), w) * imaginary

    def rate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """Half the product with the angular velocity, Eq. (14)."""
        return _multiply(z, ca.vertcat(v, 0)) / 2

    def bracket(self, a: ca.SX, b: ca.SX) -> ca.SX:
        """Cross product."""
        return ca.cross(a, b)

    def dexp(self, w: ca.SX, dw: ca.SX) -> ca.SX:
        """Series of brackets, summed."""
        return _body_velocity(w, dw)

    def attraction(self, z: ca.SX, gamma_quaternion: ca.SX, gamma_dcm: ca.SX) -> ca.SX:
        """Eq. (46)."""
        return gamma_quaternion * (1 / ca.dot(z, z) - 1) * z

    def projection(self, goal: ca.SX, z: ca.SX) -> ca.SX:
        """Twice the imaginary part of goal^-1 z; vanishes at both quaternions of the goal alone."""
        return 2 * _multiply(ca.vertcat(-goal[:3], goal[3]), z)[:3]

    def guards(self, goal: ca.SX, z: ca.SX) -> list[ca.SX]:
        """None: there is no other root."""
        return []

    def defects(self, z: ca.SX) -> list[ca.SX]:
        """Norm less one, Eq. (10)."""
        return [ca.norm_2(z) - 1]

    def rotate(self, z: ca.SX, p: ca.SX) -> ca.SX:
        """Vector p turned by z, as Pinocchio's rotation matrix of it would, unit or not."""
        t = 2 * ca.cross(z[:3], p)
        return p + z[3] * t + ca.cross(z[:3], t)

    def rotate_back(self, z: ca.SX, p: ca.SX) -> ca.SX:
        """Vector p turned by the conjugate of z."""
        return self.rotate(ca.vertcat(-z[:3], z[3]), p)


class RotationMatrix:
    """SO(3) as a direction cosine matrix, its nine numbers column by column."""

    nz, nv, is_vector = 9, 3, False

    def integrate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """R exp(v^), Eqs. (49), (50) with the square that the print of (50) has lost."""
        x, w = ca.dot(v, v), ca.skew(v)
        return ca.vec(_matrix(z) @ (ca.SX.eye(3) + sinc(x) * w + one_minus_cos(x) * (w @ w)))

    def difference(self, z0: ca.SX, z1: ca.SX) -> ca.SX:
        """Rotation vector of the shorter way, by way of the relative rotation's angle."""
        relative = _matrix(z0).T @ _matrix(z1)
        axis = vee(relative)  # sin(theta) times the axis
        x, cosine = ca.dot(axis, axis), (ca.trace(relative) - 1) / 2
        # theta / sin(theta) = 2 asin-like factor of the half angle: sin^2(theta/2) = (1 - cos)/2
        half = ca.sqrt(ca.fmax((1 + cosine) / 2, 1e-300))
        return log_factor(x / (4 * half**2), half) * axis / (2 * half)

    def rate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """R v^, Eq. (17)."""
        return ca.vec(_matrix(z) @ ca.skew(v))

    def bracket(self, a: ca.SX, b: ca.SX) -> ca.SX:
        """Cross product."""
        return ca.cross(a, b)

    def dexp(self, w: ca.SX, dw: ca.SX) -> ca.SX:
        """Series of brackets, summed."""
        return _body_velocity(w, dw)

    def attraction(self, z: ca.SX, gamma_quaternion: ca.SX, gamma_dcm: ca.SX) -> ca.SX:
        """-gamma R (R'R - I): Eq. (47) with sign and order mended; as printed the drift grows."""
        R = _matrix(z)
        return -gamma_dcm * ca.vec(R @ (R.T @ R - ca.SX.eye(3)))

    def projection(self, goal: ca.SX, z: ca.SX) -> ca.SX:
        """Skew part of goal' R; vanishes at every half-turn from the goal, too."""
        return vee(_matrix(goal).T @ _matrix(z))

    def guards(self, goal: ca.SX, z: ca.SX) -> list[ca.SX]:
        """tr(goal' R) - 1: 2 at the goal, -2 at the half-turns."""
        return [ca.dot(goal, z) - 1]

    def defects(self, z: ca.SX) -> list[ca.SX]:
        """Frobenius norm of R'R - I, Eq. (15)."""
        R = _matrix(z)
        return [ca.norm_fro(R.T @ R - ca.SX.eye(3))]

    def rotate(self, z: ca.SX, p: ca.SX) -> ca.SX:
        """R p."""
        return _matrix(z) @ p

    def rotate_back(self, z: ca.SX, p: ca.SX) -> ca.SX:
        """R' p."""
        return _matrix(z).T @ p


class RigidBody:
    """SE(3) as position and attitude, with the tangent (linear, angular) in the body."""

    is_vector = False

    def __init__(self, attitude: Quaternion | RotationMatrix) -> None:
        self.attitude = attitude
        self.nz, self.nv = 3 + attitude.nz, 6

    def integrate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """Moved along a screw."""
        moved = self.attitude.rotate(z[3:], _screw(v))
        return ca.vertcat(z[:3] + moved, self.attitude.integrate(z[3:], v[3:]))

    def difference(self, z0: ca.SX, z1: ca.SX) -> ca.SX:
        """Twist of the screw between."""
        w = self.attitude.difference(z0[3:], z1[3:])
        p = self.attitude.rotate_back(z0[3:], z1[:3] - z0[:3])
        linear = p - ca.cross(w, p) / 2 + v_inverse(ca.dot(w, w)) * ca.cross(w, ca.cross(w, p))
        return ca.vertcat(linear, w)

    def rate(self, z: ca.SX, v: ca.SX) -> ca.SX:
        """Velocity in the world, and of the attitude."""
        return ca.vertcat(self.attitude.rotate(z[3:], v[:3]), self.attitude.rate(z[3:], v[3:]))

    def bracket(self, a: ca.SX, b: ca.SX) -> ca.SX:
        """(omega_a x v_b - omega_b x v_a, omega_a x omega_b)."""
        return ca.vertcat(ca.cross(a[3:], b[:3]) - ca.cross(b[3:], a[:3]), ca.cross(a[3:], b[3:]))

    def dexp(self, w: ca.SX, dw: ca.SX) -> ca.SX:
        """Rate of the screw's end, in the axes there."""
        along = _along(_screw, w, dw)
        turn, x = w[3:], ca.dot(w[3:], w[3:])
        turned = ca.cross(turn, along)
        back = along - sinc(x) * turned + one_minus_cos(x) * ca.cross(turn, turned)
        return ca.vertcat(back, _body_velocity(turn, dw[3:]))

    def attraction(self, z: ca.SX, gamma_quaternion: ca.SX, gamma_dcm: ca.SX) -> ca.SX:
        """Of the attitude."""
        return ca.vertcat(ca.SX.zeros(3), self.attitude.attraction(z[3:], gamma_quaternion, gamma_dcm))

    def projection(self, goal: ca.SX, z: ca.SX) -> ca.SX:
        """Displacement in the goal's axes, projection of the attitude."""
        displacement = self.attitude.rotate_back(goal[3:], z[:3] - goal[:3])
        return ca.vertcat(displacement, self.attitude.projection(goal[3:], z[3:]))

    def guards(self, goal: ca.SX, z: ca.SX) -> list[ca.SX]:
        """Of the attitude."""
        return self.attitude.guards(goal[3:], z[3:])

    def defects(self, z: ca.SX) -> list[ca.SX]:
        """Of the attitude."""
        return self.attitude.defects(z[3:])


def _screw(v: ca.SX) -> ca.SX:
    """Displacement of exp(v), v a twist."""
    w, x = v[3:], ca.dot(v[3:], v[3:])
    turned = ca.cross(w, v[:3])
    return v[:3] + one_minus_cos(x) * turned + theta_minus_sin(x) * ca.cross(w, turned)


def _body_velocity(w: ca.SX, dw: ca.SX) -> ca.SX:
    """Angular velocity in the body of exp(w(t)) with w' = dw: the right Jacobian of rotations, times dw."""
    x, turned = ca.dot(w, w), ca.cross(w, dw)
    return dw - one_minus_cos(x) * turned + theta_minus_sin(x) * ca.cross(w, turned)


def _along(function: Callable[[ca.SX], ca.SX], w: ca.SX, dw: ca.SX) -> ca.SX:
    """Derivative of a function at w in the direction dw."""
    at, direction = ca.SX.sym("w", w.numel()), ca.SX.sym("dw", w.numel())
    rate = ca.jtimes(function(at), at, direction)
    return ca.Function("along", [at, direction], [ca.densify(rate)])(w, dw)


def _matrix(z: ca.SX) -> ca.SX:
    return ca.reshape(z, 3, 3)


def vee(R: ca.SX) -> ca.SX:
    """Axial vector of the skew part."""
    return ca.vertcat(R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]) / 2


def _cos_half(x: ca.SX) -> ca.SX:
    """cos(theta/2) = 1 - 2 sin^2(theta/4), smooth in x = theta^2."""
    return 1 - x / 8 * sinc(x / 16) ** 2


def _multiply(a: ca.SX, b: ca.SX) -> ca.SX:
    """Product of quaternions xyzw, Eq. (8)."""
    imaginary = a[3] * b[:3] + b[3] * a[:3] + ca.cross(a[:3], b[:3])
    return ca.vertcat(imaginary, a[3] * b[3] - ca.dot(a[:3], b[:3]))
