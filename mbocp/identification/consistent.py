r"""Parameters of real bodies: estimates of base parameters, and for all else what the file says.

The pseudo-inertia of a body is positive definite. Its factor :math:`J = U U^T` with

.. math:: U = e^\alpha \begin{pmatrix}
    e^{d_1} & s_{12} & s_{13} & t_1 \\ & e^{d_2} & s_{23} & t_2 \\ & & e^{d_3} & t_3 \\ & & & 1\end{pmatrix}

makes it so for any ten numbers (Rucker and Wensing 2022). They are fitted to the base parameters, by their
covariance, and to those of the file's bodies: what torques do not tell stays near the file.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from mbocp._arrays import Array
from mbocp.identification.dynamics import PER_BODY
from mbocp.identification.unknown_parameters import BaseParameters, Unknowns, parameters_of, pseudo_inertia

_SPREAD = 0.5  # standard deviation of the logarithms before measuring: half as much again, or two thirds
_THINNEST = 1e-3  # second moments of a body by their sum: what is thinner is given this much
_RADIUS = 1e-3  # [m] below which a body is no larger in any file


class Consistent(NamedTuple):
    """Parameters that real bodies have.

    Parameters
    ----------
    values, sd : ndarray, shape (P,)
        In the order of `Unknowns.labels`; standard deviations hold what the file says for a measurement, too.
    covariance : ndarray, shape (P, P)
    distance : float
        Root mean square of what base parameters had to move, by their standard deviations.
    """

    values: Array
    sd: Array
    covariance: Array
    distance: float


def log_cholesky(pseudo: Array) -> Array:
    """The ten numbers alpha, d1, d2, d3, s12, s23, s13, t1, t2, t3 of a pseudo-inertia."""
    turned = np.linalg.cholesky(pseudo[::-1, ::-1])[::-1, ::-1]  # upper times its transpose
    alpha = np.log(turned[3, 3])
    U = turned / turned[3, 3]
    return np.array([alpha, *np.log(np.diag(U)[:3]), U[0, 1], U[1, 2], U[0, 2], *U[:3, 3]])


def body_of(theta: Array) -> Array:
    """Ten parameters of a body by the numbers of `log_cholesky`."""
    U = _factor(theta)
    return parameters_of(U @ U.T)


def body_slopes(theta: Array) -> Array:
    """Derivative of `body_of`, shape (10, 10)."""
    U, scale = _factor(theta), np.exp(theta[0])
    columns = []
    for k in range(PER_BODY):
        dU = np.zeros((4, 4))
        if k == 0:
            dU = U
        elif k < 4:
            dU[k - 1, k - 1] = U[k - 1, k - 1]
        else:
            dU[((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))[k - 4]] = scale
        columns.append(parameters_of(dU @ U.T + U @ dU.T))
    return np.asarray(np.array(columns).T)


def fit_consistent(unknowns: Unknowns, base: BaseParameters, beta: Array, covariance: Array) -> Consistent:
    """Fit bodies, friction and rotors to base parameters.

    A rotor of which the file says nothing may have any inertia: behind gears that of a wrist's is ten times
    that of all that turns with it.

    Parameters
    ----------
    unknowns : Unknowns
    base : BaseParameters
    beta, covariance : ndarray, shapes (rank,), (rank, rank)
    """
    bodies, size = len(unknowns.bodies), PER_BODY * len(unknowns.bodies)
    starts = [log_cholesky(_thick(pseudo_inertia(body.values))) for body in unknowns.bodies]
    scalars = unknowns.values[size:]
    sds = [_spread(start) for start in starts]
    scalar_sd = np.full(len(scalars), np.inf)
    rotors = np.array([label.name.endswith(".rotor") for label in unknowns.labels[size:]], dtype=bool)
    told = rotors & (scalars > 0.0)
    scalar_sd[told] = _SPREAD * scalars[told]
    prior = np.concatenate([*starts, scalars])
    weight = 1.0 / np.concatenate([*sds, scalar_sd])
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    C = base.combinations

    def values(theta: Array) -> Array:
        parts = [body_of(part) for part in theta[:size].reshape(bodies, PER_BODY)]
        return np.concatenate([*parts, theta[size:]])

    def slopes(theta: Array) -> Array:
        found = np.eye(len(theta))
        for k, part in enumerate(theta[:size].reshape(bodies, PER_BODY)):
            at = slice(PER_BODY * k, PER_BODY * (k + 1))
            found[at, at] = body_slopes(part)
        return found

    def rest(theta: Array) -> Array:
        return np.concatenate([white @ (C @ values(theta) - beta), weight * (theta - prior)])

    def rest_slopes(theta: Array) -> Array:
        return np.vstack([white @ C @ slopes(theta), np.diag(weight)])

    # Friction is well known from base parameters: begin there.
    start = prior.copy()
    at = {int(k): row for row, k in enumerate(base.chosen)}
    for k in range(size, len(start)):
        if k in at and not rotors[k - size]:
            start[k] = max(beta[at[k]], 0.0)
    lower = np.concatenate([np.full(size, -np.inf), np.zeros(len(scalars))])
    start[size:] = np.maximum(start[size:], 1e-9)
    found = least_squares(
        rest, start, jac=rest_slopes, bounds=(lower, np.inf), x_scale="jac", method="trf", max_nfev=200
    )
    J, D = rest_slopes(found.x), slopes(found.x)
    spread = D @ _inverse(J) @ D.T
    result = values(found.x)
    distance = white @ (C @ result - beta)
    return Consistent(
        result, np.sqrt(np.maximum(np.diag(spread), 0.0)), spread, float(np.sqrt(np.mean(distance**2)))
    )


def _inverse(J: Array) -> Array:
    """Inverse of J^T J, scaled."""
    scale = np.linalg.norm(J, axis=0)
    inner = np.linalg.pinv((J / scale).T @ (J / scale), hermitian=True)
    return np.asarray(inner / np.outer(scale, scale))


def _factor(theta: Array) -> Array:
    d, (s12, s23, s13), t = np.exp(theta[1:4]), theta[4:7], theta[7:]
    return np.asarray(
        np.exp(theta[0])
        * np.array([[d[0], s12, s13, t[0]], [0, d[1], s23, t[1]], [0, 0, d[2], t[2]], [0, 0, 0, 1.0]])
    )


def _spread(start: Array) -> Array:
    """Standard deviations before anything is measured: of lengths by the size of the body."""
    length = max(float(np.exp(start[1:4]).max()), float(np.abs(start[7:]).max()))
    return np.array([_SPREAD] * 4 + [_SPREAD * length] * 6)


def _thick(pseudo: Array) -> Array:
    """The nearest body that has some extent in all directions."""
    mass, first = pseudo[3, 3], pseudo[:3, 3]
    about = pseudo[:3, :3] - np.outer(first, first) / mass
    values, axes = np.linalg.eigh(about)
    least = _THINNEST * max(float(values.sum()), mass * _RADIUS**2)
    found: Array = pseudo.copy()
    found[:3, :3] += axes @ np.diag(np.maximum(least - values, 0.0)) @ axes.T
    return found
