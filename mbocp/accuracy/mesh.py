r"""Steps that errors ask for: lengths of all steps, or numbers of equal steps.

A step has a local error e ~ h^(p+1) of its configuration, and its part of what constant controls cost more
than controls that are free to vary: with the rate of change of the controls and their weights R,

.. math:: c_n = \tfrac{1}{24} h_n^3\, \dot u_n^T R\, \dot u_n,

which is half the weighted square of what a ramp differs from its mean. For schemes of order four and more
the sum of these is the error of the cost, to leading order: the answer of the motion to controls that go up
and down from step to step is smaller by two more powers of h. For others only its distribution is taken from
them. The fewest steps with a given sum of :math:`D h^{q+1}` have lengths :math:`h \propto D^{-1/(q+1)}`.

Steps of given lengths may be short where errors are large. Where lengths are found with the motion, or belong
to phases, or where something is at nodes of equal steps, it is their numbers that change: of each phase, or
of all. With A the error of the cost of n steps times n^q, the fewest steps in all with a given sum of
A / n^q have :math:`n \propto A^{1/(q+1)}`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeAlias

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.problem import Problem
from mbocp.problem.coordinates import COORDINATES

MOST_STEPS = 20_000
_FLOOR = 1e-3  # of the mean density or share: where errors vanish steps do not become infinite
_STEEPEST = 0.25  # what the length of steps may change by, for each second
_FINER, _COARSER = 8.0, 2.0  # by which lengths and numbers change from one round to the next
_FEWEST, _FEWEST_OF_PHASE = 8, 4
_COARSEST = 4  # of which numbers are multiples: there are half and a quarter of them


@dataclass(frozen=True)
class ErrorTargets:
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
    return dts**3 * (rates**2 @ weights) / 24.0


def lengths_for(
    dts: Array, errors: Array, shares: Array, wanted: ErrorTargets, *, most: int, in_pairs: bool = True
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
    wanted : ErrorTargets
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
    return np.diff(nodes)


def _lengths_of_cost(dts: Array, shares: Array, wanted: ErrorTargets) -> Array:
    q = wanted.cost_order
    densities = shares / dts ** (q + 1)
    mean = densities @ dts / dts.sum()
    if not mean > 0.0:
        return np.full(len(dts), np.inf)
    roots = np.maximum(densities, _FLOOR * mean) ** (1.0 / (q + 1))
    scale = (wanted.cost / (roots @ dts)) ** (1.0 / q)
    return scale / roots


def _without_jumps(lengths: Array, dts: Array) -> Array:
    """Lengths that change by no more than a part of the way between steps."""
    found: Array = lengths.copy()
    ways = (dts[1:] + dts[:-1]) / 2.0
    for n in range(1, len(found)):
        found[n] = min(found[n], found[n - 1] + _STEEPEST * ways[n - 1])
    for n in reversed(range(len(found) - 1)):
        found[n] = min(found[n], found[n + 1] + _STEEPEST * ways[n])
    return found


@dataclass(frozen=True, eq=False)
class _Lengths:
    """Steps of given lengths [s], shape (N,): coarse ones, of which each is halved for the finer solution."""

    dts: Array

    @property
    def num_steps(self) -> int:
        """How many there are."""
        return len(self.dts)

    def of(self, problem: Problem) -> Problem:
        """The problem with these steps."""
        return problem.with_(accuracy=None, num_steps=self.num_steps, lengths=self.dts)

    def halve(self) -> _Lengths:
        """Twice as many."""
        return _Lengths(np.repeat(self.dts / 2.0, 2))

    def coarser(self) -> _Lengths:
        """Half as many, two by two."""
        return _Lengths(self.dts[::2] + self.dts[1::2])

    def even(self, factor: int) -> _Lengths:
        """As many times the steps, and as long as each other where lengths are given."""
        count = factor * self.num_steps
        return _Lengths(np.full(count, self.dts.sum() / count))

    def next(self, dts: Array, errors: Array, shares: Array, wanted: ErrorTargets) -> _Lengths:
        """Steps whose errors, halved, are as wanted.

        Parameters
        ----------
        dts : ndarray, shape (2 N,)
            Lengths of the halved steps [s].
        errors, shares : ndarray, shape (2 N,)
            Their local errors [rad, m] and shares in the error of the cost.
        wanted : ErrorTargets
        """
        return _Lengths(lengths_for(dts, errors, shares, wanted, most=MOST_STEPS + 2))

    def fewest(self, dts: Array, errors: Array, shares: Array, wanted: ErrorTargets) -> _Lengths:
        """Steps whose errors are as wanted as they are, from the same; nobody halves these or takes two."""
        return _Lengths(lengths_for(dts, errors, shares, wanted, most=MOST_STEPS, in_pairs=False))


_Whole: TypeAlias = tuple[int, ...]


@dataclass(frozen=True)
class _Counts:
    """The same for numbers of equal steps, of each phase or of all; found as multiples of `bases`."""

    counts: _Whole
    bases: _Whole

    @property
    def num_steps(self) -> int:
        return sum(self.counts)

    def of(self, problem: Problem) -> Problem:
        if not problem.phase:
            return problem.with_(accuracy=None, num_steps=self.num_steps)
        pairs = zip(problem.phase, self.counts, strict=True)
        return problem.with_(
            accuracy=None,
            phase=tuple(replace(phase, steps=count) for phase, count in pairs),
            duration=problem.duration,
            duration_range=problem.duration_range,
        )

    def halve(self) -> _Counts:
        return self.even(2)

    def coarser(self) -> _Counts:
        return _Counts(tuple(count // 2 for count in self.counts), self.bases)

    def even(self, factor: int) -> _Counts:
        return _Counts(tuple(factor * count for count in self.counts), self.bases)

    def next(self, dts: Array, errors: Array, shares: Array, wanted: ErrorTargets) -> _Counts:
        return _multiples(np.ceil(self._need(dts, errors, shares, wanted) / 2.0), self.bases)

    def fewest(self, dts: Array, errors: Array, shares: Array, wanted: ErrorTargets) -> _Counts:
        bases = tuple(base // _COARSEST for base in self.bases)
        return _multiples(np.ceil(self._need(dts, errors, shares, wanted)), bases)

    def _need(self, dts: Array, errors: Array, shares: Array, wanted: ErrorTargets) -> Array:
        """Numbers of steps whose errors are as wanted, which need not be whole."""
        fine = 2 * np.array(self.counts, dtype=np.float64)
        starts = np.append(0, np.cumsum(fine)[:-1]).astype(int)
        worst, q = np.maximum.reduceat(errors, starts), wanted.cost_order
        local = (worst / wanted.step) ** (1.0 / (wanted.order + 1))
        sums = np.add.reduceat(shares, starts)
        roots = (np.maximum(sums, _FLOOR * sums.mean()) * fine**q) ** (1.0 / (q + 1))
        needed = roots * (roots.sum() / wanted.cost) ** (1.0 / q) / fine
        factors = np.clip(np.fmax(local, needed), 1.0 / _COARSER, _FINER)
        return factors * fine


Mesh: TypeAlias = _Lengths | _Counts


def _multiples(counts: Array, bases: _Whole) -> _Counts:
    pairs = zip(np.maximum(counts, _FEWEST_OF_PHASE), bases, strict=True)
    return _Counts(tuple(base * int(np.ceil(count / base)) for count, base in pairs), bases)


def first_mesh(problem: Problem) -> Mesh:
    """Steps with which a search begins: 20, or those that phases say."""
    asked = problem.asked_nodes
    bases = tuple(_COARSEST * base for base in asked.base_counts())
    if problem.phase:
        return _multiples(np.array([phase.steps for phase in problem.phase], dtype=np.float64), bases)
    is_joint = COORDINATES[problem.coordinates].has_joint_states
    if problem.timeline.has_free_lengths or asked.follows_path or asked.has_any or not is_joint:
        return _multiples(np.array([float(problem.num_steps)]), bases)
    return _Lengths(np.full(problem.num_steps, problem.duration / problem.num_steps))
