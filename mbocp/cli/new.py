"""`mbocp new`: a problem file for a robot, to begin with."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Annotated, Any

import typer

from mbocp._files import is_file
from mbocp.cli.app import Dynamics, FreeFlyer, Locks, PackageDirs, Quiet, Robot, output_file
from mbocp.cli.keys import SCHEMA_FILE
from mbocp.cli.robot_options import RobotOptions
from mbocp.cli.solve import check_output
from mbocp.exceptions import ResultFileError, UnsupportedRobot

_SUFFIXES = (".toml",)
_ROOT = "root_joint"
_MANY_TURNS = 1e3  # [rad]: no limit that anybody means


def new(
    name: Robot,
    output: Annotated[Path | None, output_file("FILE.toml", "File to write. [default: ROBOT.toml]")] = None,
    package_dir: PackageDirs = None,
    free_flyer: FreeFlyer = None,
    dynamics: Dynamics = None,
    lock: Locks = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the file if it is there.")] = False,
    quiet: Quiet = False,
) -> None:
    """Write a problem file for a robot, with comments.

    It names the joints and their limits, and asks for a motion that solves at once.
    """
    from mbocp.problem.file.first import first_file
    from mbocp.solution.atomic import replace_text

    options, robot = RobotOptions(package_dir, free_flyer, dynamics, lock).load_as_it_can_move(name)
    path = output if output is not None else Path(f"{Path(name).stem or robot.name}.toml")
    check_output(path, "-o", _SUFFIXES)
    if path.exists() and not force:
        raise ResultFileError(path, "is there already; give another name with -o, or --force to replace it")
    table: dict[str, Any] = options.table(_path_from(name, path))
    if robot.nu == 0:
        if _ROOT not in robot.joint_names:
            raise UnsupportedRobot(
                f"robot {robot.name!r}: nothing moves it; its joints have no motors: name those that have in "
                "robot.actuated, or write actuators into a robot.toml"
            )
        from mbocp.robot import robot_from_spec

        table["actuated"] = [_ROOT]
        robot = robot_from_spec({**options.table(name), "actuated": [_ROOT]})
    replace_text(path, _schema_line(path) + first_file(robot, table, path))
    if _only_rotors(robot) and options.free_flyer is None:
        locks = " ".join(f"--lock {joint}" for joint in robot.joint_names)
        typer.echo(
            f"note: all joints of {robot.name} turn without end, and none has an effort: if they are rotors "
            f"of something that flies, say\n  mbocp new {name} --free-flyer {locks}",
            err=True,
        )
    if not quiet:
        typer.echo(f"{path}: a first motion of {robot.name}, with its joints and limits. Next:")
        typer.echo(f"  mbocp solve {path} --replay {path.with_suffix('.html')}")


def _schema_line(path: Path) -> str:
    """The first line of a file beside which `mbocp schema` has written what editors know."""
    return f"#:schema ./{SCHEMA_FILE}\n" if is_file(path.parent / SCHEMA_FILE) else ""


def _only_rotors(robot: Any) -> bool:
    """Whether the root stands still and several joints, in no loop, turn without end and without effort."""
    limits = robot.limits
    turns = limits.position_upper - limits.position_lower
    endless = bool((turns > _MANY_TURNS).all() and not (limits.effort < math.inf).any())
    return (
        1 < robot.nv == robot.nu == len(robot.joint_names)
        and robot.nq == robot.nv
        and not robot.nc
        and endless
    )


def _path_from(name: str, path: Path) -> str:
    """Name of the robot, or where it is as the file sees it."""
    found = Path(name)
    if not found.exists() or (os.sep not in name and found.suffix == ""):
        return name
    folder = path.parent.resolve()
    try:
        relative = found.resolve().relative_to(folder)
    except ValueError:
        return str(found.resolve())
    return relative.as_posix() if relative.suffix or os.sep in str(relative) else f"./{relative.as_posix()}"
