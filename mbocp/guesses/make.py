"""Guesses of every kind."""

from __future__ import annotations

import math

from mbocp.exceptions import DimensionMismatch, ProblemError, ResultFileError
from mbocp.formulation import Formulation
from mbocp.guesses.kinds import plain_guess
from mbocp.programme import Iterate
from mbocp.solution import Solution


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
        from mbocp.guesses.from_joints import from_joints  # solves another problem first

        return from_joints(formulation)
    if kind == "solution":
        return _from_file(formulation)
    return plain_guess(kind, formulation, deadline)


def _from_file(formulation: Formulation) -> tuple[Iterate, str]:
    problem = formulation.problem
    if problem.guess.path is None:
        raise ProblemError('guess.kind = "solution" needs guess.file')
    from mbocp.guesses.from_solution import iterate_from_solution

    saved = Solution.load(problem.guess.path)
    try:
        return iterate_from_solution(
            saved, formulation, problem.guess.at
        ), f"saved solution {problem.guess.path.name}"
    except DimensionMismatch as error:
        raise ResultFileError(
            problem.guess.path, f"does not fit robot {problem.robot.name!r}: {error}"
        ) from error
