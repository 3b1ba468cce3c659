"""The robot and the problem of a solution, wherever it is read."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

from mbocp._files import MEGABYTE, parse_toml
from mbocp.exceptions import InvalidValue, ProblemFileError, RobotError, Unreadable
from mbocp.problem import Problem
from mbocp.problem.file.build import problem_from_tables
from mbocp.problem.file.overrides import apply_overrides
from mbocp.robot import (
    Robot,
    RobotChangedWarning,
    RobotFiles,
    RobotNotStoredWarning,
    gather,
    load_stored,
    robot_from_spec,
)
from mbocp.solution.data import SolutionData
from mbocp.terms import OwnTerm

__all__ = ["MESH_LIMIT", "files_to_store", "problem_of", "robot_of"]

MESH_LIMIT = 64 * MEGABYTE  # of all meshes of a robot that go into a result unasked [bytes]
_MAX_NAMES = 3


def files_to_store(solution: SolutionData, meshes: bool | None) -> RobotFiles | None:
    """Files of the solution's robot that go into a result; None where there are none.

    Parameters
    ----------
    solution : SolutionData
    meshes : bool, optional
        Whether meshes are among them; None: if they are not too large.

    Warns
    -----
    RobotNotStoredWarning
        If the files cannot be read, or meshes are left out for their size.
    """
    files = _held(solution)
    if files is None:
        if not {"name", "part"} & solution.robot_spec.keys():
            return None
        try:
            files = gather(solution.robot_spec)
        except RobotError as error:
            words = f"the result is written without its robot, and can be shown only where that is: {error}"
            warnings.warn(words, RobotNotStoredWarning, stacklevel=4)
            return None
    size = sum(file.size for file in files.files if file.is_mesh)
    if meshes is None and size > MESH_LIMIT:
        warnings.warn(
            f"the result is written without the robot's meshes, which have {size / MEGABYTE:.0f} MB: "
            "--meshes, or save(..., meshes=True), puts them into it",
            RobotNotStoredWarning,
            stacklevel=4,
        )
        meshes = False
    return files.without_meshes() if meshes is False else files


def robot_of(solution: SolutionData) -> Robot:
    """The robot that the solution holds, else that at the old place; see `Solution.load_robot`."""
    files = _held(solution)
    if files is not None:
        _tell_changed(files)
        robot = load_stored(files)
    elif solution.robot_spec:
        robot = robot_from_spec(solution.robot_spec)
    else:
        raise InvalidValue("robot_spec", "nothing", "a solution that says which robot it is about")
    has, needed = (robot.nq, robot.nv), (solution.nq, solution.nv)
    if has != needed:
        raise RobotError(
            f"it is about another robot {solution.robot_name!r} than there is now: it has nq = {needed[0]} "
            f"and nv = {needed[1]}, the robot nq = {has[0]} and nv = {has[1]}; solve again, or bring it back"
        )
    return robot


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
    files = _held(solution)
    is_other = any(was.get(key) != now.get(key) for key in ("name", "part"))
    if files is None or is_other:
        return None
    _tell_changed(files)
    return load_stored(files, now)


def _held(solution: SolutionData) -> RobotFiles | None:
    """Files that came with the solution, if they are of the robot that it is about."""
    files = solution.robot_files
    return files if files is not None and dict(files.spec) == dict(solution.robot_spec) else None


def _tell_changed(files: RobotFiles) -> None:
    changed = files.changed
    if changed:
        names = ", ".join(changed[:_MAX_NAMES])
        more = f" and {len(changed) - _MAX_NAMES} more" if len(changed) > _MAX_NAMES else ""
        warnings.warn(
            f"the robot has changed since ({names}{more}); what the result holds of it is used",
            RobotChangedWarning,
            stacklevel=4,
        )
