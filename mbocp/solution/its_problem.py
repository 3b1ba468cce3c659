"""The problem of a solution, wherever it is read: what a picture of it does not need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mbocp._files import parse_toml
from mbocp.exceptions import ProblemFileError, Unreadable
from mbocp.problem import Problem
from mbocp.problem.file.build import problem_from_tables
from mbocp.problem.file.overrides import apply_overrides
from mbocp.robot import Robot, load_stored
from mbocp.solution.data import SolutionData
from mbocp.solution.its_robot import held_files, robot_of, tell_changed
from mbocp.terms import OwnTerm

__all__ = ["problem_of"]


def problem_of(
    solution: SolutionData, overrides: Mapping[str, Any] | Sequence[str], terms: Sequence[OwnTerm]
) -> Problem:
    """The problem that was solved, see `Solution.load_problem`."""
    label = f"the problem of {solution.problem_name or 'a result'}"
    try:
        document = parse_toml(solution.problem_text)
    except Unreadable as error:
        raise ProblemFileError(label, error.reason) from error
    tables = apply_overrides(document, overrides)
    robot = _robot_in(solution, document, tables)
    return problem_from_tables(tables, robot=robot, label=label, name=solution.problem_name, terms=terms)


def _robot_in(solution: SolutionData, document: Mapping[str, Any], tables: Mapping[str, Any]) -> Robot | None:
    """The robot of changed tables; None if it is no longer that of the solution."""
    was, now = (
        {"name": entry} if isinstance(entry, str) else dict(entry)
        for entry in (document.get("robot", {}), tables.get("robot", {}))
    )
    if was == now and solution.robot_spec:
        return robot_of(solution)
    files = held_files(solution)
    is_other = any(was.get(key) != now.get(key) for key in ("name", "part"))
    if files is None or is_other:
        return None
    tell_changed(files)
    return load_stored(files, now)
