"""Robots with closed loops, from a folder of theirs: `python -m benchmarks.parallel_robots FOLDER`.

Each is loaded, assembled, and moved from rest to rest: all motors by the same angle, the base fixed. The
folder may be the `robots` of github.com/Gepetto/example-parallel-robots.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.tables import Table, show
from mbocp.exceptions import MbocpError
from mbocp.problem import Problem
from mbocp.robot import HeldJointsWarning, Robot

__all__ = ["folders_of_robots", "robot_rows", "robot_table"]

_COLUMNS = (
    "robot",
    "loaded",
    "unknowns",
    "rows",
    "rank",
    "motors",
    "joints held",
    "closure [m, rad]",
    "reach [rad, m]",
    "status",
    "iterations",
    "first [s]",
    "again [s]",
    "why not, or why not farther",
)
_DURATION, _STEPS = 1.0, 60  # [s]
_LIMIT = 900.0  # [s] for a motion, its derivatives included
_REACHES = (0.2, 0.05)


def folders_of_robots(folder: Path) -> list[Path]:
    """Folders with a URDF in a folder, in order."""
    return sorted(path for path in folder.iterdir() if path.is_dir() and any(path.glob("*.urdf")))


def robot_rows(folders: Sequence[Path], reaches: Sequence[float] = _REACHES) -> Iterator[tuple[str, ...]]:
    """A row for each robot: the first of the reaches that is not refused."""
    for folder in folders:
        row = _row(folder, reaches)
        print(*row, sep=" | ", flush=True)
        yield row


def robot_table(rows: Sequence[tuple[str, ...]]) -> Table:
    """The table of these rows."""
    note = (
        f"From rest to rest in {_DURATION:g} s and {_STEPS} steps, all motors by the same reach; rest is "
        "asked of the motors alone where other joints move beside them. Unknowns: velocities; rank: rows "
        "that are kept. First: with derivatives made and kept; again: with these."
    )
    return Table("Parallel robots", _COLUMNS, rows, note)


def _row(folder: Path, reaches: Sequence[float]) -> tuple[str, ...]:
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            robot = mbocp.load_robot(folder)
        except MbocpError as error:
            return (folder.name, "no", *[""] * (len(_COLUMNS) - 3), _short(error))
    held = [len(w.message.joints) for w in told if isinstance(w.message, HeldJointsWarning)]
    closure = float(np.abs(robot.closure_residual(robot.q0)).max(initial=0.0))
    numbers = robot.nv, len(robot.closure_labels), robot.nc, robot.nu, sum(held)
    found = (folder.name, "yes", *map(str, numbers), f"{closure:.0e}")
    if not robot.nc:
        return (*found, *[""] * 5, "has no loops")
    return (*found, *_moved(robot, reaches))


def _moved(robot: Robot, reaches: Sequence[float]) -> tuple[str, ...]:
    """Reach, status, iterations, seconds of the first time and again, and why not."""
    reason = ""
    for reach in reaches:
        seconds = []
        try:
            for _ in range(2):
                begun = time.perf_counter()
                solution = mbocp.solve(_problem(robot, reach))
                seconds.append(f"{time.perf_counter() - begun:.1f}")
        except MbocpError as error:
            reason = reason or _short(error)
            continue
        return f"{reach:g}", str(solution.status), str(solution.iterations), *seconds, reason
    return f"{reaches[-1]:g}", "refused", "", "", "", reason


def _problem(robot: Robot, reach: float) -> Problem:
    motors = list(_motors(robot))
    goal = {name: float(robot.q0[robot.configuration_indices(name)][0]) + reach for name in motors}
    stops = 0 if robot.nv - robot.nc == robot.nu else dict.fromkeys(motors, 0.0)
    return Problem.create(
        robot,
        _DURATION,
        _STEPS,
        start={"q": robot.q0},
        goal={"q": goal, "v": stops},
        solver={"time_limit": _LIMIT},
    )


def _motors(robot: Robot) -> Iterator[str]:
    """Joints with a motor and one number."""
    has_motor = np.abs(robot.actuation.selection).sum(axis=1) > 0.0
    for name in robot.joint_names:
        if (
            has_motor[robot.velocity_indices(name)].any()
            and len(robot.q0[robot.configuration_indices(name)]) == 1
        ):
            yield name


def _short(error: MbocpError) -> str:
    """What an error says, without the folders of this machine."""
    words = [word.rpartition("/")[2] if word.startswith("/") else word for word in str(error).split()]
    return " ".join(words).removeprefix("problem: ")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, and write it."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.parallel_robots", description=__doc__)
    parser.add_argument("folder", type=Path, help="with a folder for each robot")
    parser.add_argument(
        "--reach", type=float, nargs="+", default=list(_REACHES), help="tried in turn [rad, m]"
    )
    parser.add_argument("--csv", type=Path, help="file to write the table into")
    options = parser.parse_args(arguments)
    os.environ["MBOCP_FUNCTIONS"] = "tapes"  # no compiler runs, as in first motions of users
    one_core()
    machine = header()
    show(machine)
    rows = list[tuple[str, ...]]()
    for row in robot_rows(folders_of_robots(options.folder), options.reach):
        rows.append(row)
        if options.csv is not None:  # at once: all take long
            _write(robot_table(rows), options.csv, machine)
    print(robot_table(rows).note)


def _write(table: Table, path: Path, machine: Table) -> None:
    table.to_csv(path)
    what = "; ".join(" ".join(row) for row in machine.rows)
    command = f"# {time.strftime('%Y-%m-%d')}, python -m benchmarks.parallel_robots FOLDER; {what}\n"
    path.write_text(command + path.read_text(encoding="utf-8"), encoding="utf-8")


if __name__ == "__main__":
    main()
