"""Which robots load, move and are reported: python -m benchmarks.robot_files ROBOT[,argument=value...] ...

A robot is a file or a name; without any, all names of example-robot-data are taken. Each is loaded in a
process of its own; the problem that `mbocp new` writes for it, its base held, is read ("checks"), solved
("moves"), and its report is written. `--load` stops after the first. Files of others are not part of this
repository.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import os
import resource
import signal
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path

import mbocp
from benchmarks.machine import header
from benchmarks.tables import Table, show
from mbocp.exceptions import MbocpError
from mbocp.problem.file.first import first_file
from mbocp.robot import Robot, list_robots, load_robot
from mbocp.robot.loading.mechanics_checks import SingularMassMatrix
from mbocp.robot.loading.robot_formats import format_of
from mbocp.view.report import write_report

__all__ = ["outcome_table"]

_COLUMNS = (
    *("robot", "format", "nv", "motors", "constraint rows"),
    *("loads", "checks", "moves", "reports", "reason"),
)
_STAGES = slice(_COLUMNS.index("loads"), -1)
_FORK = multiprocessing.get_context("fork")  # with all that is imported
_LIMIT = 60  # [s] of a core for one robot, whatever else the machine does


def outcome_table(rows: Sequence[tuple[str, ...]]) -> Table:
    """What became of each robot."""
    stages = list(enumerate(_COLUMNS))[_STAGES]
    words = [f"{what} {sum(row[place] == 'yes' for row in rows)}" for place, what in stages]
    return Table("Robots", _COLUMNS, rows, f"of {len(rows)}: {', '.join(words)}")


def _apart(robot: str, *, solve: bool) -> tuple[str, ...]:
    """The row of a robot, worked out in a process of its own, as far as it came."""
    ours, theirs = _FORK.Pipe(duplex=False)
    process = _FORK.Process(target=_work, args=(robot, theirs), kwargs={"solve": solve})
    process.start()
    theirs.close()
    row, reason = _padded([_name(robot), _format(robot)]), ""
    with contextlib.suppress(EOFError):
        while True:
            row = ours.recv()
    process.join()
    if process.exitcode:
        too_long = process.exitcode == -signal.SIGXCPU
        reason = f"more than {_LIMIT} s" if too_long else f"the process ended with {process.exitcode}"
    return (*row[:-1], reason or row[-1])


def _work(robot: str, out: Connection, *, solve: bool) -> None:
    warnings.simplefilter("ignore")
    resource.setrlimit(resource.RLIMIT_CPU, (_LIMIT, _LIMIT + 1))
    for row in _rows(robot, solve=solve):
        out.send(row)


def _padded(row: Sequence[str], reason: str = "") -> tuple[str, ...]:
    return (*row, *[""] * (len(_COLUMNS) - 1 - len(row)), reason)


def _path(robot: str) -> Path | None:
    path = Path(robot.partition(",")[0])
    return path if path.suffix else None


def _name(robot: str) -> str:
    path = _path(robot)
    return robot if path is None else " ".join(["/".join(path.parts[-2:]), *robot.split(",")[1:]])


def _format(robot: str) -> str:
    path = _path(robot)
    return "example-robot-data" if path is None else format_of(path).name


def _rows(robot: str, *, solve: bool) -> Iterator[tuple[str, ...]]:
    """The row of a robot, after each stage."""
    name, *said = robot.split(",")
    arguments = dict(word.split("=", 1) for word in said) or None
    row = [_name(robot), _format(robot)]
    try:
        found = _held(_path(robot) or name, arguments)
        row += [str(found.nv), str(found.nu), str(found.nc), "yes"]
        yield _padded(row)
        if not solve:
            return
        if found.nu == 0:
            yield _padded(row, "no motors")
            return
        note = "no inertias: by kinematics" if found.spec.get("dynamics") is False else ""
        with tempfile.TemporaryDirectory() as folder:
            for stage in _stages(found, Path(folder)):
                row.append("yes" if not stage else "no")
                yield _padded(row, stage or note)
                if stage:
                    return
    except MbocpError as error:
        row += [""] * (_STAGES.start - len(row))
        yield _padded([*row, "no"], " ".join(str(error).replace(f"{name}: ", "").split())[:160])


def _held(robot: Path | str, arguments: dict[str, str] | None) -> Robot:
    """The robot on a base that stands still, unless it is built as it is, or rotors push the base.

    One that has no inertias moves by kinematics, as `mbocp new` takes it.
    """
    try:
        return load_robot(robot, arguments=arguments, free_flyer=False)
    except SingularMassMatrix as error:
        return load_robot(robot, arguments=arguments, free_flyer=False, dynamics=not error.are_all)
    except MbocpError:
        return load_robot(robot, arguments=arguments)


def _stages(robot: Robot, folder: Path) -> Iterator[str]:
    """Check, solve and report its first problem: why not, or nothing."""
    file = folder / "first.toml"
    file.write_text(first_file(robot, dict(robot.spec), file), encoding="utf-8")
    problem = mbocp.load_problem(file)
    yield ""
    solution = mbocp.solve(problem)
    yield "" if solution.converged else str(solution.status)
    write_report(solution, folder / "report.html", robot=robot)
    yield ""


def _examples() -> list[str]:
    return [entry.name for entry in list_robots() if entry.source == "example-robot-data"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, or write it."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.robot_files", description=__doc__)
    parser.add_argument("robots", nargs="*", metavar="ROBOT", help="default: names of example-robot-data")
    parser.add_argument("--load", action="store_true", help="only load them")
    parser.add_argument("-o", "--output", type=Path, help="a CSV")
    options = parser.parse_args(arguments)
    os.environ["MBOCP_FUNCTIONS"] = "tapes"  # no compiler runs, as in first motions of users
    machine = "; ".join(" ".join(row) for row in header().rows)
    robots, rows = options.robots or _examples(), list[tuple[str, ...]]()
    for place, robot in enumerate(robots, start=1):
        rows.append(_apart(robot, solve=not options.load))
        if options.output is not None:  # at once: all take long
            _write(options.output, outcome_table(rows), machine, robots[place:])
    show(outcome_table(rows))


def _write(path: Path, table: Table, machine: str, missing: Sequence[str]) -> None:
    table.to_csv(path)
    rest = f"; not measured: {', '.join(missing)}" if missing else ""
    head = f"# {time.strftime('%Y-%m-%d')}, python -m benchmarks.robot_files; {machine}{rest}\n"
    path.write_text(head + path.read_text(encoding="utf-8"), encoding="utf-8")


if __name__ == "__main__":
    main()
