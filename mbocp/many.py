"""Many problems that differ in start, goal and weights alone, with no Python between steps.

Each thread has a programme of its own, which takes the numbers of problem after problem. Newton's method runs
from the guess to its end in the kernel, while the next guesses are made. What does not converge there, or has
more to it than a guess and Newton's method, is solved as `mbocp.solve` does it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from mbocp._arrays import Array, BoolArray, IntArray, dataclass, frozen_array
from mbocp.exceptions import DimensionMismatch, InvalidValue, MbocpError, ProblemError
from mbocp.formulation import Formulation, Motion
from mbocp.formulation.build import control_weight_of
from mbocp.formulation.formulate import formulate, formulate_with_independent_ends
from mbocp.formulation.read_trajectory import times_of
from mbocp.formulation.updates import ParameterUpdates
from mbocp.guesses.make import guess_candidates, plain_guess
from mbocp.problem import Problem
from mbocp.problem._checks import MAX_POSITION, MAX_RATE, check_integer, check_size
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.goals.ends import check_start_state
from mbocp.problem.limits import check_limits
from mbocp.problem.warn import warn_limits
from mbocp.programme import Iterate, StagewiseProgramme
from mbocp.programme.kernel import kernel_programme
from mbocp.solution import Solution
from mbocp.solution.from_files import problem_from
from mbocp.solution.read_solution import judge
from mbocp.solvers import GlobalisedNewton, Status
from mbocp.solvers.strategies.in_units import cost_factor
from mbocp.solving import solve
from mbocp.terms.written import AUTO

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelProgramme

_AHEAD = 2  # guesses for each thread that wait for it
_NUMBERS = ("theta", "rho", "rho_terminal", "x_start")  # of a programme
_KEYS = {"starts": ("q", "v"), "goals": ("q", "v", "p")}


@dataclass(frozen=True, eq=False)
class Motions:
    """Motions of many problems: row k of each array is that of problem k.

    Attributes
    ----------
    problem : Problem
        What they have in common.
    changes : tuple of mapping
        Words of `Problem.with_` that make each problem of it.
    statuses : tuple of Status
    iterations : ndarray of int, shape (K,)
    costs, residuals : ndarray, shape (K,)
    t : ndarray, shape (K, N + 1)
        Times of the nodes [s].
    qs, vs : ndarray, shapes (K, N + 1, nq), (K, N + 1, nv)
        Configurations and velocities there [m, rad, unit quaternion xyzw; m/s, rad/s].
    us : ndarray, shape (K, N, nu)
        Controls of the steps [N, N m].
    """

    problem: Problem
    changes: tuple[Mapping[str, Any], ...]
    statuses: tuple[Status, ...]
    iterations: IntArray
    costs: Array
    residuals: Array
    t: Array
    qs: Array
    vs: Array
    us: Array

    def __len__(self) -> int:
        return len(self.statuses)

    def __repr__(self) -> str:
        return f"<Motions of {self.problem.name}: {int(self.converged.sum())} of {len(self)} converged>"

    @property
    def converged(self) -> BoolArray:
        """Which problems are solved, shape (K,)."""
        return np.array([status is Status.CONVERGED for status in self.statuses])

    def problem_at(self, k: int) -> Problem:
        """Problem k, checked as any other."""
        return self.problem.with_(**self.changes[k])

    def solution(self, k: int) -> Solution:
        """All that is known of motion k, to be saved, plotted or replayed: it is solved once more."""
        return solve(self.problem_at(k))


def solve_many(
    problem: Problem | str | Path,
    *,
    starts: Any = None,
    goals: Any = None,
    weights: Mapping[str, Any] | None = None,
    threads: int | None = None,
) -> Motions:
    """Solve a problem from many starts, to many goals, or with many weights.

    Parameters
    ----------
    problem : Problem, str or Path
        What is not given here is the same in all.
    starts : array_like, shape (K, nq), or mapping, optional
        Configurations [m, rad, unit quaternion xyzw]; or some of `q`, shape (K, nq), and `v`, (K, nv).
    goals : array_like, shape (K, nq), or mapping, optional
        The same of goals; `v` or `p`, whichever the goal of the problem has.
    weights : mapping, optional
        Weights by their keys in `[cost]`, shape (K,) or (K, n).
    threads : int, optional
        Default: one for each processor.

    Returns
    -------
    Motions
        Each has a status of its own: those that are not converged are the best that was found. Ctrl-C ends
        it with what there is: the status of all others is ``interrupted``, and their numbers are NaN.

    Raises
    ------
    MbocpError
        If the problem is not well posed, or one of those that it stands for.
    DimensionMismatch
        If there are not as many of each, or they do not fit the robot.
    """
    base = problem_from(problem)
    changes = _changes(base, starts, goals, weights)
    check_integer("threads", 1 if threads is None else threads, 1)
    collected = _Rows(base, changes)
    with _in_problem(0):
        first = base.with_(**changes[0])
    formulation, _ = formulate_with_independent_ends(first, math.inf)
    with suppress(KeyboardInterrupt):
        batch = _Batch(formulation, changes, collected, threads or base.solver.num_threads)
        if _is_plain(formulation) and batch.has_numbers_of(len(changes) - 1):
            batch.run()
        else:
            for k in range(len(changes)):
                collected.solve(k)
    return collected.motions()


def _changes(
    problem: Problem, starts: Any, goals: Any, weights: Mapping[str, Any] | None
) -> tuple[Mapping[str, Any], ...]:
    """Words of `Problem.with_` for each problem."""
    columns: dict[tuple[str, str], Array] = {}
    for name, given in (("starts", starts), ("goals", goals)):
        for key, values in _rows_by_key(problem, name, given):
            columns[name.removesuffix("s"), key] = values
    for key, values in (weights or {}).items():
        found = _numbers(f"weights.{key}", values)
        columns["cost", key] = found.reshape(len(found), -1) if found.ndim else found.reshape(1, 1)
    counts = {len(values) for values in columns.values()}
    if len(counts) != 1:
        raise ProblemError(
            "solve_many: give starts, goals or weights, as many of each; got "
            + (", ".join(f"{table}.{key}: {len(v)}" for (table, key), v in columns.items()) or "none")
        )
    (count,) = counts
    return tuple(_change(columns, k) for k in range(count))


def _rows_by_key(problem: Problem, name: str, given: Any) -> Iterator[tuple[str, Array]]:
    asked = {} if given is None else dict(given) if isinstance(given, Mapping) else {"q": given}
    for key, values in asked.items():
        if key not in _KEYS[name]:
            raise ProblemError(f"{name}: no {key!r}; give some of {', '.join(_KEYS[name])}")
        yield key, _rows(f"{name}.{key}", values, problem.robot.nq if key == "q" else problem.robot.nv)


def _change(columns: Mapping[tuple[str, str], Array], k: int) -> dict[str, Any]:
    change: dict[str, dict[str, Any]] = {}
    for (table, key), values in columns.items():
        row = values[k]
        change.setdefault(table, {})[key] = float(row[0]) if table == "cost" and row.size == 1 else row
    return change


def _numbers(name: str, values: Any) -> Array:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidValue(name, "something else", "an array of numbers") from None


def _rows(name: str, values: Any, size: int) -> Array:
    rows = _numbers(name, values)
    if rows.ndim != 2 or rows.shape[1] != size or not len(rows):
        raise DimensionMismatch(name, rows.shape, (None, size), "a row for each problem")
    if not np.isfinite(rows).all():
        raise InvalidValue(name, "entries that are no numbers", "finite numbers")
    return rows


def _is_plain(formulation: Formulation) -> bool:
    """Whether `solve` would begin with a line and Newton's method, and be done where that converges."""
    problem, programme, at = formulation.problem, formulation.programme, formulation.layout
    return (
        _has_plain_ends(problem)
        and _says_its_cost(problem)
        and _begins_with_newton(problem)
        and COORDINATES[problem.coordinates].has_joint_states
        and not (problem.robot.nc or problem.robot.drives)
        and not (problem.via or problem.phase or problem.clearance or problem.timeline.switches)
        and programme.easing is None
        and programme.units.are_users
        and not programme.num_guards
        and at.nx == at.nz + at.ns
    )


