"""The robot of a solution, wherever it is read."""

from __future__ import annotations

from mbocp._files import MEGABYTE
from mbocp._text import warn_caller
from mbocp.exceptions import InvalidValue, RobotError
from mbocp.robot import (
    Robot,
    RobotChangedWarning,
    RobotFiles,
    RobotNotStoredWarning,
    gather,
    load_stored,
    robot_from_spec,
)
from mbocp.solution.solution_data import SolutionData

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
    files = find_held_files(solution)
    if files is None:
        if not {"name", "part"} & solution.robot_spec.keys():
            return None
        try:
            files = gather(solution.robot_spec)
        except RobotError as error:
            words = f"the result is written without its robot, and can be shown only where that is: {error}"
            warn_caller(words, RobotNotStoredWarning)
            return None
    size = sum(file.size for file in files.files if file.is_mesh)
    if meshes is None and size > MESH_LIMIT:
        warn_caller(
            f"the result is written without the robot's meshes, which have {size / MEGABYTE:.0f} MB: "
            "--meshes, or save(..., meshes=True), puts them into it",
            RobotNotStoredWarning,
        )
        meshes = False
    return files.without_meshes() if meshes is False else files


def robot_of(solution: SolutionData) -> Robot:
    """The robot that the solution holds, else that at the old place; see `Solution.load_robot`."""
    files = find_held_files(solution)
    if files is not None:
        warn_of_changes(files)
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


def find_held_files(solution: SolutionData) -> RobotFiles | None:
    """Files that came with the solution, if they are of the robot that it is about."""
    files = solution.robot_files
    return files if files is not None and dict(files.spec) == dict(solution.robot_spec) else None


def warn_of_changes(files: RobotFiles) -> None:
    """Warn if files of the robot are others on this machine by now."""
    changed = files.changed
    if changed:
        names = ", ".join(changed[:_MAX_NAMES])
        more = f" and {len(changed) - _MAX_NAMES} more" if len(changed) > _MAX_NAMES else ""
        warn_caller(
            f"the robot has changed since ({names}{more}); what the result holds of it is used",
            RobotChangedWarning,
        )
