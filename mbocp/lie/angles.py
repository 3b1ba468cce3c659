r"""Scalar functions behind the exponential and the logarithm, as functions of x = theta^2.

In x they are analytic at zero, where every Newton update is taken. Closed forms divide by zero there, and
CasADi's `if_else` carries the NaN of a branch not taken into the derivatives; so each function is its power
series up to a threshold and the closed form with a harmless argument below it. Both branches agree at the
threshold to round-off, in value and in the first two derivatives.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import factorial

import casadi as ca

_TERMS = 12  # x^12 / 25! is below 1e-25 at x = 1
# Absolute values of the numbers B_2, B_4, ...
_BERNOULLI = (1 / 6, 1 / 30, 1 / 42, 1 / 30, 5 / 66, 691 / 2730, 7 / 6, 3617 / 510, 43867 / 798, 174611 / 330)


def sinc(x: ca.SX) -> ca.SX:
    r""":math:`\sin\theta / \theta`."""
    series = [(-1) ** k / factorial(2 * k + 1) for k in range(_TERMS)]
    return _branch(x, 1.0, series, lambda t: ca.sin(t) / t)


def half_angle_sinc(x: ca.SX) -> ca.SX:
    r""":math:`\sin(\theta/2) / \theta`, the quaternion's imaginary part per radian."""
    return sinc(x / 4) / 2


def one_minus_cos(x: ca.SX) -> ca.SX:
    r""":math:`(1 - \cos\theta) / \theta^2`, as :math:`\tfrac12 \mathrm{sinc}^2(\theta/2)`."""
    return sinc(x / 4) ** 2 / 2


def theta_minus_sin(x: ca.SX) -> ca.SX:
    r""":math:`(\theta - \sin\theta) / \theta^3`."""
    series = [(-1) ** k / factorial(2 * k + 3) for k in range(_TERMS)]
    return _branch(x, 1.0, series, lambda t: (t - ca.sin(t)) / t**3)


def v_inverse(x: ca.SX) -> ca.SX:
    r""":math:`(1 - \tfrac{\theta}{2} \cot\tfrac{\theta}{2}) / \theta^2`, in the left Jacobian's inverse."""
    series = [b / factorial(2 * k + 2) for k, b in enumerate(_BERNOULLI)]  # |B_2k| / (2k)!
    return _branch(x, 0.5, series, lambda t: (1 - t / 2 * ca.cos(t / 2) / ca.sin(t / 2)) / t**2)


def log_factor(x: ca.SX, w: ca.SX) -> ca.SX:
    r"""Rotation vector per imaginary part of a unit quaternion (v, w), with x = v . v and w >= 0.

    :math:`2 \arcsin(\sqrt x) / \sqrt x` near the identity, with the two-argument arctangent elsewhere.
    """
    series, coefficient = [], 2.0
    for k in range(_TERMS):
        series.append(coefficient)
        coefficient *= (2 * k + 1) ** 2 / ((2 * k + 2) * (2 * k + 3))
    return _branch(x, 0.02, series, lambda s: 2 * ca.atan2(s, w) / s)


def _branch(x: ca.SX, threshold: float, series: Sequence[float], closed: Callable[[ca.SX], ca.SX]) -> ca.SX:
    is_small = x < threshold
    value = ca.SX(series[-1])
    for coefficient in reversed(series[:-1]):
        value = coefficient + x * value
    return ca.if_else(is_small, value, closed(ca.sqrt(ca.if_else(is_small, 1.0, x))))
