"""A problem from whatever file holds one: a problem file, or a result."""

from __future__ import annotations

from pathlib import Path

from mbocp._files import RESULT_SUFFIXES
from mbocp.problem import Problem, load_problem
from mbocp.solution.solution import Solution


def problem_from(given: Problem | str | Path) -> Problem:
    """A problem as it is, or the problem of a problem file or a result.

    Raises
    ------
    ProblemFileError, ResultFileError
        As `mbocp.load_problem`, `Solution.load` and `Solution.load_problem`.
    """
    if isinstance(given, Problem):
        return given
    if Path(given).suffix.lower() in RESULT_SUFFIXES:
        return Solution.load(given).load_problem()
    return load_problem(given)
