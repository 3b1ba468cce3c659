"""How many files of robots load, and move: python -m benchmarks.robot_files FILE[,argument=value...] ...

Each file is loaded in a process of its own; then the problem that `mbocp new` writes for the robot, its base
held, is solved. `--load` leaves the latter out. Files of others are not part of this repository.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import mbocp
from benchmarks.tables import Table, show
from mbocp.exceptions import MbocpError
from mbocp.problem.file.first import first_file
from mbocp.robot import load_robot
from mbocp.robot.loading.formats import format_of

__all__ = ["outcome_table"]

_COLUMNS = ("file", "format", "nv", "motors", "constraint rows", "loads", "moves", "reason")
_LIMIT = 45.0  # [s] for one file


def outcome_table(files: Sequence[str], *, solve: bool) -> Table:
    """What became of each file."""
    rows = [_apart(file, solve=solve) for file in files]
    counts = Counter((row[1], row[5], row[6]) for row in rows)
    words = [
        f"{kind}: {loads} loads, {moves or '-'} moves: {n}"
        for (kind, loads, moves), n in sorted(counts.items())
    ]
    return Table("Files of robots", _COLUMNS, rows, "; ".join(words))


def _apart(file: str, *, solve: bool) -> tuple[str, ...]:
    """The row of a file, worked out in a process of its own."""
    command = [sys.executable, "-m", __spec__.name, "--one", file, *(() if solve else ("--load",))]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT, check=False)
        return tuple(json.loads(done.stdout.splitlines()[-1]))
    except subprocess.TimeoutExpired:
        reason = f"more than {_LIMIT:g} s"
    except (IndexError, ValueError):
        reason = f"the process ended with {done.returncode}"
    path = Path(file.partition(",")[0])
    return _name(path), format_of(path).name, "", "", "", "", "", reason


def _name(path: Path) -> str:
    return "/".join(path.parts[-2:])


def _row(file: str, *, solve: bool) -> tuple[str, ...]:
    """The row of a file."""
    path, *said = file.split(",")
    arguments = dict(word.split("=", 1) for word in said) or None
    head = (_name(Path(path)), format_of(Path(path)).name)
    try:
        robot = load_robot(Path(path), arguments=arguments)
    except MbocpError as error:
        return (*head, "", "", "", "no", "", _reason(error, path))
    sizes = (str(robot.nv), str(robot.nu), str(robot.nc))
    if not solve:
        return (*head, *sizes, "yes", "", "")
    try:
        return (*head, *sizes, "yes", *_moved(Path(path), arguments))
    except MbocpError as error:
        return (*head, *sizes, "yes", "no", _reason(error, path))


def _moved(path: Path, arguments: dict[str, str] | None) -> tuple[str, str]:
    """Whether its first problem is solved, and else how it ended."""
    robot = load_robot(path, arguments=arguments, free_flyer=False)
    if robot.nu == 0:
        return "", "no motors"
    with tempfile.TemporaryDirectory() as folder:
        problem = Path(folder) / "first.toml"
        problem.write_text(first_file(robot, dict(robot.spec), problem), encoding="utf-8")
        solution = mbocp.solve(mbocp.load_problem(problem))
    return ("yes", "") if solution.converged else ("no", str(solution.status))


def _reason(error: Exception, path: str) -> str:
    return " ".join(str(error).replace(f"{path}: ", "").split())[:160]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, or write it."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.robot_files", description=__doc__)
    parser.add_argument("files", nargs="*", metavar="FILE")
    parser.add_argument("--load", action="store_true", help="only load them")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    parser.add_argument("-o", "--output", type=Path, help="a CSV")
    options = parser.parse_args(arguments)
    if options.one is not None:
        warnings.simplefilter("ignore")
        print(json.dumps(_row(options.one, solve=not options.load)))
        return
    table = outcome_table(options.files, solve=not options.load)
    if options.output is not None:
        table.to_csv(options.output)
    show(table)


if __name__ == "__main__":
    main()
