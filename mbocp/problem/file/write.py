"""A `Problem` as the text of a problem file: a result keeps it."""

from __future__ import annotations

from mbocp.problem.file.tables import tables_of, to_toml
from mbocp.problem.problem import Problem


def problem_to_toml(problem: Problem) -> str:
    """Return a problem file that loads as the same problem, see `mbocp.problem.file.tables.tables_of`."""
    return to_toml(tables_of(problem))
