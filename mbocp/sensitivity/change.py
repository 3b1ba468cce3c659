"""What optima have derivatives in, and how an optimum changes with it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import fields
from typing import ClassVar

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation import Formulation, formulate
from mbocp.formulation.build import parameter_values
from mbocp.formulation.features.control_values import ControlValues
from mbocp.formulation.formulate import find_implied_end_rows, pieces_of
from mbocp.formulation.gains import has_joint_states
from mbocp.formulation.layout import places
from mbocp.formulation.pieces import Pieces
from mbocp.formulation.state_bounds import state_bounds
from mbocp.problem import Problem
from mbocp.programme import StagewiseProgramme
from mbocp.programme.evaluation import call
from mbocp.terms.frame_end import FrameEnd


@dataclass(frozen=True, eq=False)
class ProblemNumbers(ABC):
    """Some numbers of a problem.

    Attributes
    ----------
    formulation : Formulation
    word : str
        What it is called, as in a problem file where there is a key.
    """

    formulation: Formulation
    word: str

    scales_time: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """Words of this kind that a problem has."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """What each of the numbers is."""

    @abstractmethod
    def change(self) -> Change:
        """What a unit of each makes of the programme's numbers."""

    @property
    @abstractmethod
    def value(self) -> Array:
        """What the problem has: of configurations all nq numbers, of orientations a quaternion xyzw."""

    @abstractmethod
    def put(self, problem: Problem, value: Array) -> Problem:
        """A problem with other numbers, in which ``"auto"`` stands for what it did."""

    @property
    def tangent(self) -> Array:
        """Derivatives of `value` in the numbers that have names, shape (value.size, k)."""
        return np.eye(len(self.names))

    @property
    def problem(self) -> Problem:
        """That of the formulation."""
        return self.formulation.problem

    @property
    def _none(self) -> Change:
        return Change.none(self.formulation.programme, len(self.names))


# Differences of fourth order: of numbers that depend on the move linearly or smoothly, right to 1e-11.
_STEP = 2.0**-9
_WEIGHTS = ((1.0, 8.0 / 12.0), (-1.0, -8.0 / 12.0), (2.0, -1.0 / 12.0), (-2.0, 1.0 / 12.0))
_SAME = 1e-12
_PLAIN = (ControlValues, FrameEnd)  # features and ends that know no length of steps, and limits as they are
POINTS = tuple((at * _STEP, weight / _STEP) for at, weight in _WEIGHTS)  # moves, and their weights


@dataclass(frozen=True, eq=False)
class Change:
    """Derivatives of a programme's numbers in k parameters.

    Attributes
    ----------
    start : ndarray, shape (k, ndx)
        Of the given state, in its tangent.
    theta, rho, rho_terminal : ndarray, shapes (k, size)
    lower, upper : ndarray, shape (k, N, nx + nu + nh)
        Of the bounds.
    """

    start: Array
    theta: Array
    rho: Array
    rho_terminal: Array
    lower: Array
    upper: Array

    @classmethod
    def none(cls, programme: StagewiseProgramme, k: int) -> Change:
        """Zeros, to be filled in; those of bounds are in the memory of one."""
        kind = programme.kind
        limits = (k, *programme.bounds.has_limit.shape)
        of_bounds = np.broadcast_to(0.0, limits)
        return cls(
            start=np.zeros((k, kind.ndx)),
            theta=np.zeros((k, programme.theta.size)),
            rho=np.zeros((k, programme.rho.size)),
            rho_terminal=np.zeros((k, programme.rho_terminal.size)),
            lower=of_bounds,
            upper=of_bounds,
        )

    @classmethod
    def join(cls, changes: list[Change]) -> Change:
        """Those of several parameters, one after the other."""
        if len(changes) == 1:
            return changes[0]
        return cls(*(_concatenate([getattr(c, f.name) for c in changes]) for f in fields(cls)))

    @property
    def is_in_steps(self) -> bool:
        """Whether numbers of steps are among them."""
        return bool(self.theta.any() or self.rho.any())

    @property
    def is_in_bounds(self) -> bool:
        """Whether bounds are among them: others are zeros in the memory of one."""
        return any(self.lower.strides) or any(self.upper.strides)

    def along(self, weights: Array) -> Change:
        """Those along moves of all parameters, shape (number, k)."""
        return type(self)(*(_combine(weights, getattr(self, f.name)) for f in fields(self)))