def _has_plain_ends(problem: Problem) -> bool:
    """Whether start and goal are states that nothing else depends on."""
    goal = problem.goal
    is_somewhere_else = problem.goals or goal.poses or goal.periodic or problem.start_free
    return not is_somewhere_else and bool(goal.q_active.all()) and not goal.a_active.any()


def _says_its_cost(problem: Problem) -> bool:
    """Whether no weight is left to mbocp, which goes by start and goal, and no target is the goal."""
    draft = problem.draft
    return not (draft["is_cost_left"] or draft["cost_table"].velocity == AUTO or problem.cost.tracking)


def _begins_with_newton(problem: Problem) -> bool:
    """Whether the first guess is a line, and Newton's method the first to take it."""
    options, guess = problem.solver, problem.guess
    return (
        options.method in ("auto", "monolithic")
        and options.globalisation == "default"
        and options.starts == 1
        and problem.accuracy is None
        and problem.robust is None
        and problem.excite is None
        and guess.q is None
        and guess_candidates(problem)[0] == "line"
    )


def _with_numbers(problem: Problem, change: Mapping[str, Any]) -> Problem:
    """The problem with another start, goal or weights, checked as far as these alone may be wrong."""
    robot, start, goal = problem.robot, change.get("start", {}), change.get("goal", {})
    limits, own = problem.limits, problem.goal
    q, v = check_start_state(robot, limits, start.get("q", problem.q_start), start.get("v", problem.v_start))
    if set(goal) - {"q", own.rate}:
        raise ProblemError(f"goals: the goal of the problem has {own.rate}; give that in place of the other")
    q_goal = robot.normalise(goal.get("q", own.q), name="goal.q")
    own = replace(own, q=q_goal, value=goal.get(own.rate, own.value))
    check_size("goal.q", own.q, robot.q_labels, MAX_POSITION)
    check_size(f"goal.{own.rate}", own.value, robot.v_labels, MAX_RATE)
    warn_limits(robot, limits, own.q, "goal.q")
    check_limits(robot, limits, q, v, own)
    weights = change.get("cost")
    cost = problem.cost.with_weights(weights).on_controls(robot.nu) if weights else problem.cost
    return replace(problem, q_start=q, v_start=v, goal=own, cost=cost)


