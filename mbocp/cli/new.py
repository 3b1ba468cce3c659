"""`mbocp new`: a problem file to begin with; `mbocp keys` and `schema`: its keys, from their declarations."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.padding import Padding
from rich.text import Text

from mbocp._files import is_file
from mbocp._keys import without_links
from mbocp.cli.app import Dynamics, FreeFlyer, Json, Locks, PackageDirs, Quiet, Robot, argument, output_file
from mbocp.cli.console import output
from mbocp.cli.key_search import find_keys
from mbocp.cli.robot_options import ROOT, RobotOptions
from mbocp.cli.solve import check_output
from mbocp.exceptions import ResultFileError, UnsupportedRobot

if TYPE_CHECKING:
    from mbocp.problem.file.keys_page import Row

SCHEMA_FILE = "mbocp.schema.json"  # the name by which problem files beside it know it


def keys(
    name: Annotated[
        str | None, argument("NAME", "A key, a table, the last part of a name, or a word. [default: all]")
    ] = None,
    as_json: Json = False,
) -> None:
    """Say what keys of problem files take and mean.

    A word that none of them has is looked for in robot.toml.
    """
    from mbocp.problem.file.keys_page import rows

    chosen = find_keys(rows(), name, every=as_json)
    if as_json:
        typer.echo(json.dumps([_facts(key, row) for key, row in chosen.items()], indent=2))
        return
    lines: dict[tuple[str, Row], list[str]] = {}  # keys beside each other that one row describes
    for key, row in chosen.items():
        lines.setdefault((key.rpartition(".")[0], row), []).append(key)
    console = output()
    for (under, row), (first, *others) in lines.items():
        names = ", ".join([first, *(other.removeprefix(f"{under}.") for other in others)])
        taken, says = (without_links(words).replace("`", "") for words in (row.brackets(), row.says))
        console.print(Text.assemble((names, "bold"), taken), Padding(Text(says), (0, 0, 0, 4)), sep="\n")


def _facts(key: str, row: Row) -> dict[str, str]:
    cells = {"takes": row.takes, "unit": row.unit, "default": row.default, "says": row.says}
    return {"key": key, **{name: without_links(words) for name, words in cells.items()}}


def schema(
    output: Annotated[Path | None, output_file("FILE.json", "File to write. [default: the screen]")] = None,
) -> None:
    """Write the JSON schema of problem files.

    Editors complete, check and explain their keys by it.
    """
    from mbocp.problem.file.read_tables import problem_schema
    from mbocp.solution.atomic import replace_text

    text = json.dumps(problem_schema(), indent=1)
    if output is None:
        typer.echo(text)
    else:
        check_output(output, "-o", (".json",))
        replace_text(output, f"{text}\n")


_SUFFIXES = (".toml",)
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
        if ROOT not in robot.joint_names:
            raise UnsupportedRobot(
                f"robot {robot.name!r}: nothing moves it; its joints have no motors: name those that have in "
                "robot.actuated, or write actuators into a robot.toml"
            )
        from mbocp.robot import robot_from_spec

        table["actuated"] = [ROOT]
        robot = robot_from_spec({**options.table(name), "actuated": [ROOT]})
    replace_text(path, _schema_line(path) + first_file(robot, table, path))
    for note in _notes(name, robot, options):
        typer.echo(f"note: {note}", err=True)
    if not quiet:
        typer.echo(f"{path}: a first motion of {robot.name}, with its joints and limits. Next:")
        typer.echo(f"  mbocp solve {path} --replay {path.with_suffix('.html')}")


def _notes(name: str, robot: Any, options: RobotOptions) -> Iterator[str]:
    """What may be meant otherwise than the file has it."""
    from mbocp.robot.robot_facts import find_oddities

    if _only_rotors(robot) and options.free_flyer is None:
        locks = " ".join(f"--lock {joint}" for joint in robot.joint_names)
        yield (
            f"all joints of {robot.name} turn without end, and none has an effort: if they are rotors "
            f"of something that flies, say\n  mbocp new {name} --free-flyer {locks}"
        )
    yield from find_oddities(robot, key="robot.mimic")


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
