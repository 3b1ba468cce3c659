r"""Lengths of steps that errors ask for.

A step has a local error e ~ h^(p+1) of its configuration, and its part of what constant controls cost more
than controls that are free to vary: with the rate of change of the controls and their weights R,

.. math:: c_n = \tfrac{1}{24} h_n^3\, \dot u_n^T R\, \dot u_n,

which is half the weighted square of what a ramp differs from its mean. For schemes of order four and more
the sum of these is the error of the cost, to leading order: the answer of the motion to controls that go up
and down from step to step is smaller by two more powers of h. For others only its distribution is taken from
them. The fewest steps with a given sum of :math:`D h^{q+1}` have lengths :math:`h \propto D^{-1/(q+1)}`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbocp._arrays import Array

_FLOOR = 1e-3  # of the mean density: where errors vanish steps do not become infinite
_STEEPEST = 0.25  # what the length of steps may change by, for each second
_FINER, _COARSER = 8.0, 2.0  # by which steps change from one round to the next
_FEWEST = 8


@dataclass(frozen=True)
class Wanted:
    """What errors are to be at most.

    Attributes
    ----------
    step : float
        Local error of a step [rad, m].
    order : int
        p of the scheme.
    cost : float
        Error of the cost.
    cost_order : int
        q, with which it falls.
    """

    step: float
    order: int
    cost: float
    cost_order: int


def control_shares(us: Array, dts: Array, weights: Array) -> Array:
    """Shares of the steps in what constant controls cost, shape (N,).

    Parameters
    ----------
    us : ndarray, shape (N, nu)
    dts : ndarray, shape (N,)
        Lengths of the steps [s].
    weights : ndarray, shape (nu,)
        Of half the squares of the controls.
    """
    if len(dts) < 2:
        return np.zeros(len(dts))
    middles = np.cumsum(dts) - dts / 2.0
    rates = np.gradient(us, middles, axis=0)
    found: Array = dts**3 * (rates**2 @ weights) / 24.0
    return found


def halve(dts: Array) -> Array:
    """Each step as two."""
    found: Array = np.repeat(dts / 2.0, 2)
    return found


def lengths_for(
    dts: Array, errors: Array, shares: Array, wanted: Wanted, *, most: int, in_pairs: bool = True
) -> Array:
    """Lengths of steps whose errors are as wanted, shape (N,), or in pairs of equal ones, shape (N / 2,).

    The number of pairs is even, so that there are coarser ones of two pairs each.

    Parameters
    ----------
    dts : ndarray, shape (N,)
        Lengths of steps [s] whose errors are known.
    errors : ndarray, shape (N,)
        Local errors [rad, m].
    shares : ndarray, shape (N,)
        Of the steps in the error of the cost.
    wanted : Wanted
    most : int
        Number of steps.
    in_pairs : bool
        Whether each length found is that of two steps.
    """
    local = dts * (wanted.step / np.maximum(errors, _FLOOR * wanted.step)) ** (1.0 / (wanted.order + 1))
    lengths = np.minimum(local, _lengths_of_cost(dts, shares, wanted))
    lengths = np.clip(lengths, dts / _FINER, dts * _COARSER)
    lengths = _without_jumps(lengths, dts)
    ends = np.append(0.0, np.cumsum(dts))
    counted = np.append(0.0, np.cumsum(dts / lengths))
    needed = np.clip(counted[-1], _FEWEST, most)
    count = 2 * int(np.ceil(needed / 4.0)) if in_pairs else int(np.ceil(needed))
    nodes = np.interp(np.linspace(0.0, counted[-1], count + 1), counted, ends)
    found: Array = np.diff(nodes)
    return found


def _lengths_of_cost(dts: Array, shares: Array, wanted: Wanted) -> Array:
    q = wanted.cost_order
    densities = shares / dts ** (q + 1)
    mean = densities @ dts / dts.sum()
    if not mean > 0.0:
        return np.full(len(dts), np.inf)
    roots = np.maximum(densities, _FLOOR * mean) ** (1.0 / (q + 1))
    scale = (wanted.cost / (roots @ dts)) ** (1.0 / q)
    found: Array = scale / roots
    return found


def _without_jumps(lengths: Array, dts: Array) -> Array:
    """Lengths that change by no more than a part of the way between steps."""
    found: Array = lengths.copy()
    ways = (dts[1:] + dts[:-1]) / 2.0
    for n in range(1, len(found)):
        found[n] = min(found[n], found[n - 1] + _STEEPEST * ways[n - 1])
    for n in reversed(range(len(found) - 1)):
        found[n] = min(found[n], found[n + 1] + _STEEPEST * ways[n])
    return found