@contextmanager
def _in_problem(k: int) -> Iterator[None]:
    """Say in errors which problem they are about."""
    try:
        yield
    except MbocpError as error:
        error.put_into(f"problem {k}")
        raise


class _Found(NamedTuple):
    """What Newton's method has come to."""

    status: Status
    iterations: int
    cost: float
    residual: float
    iterate: Iterate


class _Rows:
    """Rows of `Motions`, as they come."""

    def __init__(self, problem: Problem, changes: tuple[Mapping[str, Any], ...]) -> None:
        N, robot, count = problem.num_steps, problem.robot, len(changes)
        self.problem, self.changes = problem, changes
        self.statuses: list[Status] = [Status.INTERRUPTED] * count
        self.iterations = np.zeros(count, dtype=np.int64)
        self.costs, self.residuals = np.full(count, np.nan), np.full(count, np.nan)
        self.t = np.full((count, N + 1), np.nan)
        self.qs = np.full((count, N + 1, robot.nq), np.nan)
        self.vs = np.full((count, N + 1, robot.nv), np.nan)
        self.us = np.full((count, N, robot.nu), np.nan)

    def solve(self, k: int) -> None:
        """Solve problem k by itself."""
        with _in_problem(k):
            s = solve(self.problem.with_(**self.changes[k]))
        self.put(k, s, (s.t, s.qs, s.vs, s.us))
        if s.status is Status.INTERRUPTED:
            raise KeyboardInterrupt

    def put(self, k: int, found: Solution | _Found, motion: tuple[Array, Array, Array, Array]) -> None:
        """Fill row k."""
        self.statuses[k], self.iterations[k] = found.status, found.iterations
        self.costs[k], self.residuals[k] = found.cost, found.residual
        self.t[k], self.qs[k], self.vs[k], self.us[k] = motion

    def motions(self) -> Motions:
        """Return what has been collected."""
        numbers = (self.costs, self.residuals, self.t, self.qs, self.vs, self.us)
        return Motions(
            self.problem, self.changes, tuple(self.statuses), self.iterations, *map(frozen_array, numbers)
        )


