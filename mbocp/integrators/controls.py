r"""Controls within a step: constant, linear in time, or with a value at each stage of the method.

A step has k values at shares c of its length, and its control is the polynomial through them,

.. math:: u(t_0 + s h) = \sum_i \ell_i(s)\, u_i, \qquad \ell_i(s) = \prod_{j \ne i} \frac{s - c_j}{c_i - c_j}.

- constant: one value. The optimal cost is of order two at best, whatever the order of the method.
- linear: the values of both ends; the control is continuous, and the cost of order four at best.
- stages: the values of the stages of the method. A symplectic method has its own order p in cost, states and
  adjoints then: the conditions of the optimum are those of a symplectic partitioned method with the same
  weights, in which the controls are eliminated stage by stage ([Hager2000]_, [Campos2015]_).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Literal, TypeAlias

import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp.integrators.pairs import PAIRS
from mbocp.integrators.schemes import SCHEMES

ControlKind: TypeAlias = Literal["constant", "linear", "stages"]
CONTROLS: tuple[ControlKind, ...] = ("constant", "linear", "stages")

_MOST = {"constant": 2, "linear": 4}  # order of the cost, by the order in which controls are approximated


def shares_of(kind: str, scheme: str) -> tuple[float, ...]:
    """Where in a step its controls have values, from 0 to 1; empty where they are constant."""
    if kind == "linear":
        return (0.0, 1.0)
    has_values = kind == "stages" and scheme in PAIRS and PAIRS[scheme].num_stages > 1
    return PAIRS[scheme].c if has_values else ()


def cost_order(kind: str, scheme: str) -> int:
    """Order in which the optimal cost converges."""
    order = SCHEMES[scheme].order
    return min(order, _MOST.get(kind, order))


def control_basis(shares: Sequence[float], at: Sequence[float] | Array) -> Array:
    """Polynomials that are one at a share and zero at the others, shape (m, k).

    Parameters
    ----------
    shares : sequence of float, length k
    at : sequence of float, length m
        Where they are evaluated, in parts of the step.
    """
    places = np.asarray(at, dtype=np.float64)
    columns = [
        np.prod([(places - b) / (a - b) for j, b in enumerate(shares) if j != i], axis=0)
        * np.ones_like(places)
        for i, a in enumerate(shares)
    ]
    return np.column_stack(columns)


def basis_slopes(shares: Sequence[float], at: float) -> Array:
    """Derivatives of these polynomials at one place, shape (k,)."""
    powers = np.linalg.inv(np.vander(shares, increasing=True))
    k = len(shares)
    return (np.arange(1.0, k) * at ** np.arange(0.0, k - 1.0)) @ powers[1:]


def controls_within(us: Array, values: Array, shares: Sequence[float], at: Sequence[float] | Array) -> Array:
    """Controls at parts `at` of each step, shape (N, m, nu); see `root_mean_squares` for what is given."""
    if not len(shares):
        return np.repeat(us[:, None], len(at), axis=1)
    return np.einsum("mk,nku->nmu", control_basis(shares, at), values)


@lru_cache(maxsize=64)
def control_powers(shares: tuple[float, ...]) -> Array:
    """From values to the coefficients of 1, s, s^2, ..., shape (k, k)."""
    return frozen_array(np.linalg.inv(np.vander(shares, increasing=True)))


@lru_cache(maxsize=64)
def control_means(shares: tuple[float, ...]) -> Array:
    """Weights of the values in the mean of the polynomial over the step, shape (k,)."""
    return frozen_array(control_powers(shares).T @ (1.0 / np.arange(1.0, len(shares) + 1.0)))


@lru_cache(maxsize=64)
def control_squares(shares: tuple[float, ...]) -> Array:
    """Matrix S of the mean u'Su of the polynomial's square over the step, shape (k, k); 1 for one value."""
    if not shares:
        return frozen_array(np.ones((1, 1)))
    orders = np.arange(float(len(shares)))
    powers = control_powers(shares)
    return frozen_array(powers.T @ (1.0 / (orders[:, None] + orders + 1.0)) @ powers)


def root_mean_squares(lengths: Array, us: Array, values: Array, shares: Sequence[float]) -> Array:
    """Root mean square of each control over a motion, shape (nu,).

    Parameters
    ----------
    lengths : ndarray, shape (N,)
        Of the steps [s]; in impacts, of length 0, no control acts.
    us : ndarray, shape (N, nu)
        Controls; where they vary within steps their means.
    values : ndarray, shape (N, k, nu)
        Those at `shares` of the steps, where they vary.
    shares : sequence of float
    """
    given = values if len(shares) else us[:, None]
    squares = np.einsum("nku,kl,nlu->nu", given, control_squares(tuple(shares)), given)
    return np.sqrt(np.maximum(lengths @ squares, 0.0) / lengths.sum())
