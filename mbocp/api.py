"""The top-level `solve`: problem -> transcription -> guess -> solver -> solution, each phase timed."""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

import mbocp
from mbocp._arrays import Array
from mbocp.exceptions import NotConverged, ProblemError
from mbocp.formulation import Formulation, formulate
from mbocp.formulation.end_reached import end_missed
from mbocp.formulation.trajectory import Trajectory, read_trajectory
from mbocp.guesses import guess_candidates, iterate_from_solution, make_guess
from mbocp.mechanics.diagnostics import largest_turn
from mbocp.mechanics.symmetries import find_symmetries, momentum_name
from mbocp.problem import Problem, load_problem
from mbocp.problem.file.write import problem_to_toml
from mbocp.robot import Robot, singular_closure
from mbocp.solution import Solution
from mbocp.solution.records import Labels
from mbocp.solvers import IterationRecord, Methods, Outcome, Phase, SolverResult, Status, pursue
from mbocp.solvers.reachability import dependent_end_rows

__all__ = ["solve"]

_LARGEST_TURN = 1.0  # [rad] in one step; a symplectic Euler step of that size has lost all accuracy


def solve(
    problem: Problem | str | Path,
    *,
    solver: str | None = None,
    warm_start: Solution | None = None,
    callback: Callable[[IterationRecord], object] | None = None,
    check: bool = False,
) -> Solution:
    """Solve an optimal control problem.

    Parameters
    ----------
    problem : Problem, str or Path
        The problem, or the path of a problem file.
    solver : str, optional
        Stands for `problem.solver.method`.
    warm_start : Solution, optional
        Start from this solution, of any number of steps, instead of the problem's guess.
    callback : callable, optional
        Called with every `IterationRecord`.
    check : bool
        Raise unless converged.

    Returns
    -------
    Solution
        Converged or not: its `status` and `advice` tell. Ctrl-C ends the solve with the best iterate.

    Raises
    ------
    MbocpError
        If the problem is not well posed, or its functions cannot be compiled, or not within
        `problem.solver.time_limit`.
    NotConverged
        With `check`: carries the solution.
    """
    if not isinstance(problem, Problem):
        problem = load_problem(problem)
    if solver is not None:
        problem = problem.with_(solver=replace(problem.solver, method=solver))
    clock = time.perf_counter()
    phases: list[Phase] = []
    limit = problem.solver.time_limit
    deadline = math.inf if limit is None else clock + limit
    with _timed(phases, "compile"):
        formulation, left_out = _formulated(problem, deadline)
    outcome, guess_used = _solve_programme(formulation, warm_start, callback, phases, deadline)
    with _timed(phases, "diagnostics"):
        trajectory = read_trajectory(formulation, outcome.result.iterate)
        meanings = _meanings(problem.robot, trajectory.control_momentum_names)
        told = left_out + _singular(problem.robot, trajectory.qs)
    solution = _solution(
        formulation,
        outcome,
        trajectory,
        meanings,
        phases,
        guess_used,
        told,
        time.perf_counter() - clock,
    )
    if check and not solution.converged:
        raise NotConverged(solution)
    return solution


def _formulated(problem: Problem, deadline: float) -> tuple[Formulation, str]:
    """Formulation without end conditions that the dynamics meet by themselves, and which these are."""
    formulation = formulate(problem, deadline=deadline)
    if not formulation.end_rows_may_depend or problem.goal.redundant == "keep":
        return formulation, ""
    rows = dependent_end_rows(formulation.programme, np.vstack(formulation.end_rows))
    if not rows:
        return formulation, ""
    names = ", ".join(formulation.programme.describe_row(-1, row) for row in rows)
    return formulate(problem, rows, deadline=deadline), f"; left out, since the dynamics imply it: {names}"


@contextmanager
def _timed(phases: list[Phase], name: str) -> Iterator[None]:
    clock = time.perf_counter()
    yield
    phases.append(Phase(name, 0, time.perf_counter() - clock))


def _solve_programme(
    formulation: Formulation,
    warm_start: Solution | None,
    callback: Callable[[IterationRecord], object] | None,
    phases: list[Phase],
    deadline: float,
) -> tuple[Outcome, str]:
    """Run the solver from the guess; where the guess was left to mbocp, from the next one if that fails."""
    problem, programme = formulation.problem, formulation.programme
    methods, best = Methods.of(problem.solver, programme, has_inequalities=problem.is_bounded), None
    history: list[IterationRecord] = []
    kinds = ("warm start",) if warm_start is not None else guess_candidates(problem)
    for attempt, kind in enumerate(kinds):
        try:
            with _timed(phases, "guess"):
                if warm_start is not None:
                    iterate = iterate_from_solution(warm_start, formulation)
                    words = "warm start from a solution"
                else:
                    iterate, words = make_guess(kind, formulation)
        except ProblemError:
            if attempt + 1 < len(kinds) or best is not None:
                continue  # an automatic guess that cannot be made is no reason to give up on the others
            raise
        except KeyboardInterrupt:
            if best is None:
                raise  # there is nothing to return yet
            best = (_interrupted(best[0]), best[1])
            break
        is_doubtful = best is not None and best[0].result.status is Status.INFEASIBLE
        left = None if math.isinf(deadline) else max(0.0, deadline - time.perf_counter())
        outcome = pursue(
            replace(methods, time_limit=left, is_doubtful=is_doubtful),
            programme,
            iterate,
            callback,
            first=sum(not record.is_guess for record in history),
            label="" if attempt == 0 else f" (guess: {kind})",
        )
        outcome = _with_end(formulation, outcome)
        history += outcome.result.history
        phases += outcome.phases
        result = outcome.result
        if best is None or result.status is Status.CONVERGED or _is_better(result, best[0].result):
            best = (outcome, words)
        elif result.status is Status.INTERRUPTED:
            best = (_interrupted(best[0]), best[1])
        if result.status in (Status.CONVERGED, Status.INTERRUPTED, Status.TIME_LIMIT):
            break
    if best is None:
        raise ProblemError("no initial guess could be made; give guess.kind and guess.u")
    outcome, words = best
    return replace(outcome, result=replace(outcome.result, history=tuple(history))), words


