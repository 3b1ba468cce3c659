r"""A lower bound of the integral of squared efforts over a given time.

For all functions :math:`\lambda(t)`, :math:`\nu(t)`, with :math:`\dot p = \tau - w` and p = M v,

.. math:: \int \tfrac{1}{2} \tau^T \alpha \tau \, dt \ge \Bigl[\lambda^T p + \nu^T q\Bigr]_0^T - \int q^T d\nu
    + \int \Bigl( \lambda^T w - (M \dot\lambda + \nu)^T v
    - \tfrac{1}{2} \lambda^T \alpha^{-1} \lambda \Bigr) dt

by :math:`\tfrac{1}{2} \alpha \tau^2 \ge \lambda \tau - \tfrac{1}{2} \lambda^2 / \alpha` and integration by
parts. In windows of time M, w, q and v are within boxes, over which the least value is taken. With lambda
and nu linear in each, what is left is concave in them, and its maximum the dual of a convex problem. Of w
the boxes hold what G q, the line of gravity, leaves. Any lambda and nu give a true bound, so that it does
not matter how exactly that is solved.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.bounds.task import Windows

_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.max_iter": 200,
    "ipopt.tol": 1e-6,
}


def least_squares(windows: Windows, weights: Array) -> float:
    r"""Bound the least :math:`\int \tfrac{1}{2} \tau^T \alpha \tau dt` from below.

    Parameters
    ----------
    windows : Windows
    weights : ndarray, shape (n,)
        Diagonal of alpha; infinite where no force acts.
    """
    K, n = windows.v.centre.shape
    lam, begin, end = (ca.SX.sym(name, n, k) for name, k in (("lam", K + 1), ("begin", K), ("end", K)))
    zero = ca.DM.zeros(n)
    leaps = ca.horzcat(begin, zero) - ca.horzcat(zero, end)  # of nu at the edges of windows
    slope, drift = (lam[:, 1:] - lam[:, :-1]) / windows.length, (end - begin) / windows.length
    turned = _each(windows.M.centre, slope)
    rest = ca.horzcat(turned + begin, turned + end)
    lines = np.swapaxes(windows.G, 1, 2)
    pull = ca.horzcat(_each(lines, lam[:, :-1]) - drift, _each(lines, lam[:, 1:]) - drift)
    # Absolute values are further unknowns, bounded from below by both signs.
    with_sizes = (lam, slope, rest, leaps, pull)
    sizes = [ca.SX.sym("size", *one.shape) for one in with_sizes]
    of_lam, of_slope, of_rest, of_leaps, of_pull = sizes
    value = -ca.dot(leaps, windows.q.centre.T) - ca.dot(of_leaps, windows.q.radius.T)
    for k, box, sign in ((0, windows.ends[0], -1.0), (K, windows.ends[1], 1.0)):
        value += sign * ca.dot(lam[:, k], box.centre) - ca.dot(of_lam[:, k], box.radius)
    lost = ca.dot(rest, _twice(windows.v.centre)) + ca.dot(of_rest, _twice(windows.v.radius))
    lost += ca.dot(of_pull, _twice(windows.inside.radius)) - ca.dot(pull, _twice(windows.inside.centre))
    mixed = np.einsum("kij,ki->kj", windows.M.radius, windows.v.size)
    lost += ca.dot(of_slope, mixed.T)
    gained = ca.dot(lam[:, 1:] + lam[:, :-1], windows.w.centre.T / 2.0)
    gained -= ca.dot(of_lam[:, 1:] + of_lam[:, :-1], windows.w.radius.T / 2.0)
    spread = np.broadcast_to(weights, (K, n)).T
    value += windows.length * (gained - lost) - _integrate(lam[:, :-1], lam[:, 1:], spread, windows.length)
    rows = [
        ca.vec(size + sign * one) for size, one in zip(sizes, with_sizes, strict=True) for sign in (1, -1)
    ]
    x = ca.veccat(lam, begin, end, *sizes)
    most = np.full(x.numel(), np.inf)
    most[: n * (K + 1)][np.tile(weights == 0.0, K + 1)] = 0.0
    scale = 1.0 / (1.0 + _typical(windows, weights))
    problem = {"x": x, "f": -scale * value, "g": ca.vertcat(*rows)}
    solver = ca.nlpsol("dual", "ipopt", problem, _OPTIONS)
    found = np.array(solver(lbx=-most, ubx=most, lbg=0.0, ubg=np.inf)["x"]).ravel()
    if not np.isfinite(found).all():
        return 0.0
    lams, nus = found[: n * (K + 1)].reshape(K + 1, n), found[n * (K + 1) :][: 2 * n * K].reshape(2, K, n)
    return max(dual_value(windows, weights, lams, nus), 0.0)


def _each(matrices: Array, columns: ca.SX) -> ca.SX:
    return ca.horzcat(*(ca.DM(matrix) @ columns[:, k] for k, matrix in enumerate(matrices)))


def _twice(rows: Array) -> Array:
    """Half of them for the begin of each window, half for its end."""
    return np.vstack([rows, rows]).T / 2.0


def dual_value(windows: Windows, weights: Array, lams: Array, nus: Array) -> float:
    """Value of the bound for any lambda and nu.

    Parameters
    ----------
    windows : Windows
    weights : ndarray, shape (n,)
    lams : ndarray, shape (K + 1, n)
        At the edges of windows.
    nus : ndarray, shape (2, K, n)
        Where windows begin, and where they end.
    """
    lams = np.where(weights > 0.0, lams, 0.0)
    h, start, end = windows.length, *windows.ends
    slopes = np.diff(lams, axis=0) / h
    zero = np.zeros((1, lams.shape[1]))
    leaps = np.vstack([nus[0], zero]) - np.vstack([zero, nus[1]])
    rest = np.einsum("kij,kj->ki", windows.M.centre, slopes) + nus
    at_edges = np.stack([lams[:-1], lams[1:]])
    pull = np.einsum("kij,eki->ekj", windows.G, at_edges) - (nus[1] - nus[0]) / h
    gained = [
        lams[-1] * end.centre - lams[0] * start.centre,
        -leaps * windows.q.centre,
        h * (lams[1:] + lams[:-1]) / 2.0 * windows.w.centre,
        h / 2.0 * (pull * windows.inside.centre - rest * windows.v.centre),
    ]
    lost = [
        np.abs(lams[-1]) * end.radius + np.abs(lams[0]) * start.radius,
        np.abs(leaps) * windows.q.radius,
        h * (np.abs(lams[1:]) + np.abs(lams[:-1])) / 2.0 * windows.w.radius,
        h / 2.0 * (np.abs(pull) * windows.inside.radius + np.abs(rest) * windows.v.radius),
        h * np.einsum("kij,kj->ki", windows.M.radius, np.abs(slopes)) * windows.v.size,
        _integrate(lams[:-1], lams[1:], weights, h),
    ]
    rounding = 1e-12 * sum(float(np.abs(part).sum()) for part in gained + lost)
    return sum(float(part.sum()) for part in gained) - sum(float(part.sum()) for part in lost) - rounding


def _integrate(a, b, weights: Array, h: float):  # type: ignore[no-untyped-def]
    """Integral of half the squares of lambda by the weights, between two edges; of symbols or numbers."""
    inverse = np.where(weights > 0.0, 1.0 / np.where(weights > 0.0, weights, 1.0), 0.0) * h / 6.0
    squares = a * a + a * b + b * b
    return ca.dot(squares, inverse) if isinstance(a, ca.SX) else squares * inverse


def _typical(windows: Windows, weights: Array) -> float:
    """Size of the cost of holding what opposes the forces, and of the motion without it."""
    T = windows.length * len(windows.w.centre)
    alpha = np.where(np.isfinite(weights), weights, 0.0)
    masses = np.diagonal(windows.M.centre, axis1=1, axis2=2).mean(axis=0)
    moved = 6.0 * (masses * (windows.q.centre[-1] - windows.q.centre[0])) ** 2 / T**3
    return float(np.sum(alpha * (moved + 0.5 * T * np.mean(_forces_at_centre(windows) ** 2, axis=0))))


def _forces_at_centre(windows: Windows) -> Array:
    return windows.w.centre + np.einsum("kij,kj->ki", windows.G, windows.inside.centre)
