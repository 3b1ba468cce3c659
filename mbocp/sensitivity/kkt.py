r"""The optimality conditions of a programme at a solution, as one linear system.

With the Lagrangian :math:`\mathcal{L} = \sum_n (l_n + m_n^T c_n + w_n^T h_n) + \psi + \eta^T g`, the active
limits :math:`h_A = b_A` as equations and the others left out, unknowns and multipliers
:math:`\zeta = (x, y, u, m, \eta, w_A)` solve

.. math:: F(\zeta, p) = (\nabla_{(x, y, u)} \mathcal{L},\; c,\; g,\; h_A - b_A) = 0 .

Its derivative K in :math:`\zeta` is symmetric, and the matrix of a Newton step: the kernel's Riccati
recursion factorises it once, and solves it for any right-hand side, in time linear in the number of steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.exceptions import SingularSystem, SolverError
from mbocp.programme import Iterate, StagewiseProgramme
from mbocp.programme.evaluation import call
from mbocp.solvers.newton_method.held_limits import FIRST_WEIGHT, factorise_held, hold

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelProgramme

_MOST_LEFT = 1e-7  # relative residual of a solution of a system that is not singular
_MOST_APART = 1e-6  # of what solutions add up to: by it derivatives may be wrong
_GRAIN = 64 * 2.0**-52  # of the largest entry of all: what is less is round-off
_OF_MOTION = 3  # parts: states, algebraic unknowns, controls; multipliers follow
_OTHER_WEIGHT = 0.3 * FIRST_WEIGHT  # of the end condition


@dataclass(frozen=True, eq=False)
class Optimum:
    """A solution of a programme with the multipliers of all it knows.

    Attributes
    ----------
    programme : StagewiseProgramme
    iterate : Iterate
    ws : ndarray, shape (N, nx + nu + nh)
        Multipliers of the limits of states, controls and path functions, positive at an upper one.
    held : ndarray of bool, shape (N, nx + nu + nh)
        Which of them are active.
    sides : ndarray, shape (N, nx + nu + nh)
        The bound that each of these is at.
    """

    programme: StagewiseProgramme
    iterate: Iterate
    ws: Array
    held: BoolArray
    sides: Array

    @property
    def points(self) -> list[Array]:
        """States before and after each step, algebraic unknowns and controls."""
        at = self.iterate
        return [at.xs[:-1], at.xs[1:], at.ys, at.us]

    @property
    def path(self) -> Array:
        """Multipliers of the path functions, shape (N, nh)."""
        kind = self.programme.kind
        return self.ws[:, kind.nx + kind.nu :]


class Parts(NamedTuple):
    """Vectors of the system in parts: rows of F, or unknowns and multipliers.

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

    @classmethod
    def zeros(cls, programme: StagewiseProgramme, k: int) -> Parts:
        """So many vectors of zeros."""
        kind, N = programme.kind, programme.num_steps
        limits = kind.nx + kind.nu + programme.bounds.nh
        of_steps = [(N, size) for size in (kind.ndx, kind.ny, kind.nu, kind.ndx + kind.ny)]
        return cls(*(np.zeros((k, *shape)) for shape in (*of_steps, (programme.ng,), (N, limits))))


class Solved(NamedTuple):
    """Solutions of the system, and their share in its rows of the given state, shape (k, ndx).

    Where conditions depend on each other, multipliers are found but for multiples of what is `free`.
    """

    parts: Parts
    of_start: Array
    free: Parts | None = None


@dataclass(frozen=True, eq=False)
class Kkt:
    """The system at an optimum.

    Attributes
    ----------
    optimum : Optimum
    """

    optimum: Optimum
    _native: KernelProgramme  # with K's factors

    @classmethod
    def near(cls, optimum: Optimum, *, most_steps: int, still: float, far: float) -> Kkt:
        """The system where it holds, found by Newton's method.

        Parameters
        ----------
        optimum : Optimum
        most_steps : int
        still, far : float
            Steps by the size of what they move: the last one, and the most of the first one.

        Raises
        ------
        SingularSystem
            If K has no inverse.
        SolverError
            If Newton's method does not stay near; the message has the length of its last step.
        """
        programme, held = optimum.programme, optimum.held
        native = hold(programme, optimum.iterate, optimum.ws, held, optimum.sides)
        length = far
        for _ in range(most_steps):
            if not (native.evaluate().finite and factorise_held(native, programme)):
                raise _singular()
            native.solve()
            before, length = length, max(_relative(native.dx, native.x), _relative(native.du, native.u))
            if not length <= before:
                break
            if length <= still:
                ws = np.zeros_like(optimum.ws)
                ws[held] = native.z_upper if held.any() else 0.0
                found = Optimum(programme, Iterate.read_from(native, programme), ws, held, optimum.sides)
                return cls(found, native)
            native.move(1.0)
            native.accept(1.0)
        raise SolverError(
            "sensitivities: the optimality conditions do not hold near the solution with the limits that are "
            f"active there (a Newton step is {length:.1e} of the motion); solve with "
            "solver.tolerance = 1e-12, if it is larger"
        )

    @cached_property
    def of_start(self) -> tuple[Array, Array, Array, Array]:
        """Derivative of F in the tangent of the given state, shapes (ndx, any).

        Of the first rows alone that belong to states, algebraic unknowns and controls, and of the first step.
        """
        return _of_start(self.optimum)

    def solve(self, right: Parts) -> Solved:
        """K^-1 of some right-hand sides; K is symmetric, so these are adjoints, too.

        Raises
        ------
        SingularSystem
            If states, algebraic unknowns and controls are not unique: the solution is not the only one near.
        """
        held, count = self.optimum.held, len(right.eta)
        rows = [part.ravel() for part in (*right[:-1], right.ws[:, held])]
        found, of_start, left, apart, largest = self._native.solve_for(rows, count)
        if not _is_round_off(apart, largest):
            raise _singular()
        free = None
        if not left <= _MOST_LEFT:  # round-off of large terms, or what wrong factors leave
            free = self._compare_with_other_factors(found, rows, count)
        return Solved(
            self._parts(found, right),
            of_start.reshape(count, -1),
            None if free is None else self._parts(free, right),
        )

    def of_multipliers(self, free: Parts) -> Solved:
        """Some multipliers as a solution."""
        return Solved(free, np.einsum("kr,ir->ki", free.ms[:, 0], self.of_start[3]))

    def _parts(self, found: Sequence[Array], like: Parts) -> Parts:
        ws = np.zeros_like(like.ws)
        ws[:, self.optimum.held] = found[-1].reshape(len(ws), -1)
        of_rest = (f.reshape(r.shape) for f, r in zip(found[:-1], like[:-1], strict=True))
        return Parts(*of_rest, ws)  # type: ignore[call-arg]

    def _compare_with_other_factors(
        self, found: Sequence[Array], rows: Sequence[Array], count: int
    ) -> list[Array] | None:
        """Solve with another weight of the end, on which solutions depend where K is singular.

        By which multipliers depend on it, if unknowns do not.
        """
        programme = self.optimum.programme
        if not (programme.ng and factorise_held(self._native, programme, first=_OTHER_WEIGHT)):
            raise _singular()
        again, *_ = self._native.solve_for(rows, count)
        factorise_held(self._native, programme)  # as before, for what is solved next
        return _what_is_free(*([part.reshape(count, -1) for part in parts] for parts in (rows, found, again)))