def _with_end(formulation: Formulation, outcome: Outcome) -> Outcome:
    """Outcome that says so where it ends beside the goal; at another root it has not converged."""
    result = outcome.result
    if result.status is not Status.CONVERGED:
        return outcome
    missed = end_missed(formulation, formulation.motion_of(result.iterate).qs)
    if missed is None:
        return outcome
    status = Status.OTHER_ROOT if missed.is_other_root else result.status
    return replace(outcome, result=replace(result, status=status, advice=f"{result.advice}; {missed.words}"))


def _interrupted(outcome: Outcome) -> Outcome:
    """Outcome of an earlier guess, returned because a later one was interrupted."""
    return replace(outcome, result=outcome.result.interrupted())


def _is_better(new: SolverResult, old: SolverResult) -> bool:
    """Whether one of two results that have not converged says more: another root, then `infeasible`."""
    if Status.OTHER_ROOT in (new.status, old.status):
        return old.status is not Status.OTHER_ROOT
    if old.status is Status.INFEASIBLE:
        return False
    return new.record.residual < old.record.residual


def _solution(
    formulation: Formulation,
    outcome: Outcome,
    trajectory: Trajectory,
    meanings: tuple[str, ...],
    phases: list[Phase],
    guess_used: str,
    told: str,
    seconds: float,
) -> Solution:
    problem, result = formulation.problem, outcome.result
    last = result.record
    status, advice = _resolution(problem, result, trajectory.qs, trajectory.vs)
    return Solution(
        status=status,
        advice=advice + _compiled_long(problem, result, phases) + told,
        solver=outcome.solver,
        iterations=sum(p.iterations for p in phases),
        cost=last.cost,
        residual=last.residual,
        increment=last.increment,
        unknowns=formulation.programme.num_unknowns,
        wall_time_s=seconds,
        phases=tuple(phases),
        history=result.history,
        problem_name=problem.name,
        robot_name=problem.robot.name,
        robot_spec=dict(problem.robot.spec),
        problem_text=problem_to_toml(problem),
        guess_used=guess_used,
        options=asdict(problem.solver),
        versions=dict(_versions()),
        labels=Labels.of_robot(problem.robot, formulation.constraint_labels),
        control_momentum_meanings=meanings,
        **trajectory.fields(),
    )


def _meanings(robot: Robot, names: tuple[str, ...]) -> tuple[str, ...]:
    """What the control momenta of the named symmetries are, in words."""
    if not names:
        return ()
    words = {s.name: momentum_name(s, robot) for s in find_symmetries(robot)}
    return tuple(words[name] for name in names)


def _compiled_long(problem: Problem, result: SolverResult, phases: list[Phase]) -> str:
    """Say where compiling took most of the time that a solve had."""
    limit = problem.solver.time_limit
    seconds = sum(phase.wall_time_s for phase in phases if phase.name == "compile")
    if limit is None or result.status is not Status.TIME_LIMIT or seconds < limit / 2:
        return ""
    return f"; compiling took {seconds:.1f} s of it, which the next run of this shape is spared"


def _singular(robot: Robot, qs: Array) -> str:
    """Say where the constraints of a mechanism lose their rank on the way."""
    words = singular_closure(robot, qs)
    return f"; {words}" if words else ""


def _resolution(problem: Problem, result: SolverResult, qs: Array, vs: Array) -> tuple[Status, str]:
    """Status and advice of a result, which is no motion where a joint turns too far in one step."""
    name, turn = largest_turn(problem.robot, qs, vs, problem.dt, problem.substeps)
    if not turn > _LARGEST_TURN:
        return result.status, result.advice
    words = f"{name} turns by {turn:.1f} rad in one step, which is no motion any more"
    remedy = "take more steps, or give cost.velocity a weight"
    if result.status is not Status.CONVERGED:
        return result.status, f"{result.advice}; {words}: {remedy}"
    return Status.UNDER_RESOLVED, f"{words}: {remedy}; the optimality conditions hold: {result.advice}"


@cache
def _versions() -> Mapping[str, str]:
    found = {"mbocp": mbocp.__version__, "python": platform.python_version()}
    for name in ("pin", "casadi", "numpy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # a Pinocchio from elsewhere than the registry has no such record
            found[name] = "unknown"
    return found
