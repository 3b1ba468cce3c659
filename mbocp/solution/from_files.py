"""A problem from whatever file holds one: a problem file, or a result."""

from __future__ import annotations

from pathlib import Path

from mbocp._files import RESULT_SUFFIXES
from mbocp.exceptions import InvalidValue
from mbocp.problem import Problem, load_problem
from mbocp.solution.solution import Solution


def problem_from(given: object) -> Problem:
    """A problem as it is, or the problem of a problem file or a result.

    Raises
    ------
    InvalidValue
        For what is neither, as a list of problems.
    ProblemFileError, ResultFileError
        As `mbocp.load_problem`, `Solution.load` and `Solution.load_problem`.
    """
    if isinstance(given, Problem):
        return given
    if not isinstance(given, str | Path):
        expected = "one Problem, or the path of a problem file or of a result"
        raise InvalidValue("problem", type(given).__name__, expected)
    if Path(given).suffix.lower() in RESULT_SUFFIXES:
        return Solution.load(given).load_problem()
    return load_problem(given)
