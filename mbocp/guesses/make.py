"""Guesses of every kind, also from a saved solution and from the optimum in joint coordinates."""

from __future__ import annotations

import math
from dataclasses import replace

from mbocp.exceptions import DimensionMismatch, ProblemError, ResultFileError
from mbocp.formulation import Formulation, formulate
from mbocp.formulation.features.switches import fill_impulses
from mbocp.guesses.from_solution import iterate_from_solution
from mbocp.guesses.kinds import guess_candidates, none_made, plain_guess
from mbocp.job import settings_of
from mbocp.problem import Guess
from mbocp.programme import Iterate
from mbocp.solution import Solution
from mbocp.solvers import SolverResult, Start, Status, run_strategy


def make_guess(kind: str, formulation: Formulation, deadline: float = math.inf) -> tuple[Iterate, str]:
    """Iterate of the given kind, and words that say what was taken.

    Raises
    ------
    ProblemError
        If the forward simulation with a constant control fails, or a saved solution does not fit.
    CompilationTimeout
        If the deadline, a time of `time.perf_counter`, passes.
    """
    if kind == "joint":
        return _guess_from_joints(formulation)
    if kind == "solution":
        return _from_file(formulation)
    return plain_guess(kind, formulation, deadline)


def _from_file(formulation: Formulation) -> tuple[Iterate, str]:
    problem = formulation.problem
    if problem.guess.path is None:
        raise ProblemError('guess.kind = "solution" needs guess.file')
    saved = Solution.load(problem.guess.path)
    try:
        return iterate_from_solution(
            saved, formulation, problem.guess.at
        ), f"saved solution {problem.guess.path.name}"
    except DimensionMismatch as error:
        raise ResultFileError(
            problem.guess.path, f"does not fit robot {problem.robot.name!r}: {error}"
        ) from error


def _guess_from_joints(formulation: Formulation) -> tuple[Iterate, str]:
    """Optimum in joint coordinates, in natural ones; or what comes nearest to it."""
    problem = formulation.problem
    best: SolverResult | None = None
    joint = problem.with_(coordinates="joint", guess=Guess(), solver=replace(problem.solver, method="auto"))
    stepwise = formulate(joint)
    failed: dict[str, ProblemError] = {}
    taken = 0
    for kind in guess_candidates(joint):
        try:
            guess, _ = plain_guess(kind, stepwise)
        except ProblemError as error:
            failed[kind] = error
            continue
        start = Start(stepwise.programme, guess)
        result = run_strategy(settings_of(stepwise), start).result
        if result.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        taken += sum(not record.is_guess for record in result.history)
        if best is None or result.record.residual < best.record.residual:
            best = result
        if result.status is Status.CONVERGED:
            break
    if best is None:
        raise none_made(failed)
    motion = stepwise.motion_of(best.iterate)
    lams = best.iterate.ys / fill_impulses(formulation.problem, motion.dts)
    iterate = formulation.iterate_of(motion, lams)
    what = "optimum" if best.status is Status.CONVERGED else f"best iterate ({best.status})"
    return iterate, f"{what} in joint coordinates after {taken} iterations, mapped to bodies"
