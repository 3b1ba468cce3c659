r"""The optimality conditions of a programme at a solution, as one sparse linear system.

With the Lagrangian :math:`\mathcal{L} = \sum_n (l_n + m_n^T c_n + w_n^T h_n) + \psi + \eta^T g`, the active
limits :math:`h_A = b_A` as equations and the others left out, unknowns and multipliers
:math:`\zeta = (x, y, u, m, \eta, w_A)` solve

.. math:: F(\zeta, p) = (\nabla_{(x, y, u)} \mathcal{L},\; c,\; g,\; h_A - b_A) = 0 .

Its derivative K in :math:`\zeta` is symmetric, with blocks along the horizon: its sparse factors take work
and memory in proportion to the number of steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbocp._arrays import Array, BoolArray, IntArray
from mbocp.exceptions import SingularSystem
from mbocp.programme import StagewiseProgramme
from mbocp.programme.compilation import CompiledFunctions

if TYPE_CHECKING:
    from scipy import sparse

_PASSES = 3  # of a solve with the factors: what pivoting leaves is round-off after two
_MOST_LEFT = 1e-7  # relative residual of a solution of a system that is not singular
_ROUND_OFF = 1e-16  # least pivot, by the largest


@dataclass(frozen=True, eq=False)
class Optimum:
    """A solution of a programme with the multipliers of all it knows.

    Attributes
    ----------
    programme : StagewiseProgramme
    xs, ys, us, ms, eta : ndarray
        See `Iterate`.
    ws : ndarray, shape (N, nx + nu + nh)
        Multipliers of the limits of states, controls and path functions, positive at an upper one.
    held : ndarray of bool, shape (N, nx + nu + nh)
        Which of them are active.
    sides : ndarray, shape (N, nx + nu + nh)
        The bound that each of these is at.
    """

    programme: StagewiseProgramme
    xs: Array
    ys: Array
    us: Array
    ms: Array
    eta: Array
    ws: Array
    held: BoolArray
    sides: Array

    @property
    def points(self) -> list[Array]:
        """States before and after each step, algebraic unknowns and controls."""
        return [self.xs[:-1], self.xs[1:], self.ys, self.us]

    @property
    def path(self) -> Array:
        """Multipliers of the path functions, shape (N, nh)."""
        kind = self.programme.kind
        return self.ws[:, kind.nx + kind.nu :]


class Parts(NamedTuple):
    """A vector of the system in parts: rows of F, or unknowns and multipliers.

    Attributes
    ----------
    xs, ys, us : ndarray, shapes (k, N, ndx), (k, N, ny), (k, N, nu)
        Of the states of the nodes 1..N, and of the steps.
    ms : ndarray, shape (k, N, ndx + ny)
    eta : ndarray, shape (k, ng)
    ws : ndarray, shape (k, N, nx + nu + nh)
        Zero where limits are not active.
    """

    xs: Array
    ys: Array
    us: Array
    ms: Array
    eta: Array
    ws: Array


@dataclass(frozen=True, eq=False)
class Places:
    """Where unknowns and multipliers are in a vector of the system.

    Attributes
    ----------
    xs, ys, us, ms, ws : ndarray of int
        See `Parts`, without the first axis; `xs` has the given state first, behind all unknowns, and `ws` the
        size of the system where limits are not active.
    eta : ndarray of int
    size, whole : int
        Of the system, and with the given state.
    """

    xs: IntArray
    ys: IntArray
    us: IntArray
    ms: IntArray
    ws: IntArray
    eta: IntArray
    size: int
    whole: int

    @classmethod
    def of(cls, optimum: Optimum) -> Places:
        """Places in the order of the horizon."""
        programme, held = optimum.programme, optimum.held
        kind = programme.kind
        nc = kind.ndx + kind.ny
        counts = nc + kind.ny + kind.nu + held.sum(axis=1) + kind.ndx
        first = np.concatenate([[0], np.cumsum(counts)])
        begin = first[:-1, None]
        ms = begin + np.arange(nc)
        ys = begin + nc + np.arange(kind.ny)
        us = begin + nc + kind.ny + np.arange(kind.nu)
        xs = first[1:, None] - kind.ndx + np.arange(kind.ndx)
        eta = first[-1] + np.arange(programme.ng)
        size = int(first[-1]) + programme.ng
        ws = np.where(held, begin + nc + kind.ny + kind.nu + held.cumsum(axis=1) - 1, size + kind.ndx)
        start = size + np.arange(kind.ndx)
        whole = size + kind.ndx
        return cls(np.vstack([start, xs]), ys, us, ms, ws, eta, size, whole)

    def join(self, parts: Parts) -> Array:
        """Vectors of the system, shape (size, k)."""
        k = len(parts.eta)
        found = np.zeros((k, self.whole + 1))
        pairs = zip((self.xs[1:], self.ys, self.us, self.ms, self.eta, self.ws), parts, strict=True)
        for place, values in pairs:
            found[:, place] = values
        return np.ascontiguousarray(found[:, : self.size].T)

    def split(self, vectors: Array) -> Parts:
        """Parts of vectors of the system."""
        filled = np.zeros((vectors.shape[1], self.whole + 1))
        filled[:, : self.size] = vectors.T
        return Parts(*(filled[:, at] for at in (self.xs[1:], self.ys, self.us, self.ms, self.eta, self.ws)))

    def only(self, vector: Array) -> Parts:
        """Parts of one vector of the system, without a first axis."""
        return Parts(*(part[0] for part in self.split(vector[:, None])))


@dataclass(frozen=True, eq=False)
class Kkt:
    """The system at an optimum, factorised when it is first solved.

    Attributes
    ----------
    optimum : Optimum
    places : Places
    residual : ndarray, shape (size,)
        F.
    matrix : sparse matrix, shape (size, size)
        K.
    of_start : sparse matrix, shape (size, ndx)
        Derivative of F in the tangent of the given state.
    """

    optimum: Optimum
    places: Places
    residual: Array
    matrix: sparse.csc_matrix
    of_start: sparse.csc_matrix

    @classmethod
    def at(cls, optimum: Optimum) -> Kkt:
        """Evaluate the system at a point near an optimum.

        Raises
        ------
        SingularSystem
            If its functions are not finite there.
        """
        from scipy import sparse  # slow to import, and wanted only for this

        places = Places.of(optimum)
        evaluation = _Evaluation(places)
        evaluation.add_steps(optimum)
        evaluation.add_end(optimum)
        evaluation.add_limits(optimum)
        size = places.size
        indices = np.concatenate(evaluation.rows), np.concatenate(evaluation.columns)
        shape = (places.whole + 1, places.whole + 1)  # the last of all is of limits that are not active
        matrix = sparse.coo_matrix((np.concatenate(evaluation.values), indices), shape=shape).tocsc()
        start = slice(size, places.whole)
        return cls(optimum, places, evaluation.residual[:size], matrix[:size, :size], matrix[:size, start])

    @cached_property
    def _factors(self) -> _Factors:
        from scipy.sparse.linalg import splu

        largest = abs(self.matrix).max(axis=0).toarray().ravel()
        if not np.isfinite(largest).all() or not largest.all():
            raise _singular()
        scale = 1.0 / np.sqrt(largest)
        scaled = self.matrix.multiply(scale[:, None]).multiply(scale[None]).tocsc()
        try:
            factors = splu(scaled, permc_spec="NATURAL")  # along the horizon: a band
        except RuntimeError as error:  # SciPy: exactly singular
            raise _singular() from error
        pivots = np.abs(factors.U.diagonal())
        if pivots.min() <= _ROUND_OFF * pivots.max():
            raise _singular()
        return _Factors(scale, factors.solve)

    def solve(self, right: Array) -> Array:
        """K^-1 of some right-hand sides, shape (size, k); K is symmetric, so these are adjoints, too.

        Raises
        ------
        SingularSystem
            If K has no inverse: the solution is not the only one near.
        """
        found, left = np.zeros_like(right), right
        for _ in range(_PASSES):
            found = found + self._factors.solve(left)
            left = right - self.matrix @ found
        largest = np.abs(right).max(initial=0.0) + np.abs(self.matrix @ found).max(initial=0.0)
        if not np.abs(left).max(initial=0.0) <= _MOST_LEFT * largest:  # NaN, too
            raise _singular()
        return found


@dataclass(frozen=True, eq=False)
class _Factors:
    """Factors of a system with rows and columns scaled alike."""

    scale: Array
    of_scaled: Callable[[Array], Array]

    def solve(self, right: Array) -> Array:
        return self.scale[:, None] * self.of_scaled(self.scale[:, None] * right)


class _Evaluation:
    """Residual and entries of the system, as far as they have been added up."""

    def __init__(self, places: Places) -> None:
        self.places = places
        self.residual = np.zeros(places.whole + 1)
        self.rows: list[IntArray] = []
        self.columns: list[IntArray] = []
        self.values: list[Array] = []

    def add_steps(self, optimum: Optimum) -> None:
        """Cost and rows of all steps."""
        at, programme = self.places, optimum.programme
        c, _, jacobian, slopes, hessian = call(
            programme.functions,
            "complete",
            programme.num_steps,
            [*optimum.points, optimum.ms, programme.theta, programme.rho],
        )
        zs = np.hstack([at.xs[1:], at.ys, at.xs[:-1], at.us])
        self._add_rows(at.ms, c)
        self._add_slopes(zs, slopes)
        self._add_jacobian(at.ms, zs, jacobian, optimum.ms)
        self._add_hessian(zs, hessian)

    def add_end(self, optimum: Optimum) -> None:
        """Cost and condition of the end."""
        at, programme = self.places, optimum.programme
        given = [optimum.xs[-1], optimum.eta, programme.rho_terminal]
        _, g, jacobian, slopes, hessian = call(programme.end_functions, "terminal_complete", 1, given)
        eta, last = at.eta[None], at.xs[-1:]
        self._add_rows(eta, g)
        self._add_slopes(last, slopes)
        self._add_jacobian(eta, last, jacobian, optimum.eta[None])
        self._add_hessian(last, hessian)

    def add_limits(self, optimum: Optimum) -> None:
        """Active limits, with the curvature of path functions."""
        at, programme = self.places, optimum.programme
        kind, nh, N = programme.kind, programme.bounds.nh, programme.num_steps
        plain = kind.nx + kind.nu
        held, ws = optimum.held, np.where(optimum.held, optimum.ws, 0.0)
        unknowns = np.hstack([at.xs[1:], at.us]) if kind.nx == kind.ndx else at.us
        own = slice(plain - unknowns.shape[1], plain)  # states that are no plain vectors have no limits
        self._add_plain(unknowns, at.ws[:, own], held[:, own], ws[:, own])
        values = np.hstack([optimum.xs[1:], optimum.us, np.zeros((N, nh))])
        if nh:
            rows = at.ws[:, plain:]
            given = [optimum.xs[1:], ws[:, plain:], optimum.us, programme.theta]
            h, jacobian, hessian = call(programme.functions, "path", N, given)
            values[:, plain:] = h.dense(nh)
            self._add_jacobian(rows, at.xs[1:], jacobian, ws[:, plain:])
            self._add_hessian(at.xs[1:], hessian)
        self.residual[at.ws[held]] = (values - optimum.sides)[held]

    def _add_plain(self, unknowns: IntArray, rows: IntArray, held: BoolArray, ws: Array) -> None:
        """Limits of unknowns."""
        i, j = rows[held], unknowns[held]
        self._add(i, j, np.ones(i.size))
        self._add(j, i, np.ones(i.size))
        self.residual[j] += ws[held]

    def _add_rows(self, rows: IntArray, found: Nonzeros) -> None:
        self.residual[rows] += found.dense(rows.shape[1])

    def _add_slopes(self, zs: IntArray, found: Nonzeros) -> None:
        np.add.at(self.residual, zs[:, found.columns], found.values)

    def _add_jacobian(self, rows: IntArray, zs: IntArray, found: Nonzeros, multipliers: Array) -> None:
        """Derivatives of rows, and what their multipliers make of them."""
        i, j = rows[:, found.rows], zs[:, found.columns]
        self._add(i, j, found.values)
        self._add(j, i, found.values)
        np.add.at(self.residual, j, found.values * multipliers[:, found.rows])

    def _add_hessian(self, zs: IntArray, found: Nonzeros) -> None:
        """Both halves of which the upper one is given."""
        i, j = zs[:, found.rows], zs[:, found.columns]
        self._add(i, j, found.values)
        apart = found.rows != found.columns
        self._add(j[:, apart], i[:, apart], found.values[:, apart])

    def _add(self, rows: IntArray, columns: IntArray, values: Array) -> None:
        self.rows.append(rows.ravel())
        self.columns.append(columns.ravel())
        self.values.append(values.ravel())


class Nonzeros(NamedTuple):
    """Numbers of one output of a function at some points.

    Attributes
    ----------
    rows, columns : ndarray of int, shape (nnz,)
    values : ndarray, shape (count, nnz)
    """

    rows: IntArray
    columns: IntArray
    values: Array

    def dense(self, size: int) -> Array:
        """Columns, shape (count, size)."""
        found = np.zeros((len(self.values), size))
        found[:, self.rows] = self.values
        return found


def call(
    functions: CompiledFunctions, name: str, count: int, inputs: Sequence[Array]
) -> tuple[Nonzeros, ...]:
    """Outputs of a function at `count` points; inputs are of each point, or of all.

    Raises
    ------
    SingularSystem
        If an output is not finite.
    """
    function = functions.function(name)
    sizes = [function.size1_in(i) for i in range(function.n_in())]
    blocks = [
        value.reshape(-1, size) if size else np.zeros((1, 0))
        for value, size in zip(inputs, sizes, strict=True)
    ]
    given = [np.broadcast_to(block, (count, block.shape[1])).ravel() for block in blocks]
    try:
        found = functions.stage_function(name).evaluate(given, count, True)
    except RuntimeError as error:  # the kernel: a function has failed
        raise SingularSystem("sensitivities: functions of the problem are not finite there") from error
    outputs = []
    for k, values in enumerate(found):
        rows, columns = function.sparsity_out(k).get_triplet()
        pattern = np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp)
        outputs.append(Nonzeros(*pattern, values.reshape(count, -1)))
    return tuple(outputs)


def moved(optimum: Optimum, step: Parts, start: Array | None = None) -> Optimum:
    """The optimum after a step, whose parts have no first axis, and one of the given state, shape (ndx,)."""
    programme, kind = optimum.programme, optimum.programme.kind
    steps = np.vstack([np.zeros(kind.ndx) if start is None else start, step.xs])
    (xs,) = call(programme.functions, "retract", programme.num_steps + 1, [optimum.xs, steps])
    return replace(
        optimum,
        xs=xs.dense(kind.nx),
        ys=optimum.ys + step.ys,
        us=optimum.us + step.us,
        ms=optimum.ms + step.ms,
        eta=optimum.eta + step.eta,
        ws=optimum.ws + step.ws,
    )


def _singular() -> SingularSystem:
    return SingularSystem(
        "sensitivities: the optimality conditions have no unique derivative: the solution is not the only "
        "optimum near, or some of its conditions or active limits follow from others"
    )