class _Batch:
    """Problems of one shape: guesses here, Newton's method in threads beside it."""

    def __init__(
        self,
        formulation: Formulation,
        changes: tuple[Mapping[str, Any], ...],
        collected: _Rows,
        threads: int,
    ) -> None:
        self._formulation, self._changes = formulation, changes
        self._collected, self._threads = collected, min(threads, len(changes))
        self._updates = ParameterUpdates(formulation)
        self._natives: SimpleQueue[KernelProgramme] = SimpleQueue()

    def has_numbers_of(self, k: int) -> bool:
        """Whether problem k, formulated by itself, has the numbers that it has here."""
        with _in_problem(k):
            own = self._formulate(k).programme
            alone = formulate(self._collected.problem.with_(**self._changes[k])).programme
        same = (np.array_equal(getattr(own, name), getattr(alone, name)) for name in _NUMBERS)
        return all(same) and own.control_weight == alone.control_weight

    def run(self) -> None:
        """Solve all, in the order of the problems; what is not solved is solved by itself."""
        programme, left = self._formulation.programme, list[int]()
        has_limits = not programme.bounds.is_empty
        for _ in range(self._threads):
            self._natives.put(kernel_programme(programme, has_limits=has_limits))
        with ThreadPoolExecutor(self._threads) as pool:
            waiting: deque[tuple[int, Formulation, Future[_Found]]] = deque()

            def take() -> None:
                k, formulation, future = waiting.popleft()
                if not self._take(k, formulation, future.result()):
                    left.append(k)

            for k in range(len(self._changes)):
                if len(waiting) == _AHEAD * self._threads:
                    take()
                with _in_problem(k):
                    formulation = self._formulate(k)
                    iterate, _ = plain_guess("line", formulation)
                waiting.append((k, formulation, pool.submit(self._descend, formulation, iterate)))
            while waiting:
                take()
        for k in left:
            self._collected.solve(k)

    def _formulate(self, k: int) -> Formulation:
        """The formulation with the numbers of problem k; functions are the same."""
        problem = _with_numbers(self._formulation.problem, self._changes[k])
        goal = problem.goal
        self._updates.set_goal({"q": goal.q, goal.rate: goal.value} if goal.rate_active.any() else goal.q)
        if "cost" in self._changes[k]:
            self._updates.set_weights(self._changes[k]["cost"])
        x_start = self._formulation.start_state(problem.q_start, problem.v_start)
        programme: StagewiseProgramme = replace(
            self._formulation.programme,
            x_start=frozen_array(x_start),
            theta=frozen_array(self._updates.theta),
            rho=frozen_array(self._updates.rho),
            rho_terminal=frozen_array(self._updates.rho_terminal),
            control_weight=control_weight_of(problem),
        )
        return replace(cast(Any, self._formulation), problem=problem, programme=programme)

    def _descend(self, formulation: Formulation, iterate: Iterate) -> _Found:
        """Run Newton's method from a guess to its end, on a programme that no other thread has."""
        programme, options = formulation.programme, formulation.problem.solver
        solver = GlobalisedNewton(options.tolerance, options.newton_iterations, programme.control_weight)
        native = self._natives.get()
        try:
            native.set_parameters(programme.theta, programme.rho, programme.rho_terminal)
            iterate.load_into(native)
            status, state = solver.run(native, programme)
            found = Iterate.read_from(native, programme)
        finally:
            self._natives.put(native)
        return _Found(status, state.iteration, state.evaluation.cost, state.evaluation.residual, found)

    def _take(self, k: int, formulation: Formulation, found: _Found) -> bool:
        """Judge a motion, and keep it if it is solved."""
        if found.status is not Status.CONVERGED or cost_factor(found.cost) != 1.0:
            return False
        motion: Motion = formulation.motion_of(found.iterate)
        t = times_of(formulation.problem, motion.dts)
        status, _, _ = judge(formulation, motion, t, found.status, "")
        if status is Status.CONVERGED:
            self._collected.put(k, found, (t, motion.qs, motion.vs, motion.us))
        return status is Status.CONVERGED