def _combine(weights: Array, part: Array) -> Array:
    if part.size and not any(part.strides):  # zeros in the memory of one stay such
        return np.broadcast_to(0.0, (len(weights), *part.shape[1:]))
    return np.tensordot(weights, part, 1)


def _concatenate(parts: list[Array]) -> Array:
    """Parts one after the other; zeros in the memory of one stay such."""
    if any(any(part.strides) for part in parts):
        return np.concatenate(parts)
    return np.broadcast_to(0.0, (sum(map(len, parts)), *parts[0].shape[1:]))


def change_along(formulation: Formulation, *moves: Callable[[float], Problem]) -> Change:
    """Change of the numbers with moves of a problem, whose functions stay the same.

    Parameters
    ----------
    formulation : Formulation
    *moves : callable
        Each returns the problem after a move of some size.
    """
    without = _rows_left_out(formulation)

    def change(problem_at: Callable[[float], Problem]) -> Change:
        points = [(w, _numbers(pieces_of(problem_at(at), without), formulation)) for at, w in POINTS]
        return Change(*(sum(w * getattr(n, f.name) for w, n in points) for f in fields(Change)))

    return Change.join([change(move) for move in moves])


def has_plain_numbers(formulation: Formulation) -> bool:
    """Whether lengths of steps stand in "dt" alone, and limits in bounds of their own alone.

    It is so of states of joints where no features, path constraints or ends have numbers of their own: terms
    of the cost know neither, see `TermNumbers`.
    """
    signature = formulation.pieces.signature
    others = [one for one in (*signature.ends, *signature.features) if not isinstance(one, _PLAIN)]
    return has_joint_states(formulation) and not (formulation.problem.inequalities or others)


def says_all(formulation: Formulation, change: Change, steps: Array, moved: Problem) -> bool:
    """Whether the numbers of a problem are those of a change by steps of all its parameters at once.

    Where steps differ, those of one parameter are no others'.
    """
    programme, bounds = formulation.programme, formulation.programme.bounds
    before = Change(
        start=np.zeros((1, programme.kind.ndx)),
        theta=programme.theta[None],
        rho=programme.rho[None],
        rho_terminal=programme.rho_terminal[None],
        lower=_finite(bounds.lower)[None],
        upper=_finite(bounds.upper)[None],
    )
    by = change.along(steps[None])
    after = _numbers(pieces_of(moved, _rows_left_out(formulation)), formulation)
    trio = [[getattr(numbers, f.name) for numbers in (before, by, after)] for f in fields(Change)]
    return all((np.abs(was + by - now) <= _SAME * (1.0 + np.abs(now))).all() for was, by, now in trio)


def _rows_left_out(formulation: Formulation) -> tuple[int, ...]:
    """Rows of the end condition that the dynamics imply, and the formulation does without."""
    if not formulation.end_rows_may_depend:
        return ()
    rows = len(pieces_of(formulation.problem).end_rows.of_joints)
    has_all = rows == len(formulation.end_rows.of_joints)
    return () if has_all else find_implied_end_rows(formulate(formulation.problem))


def _numbers(moved: Pieces, base: Formulation) -> Change:
    """Numbers of a problem that is moved, and its start as a move."""
    theta, rho, rho_terminal = parameter_values(moved)
    (away,) = call(base.programme.functions, "difference", 1, [base.programme.x_start, moved.x_start])
    bounds = state_bounds(moved)
    return Change(
        start=away.dense(base.programme.kind.ndx),
        theta=theta[None],
        rho=rho[None],
        rho_terminal=_align(rho_terminal, base)[None],
        lower=_finite(bounds.lower)[None],
        upper=_finite(bounds.upper)[None],
    )


def _finite(side: Array) -> Array:
    return np.where(np.isfinite(side), side, 0.0)


def _align(rho_terminal: Array, base: Formulation) -> Array:
    """Numbers of the end with projections turned as near to those of the base as they can be.

    Rows of a projection span a space, and which rows they are is a matter of round-off.
    """
    at, found = places(base.pieces.parameters.terminal), np.array(rho_terminal)
    nv = base.pieces.space.nv
    for name in ("D_q", "D_rate"):
        D = found[at[name]].reshape(nv, -1).T  # by columns
        D_base = base.programme.rho_terminal[at[name]].reshape(nv, -1).T
        if not np.array_equal(D, D_base):
            left, _, right = np.linalg.svd(D_base @ D.T)
            found[at[name]] = (left @ right @ D).ravel(order="F")
    return found