def _what_is_free(right: list[Array], found: list[Array], again: list[Array]) -> list[Array] | None:
    """By which multipliers of two solutions differ, or None if these are the same but for round-off.

    Raises
    ------
    SingularSystem
        If unknowns differ, or what depends on each other cannot move as the right-hand side says.
    """
    apart = [other - one for one, other in zip(found, again, strict=True)]
    sizes, largest = (np.array([_largest(part) for part in parts]) for parts in (apart, found))
    is_next_to_nothing = largest[:_OF_MOTION].max(axis=0) <= _GRAIN * largest[-1]  # limits bear all of it
    same = _are_round_off(sizes[:-1], largest[:-1]) | is_next_to_nothing
    if same.all():
        return None
    pairs = zip(apart[_OF_MOTION:], right[_OF_MOTION:], strict=True)
    products = np.sum([np.sum(a * b, axis=1) for a, b in pairs], axis=0)
    scale = sizes.max(axis=0) * np.sum([np.abs(part).sum(axis=1) for part in right], axis=0)
    fits = _are_round_off(sizes[:_OF_MOTION], largest[:_OF_MOTION])
    fits &= np.abs(products) <= _MOST_APART * scale
    if not (same | fits).all():
        raise _singular()
    return [np.where(same[:, None] | (k < _OF_MOTION), 0.0, part).ravel() for k, part in enumerate(apart)]


def _are_round_off(apart: Array, largest: Array) -> BoolArray:
    """Whether columns are, each by itself."""
    return np.array([_is_round_off(*pair) for pair in zip(apart.T, largest.T, strict=True)])


def _is_round_off(apart: Array, largest: Array) -> bool:
    """Whether parts of solutions are as far apart as round-off makes them, by their largest entries."""
    least = np.maximum(_MOST_APART * largest, _GRAIN * largest.max(initial=0.0))
    return bool((apart <= least).all())  # not with NaN


def check_unique(found: Array, free: Array) -> None:
    """Refuse what multipliers that are not unique say something else of, see `Solved`.

    Raises
    ------
    SingularSystem
    """
    if not _is_round_off(np.abs(free).max(initial=0.0), np.abs(found).max(initial=0.0)):
        raise _singular()


def _largest(part: Array) -> Array:
    return np.abs(part).max(axis=1, initial=0.0)


def _relative(step: Array, whole: Array) -> float:
    """The largest entry of a step by the size of what it moves."""
    return float(np.abs(step).max(initial=0.0) / (1.0 + np.abs(whole).max(initial=0.0)))


def _of_start(optimum: Optimum) -> tuple[Array, Array, Array, Array]:
    programme = optimum.programme
    kind, ndx = programme.kind, programme.kind.ndx
    inputs = [*(part[:1] for part in optimum.points), optimum.iterate.ms[:1]]
    given = [*inputs, programme.theta, programme.rho.ravel()[: kind.nr]]
    _, _, jacobian, _, hessian = call(programme.functions, "complete", 1, given)
    start, end = ndx + kind.ny, 2 * ndx + kind.ny  # columns are (x1, y, x0, u)
    of_rows = jacobian.matrix((start, end + kind.nu))[:, start:end].T
    whole = hessian.matrix((end + kind.nu, end + kind.nu))
    slopes = (whole + np.triu(whole, 1).T)[start:end]
    return slopes[:, :ndx], slopes[:, ndx:start], slopes[:, end:], of_rows


def _singular() -> SingularSystem:
    return SingularSystem(
        "sensitivities: the optimality conditions have no unique derivative: the solution is no minimum, or "
        "not the only one near, or some of its conditions follow from others"
    )
