"""Random scenes with goals of joints or of a tool, and what their files touch: `python -m tests.sent.scenes`.

Scenes are those of `benchmarks.scenes`, in the least time within what makers publish. Files are read by the
program of `tests.sent.reader`; coal looks at the meshes at each of their samples.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.scenes import scene
from benchmarks.touching import Touching
from mbocp.problem import Problem
from tests.sent.cases import LEAST, ROBOTS, TOLERANCE, violations
from tests.sent.rows import add_options, rows_of

TOOLS = {"ur5e": "tool0", "fr3": "panda_hand"}
SCENES = {"ur5e": "ur5", "fr3": "panda"}
STEPS = 60
_EXACT = 1e-5  # [m, rad], of the tool at its goal


def problem_of(name: str, number: int) -> Problem:
    """A scene within a profile; every other one asks for the tool's place instead of the joints'."""
    base = scene(SCENES[name], number)
    goal: dict[str, Any] = {"q": base.goal.q, "v": 0}
    if number % 2:
        at = base.robot.frame_placement(TOOLS[name], base.goal.q)
        turn = pin.Quaternion(at.rotation).coeffs()
        goal = {"frame": {"name": TOOLS[name], "position": at.translation, "orientation": turn}, "v": 0}
    return base.with_(
        duration={"min": 0.3, "max": 8.0},
        steps=STEPS,
        goal=goal,
        limits={**ROBOTS[name][1], "effort": False, **({"effort_rate": False} if name == "fr3" else {})},
        cost=LEAST,
        scheme="gauss2",
    )


def row_of(name: str, number: int) -> dict[str, Any]:
    """Solve, write, read back, and look at what is touched."""
    row: dict[str, Any] = {"robot": name, "seed": number}
    try:
        problem = problem_of(name, number)
    except mbocp.exceptions.MbocpError as error:  # a pose beyond the profile's limits
        return row | {"status": "refused", "words": str(error)}
    begun = time.perf_counter()
    solution = mbocp.solve(problem, time_limit=120.0)
    row |= {"seconds": time.perf_counter() - begun, "status": str(solution.status)}
    row |= {"iterations": solution.iterations, "found": solution.duration, "advice": solution.advice}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        row |= violations(solution, Path(folder), name)
        row |= _touched(problem, Path(folder) / "1000.csv", name)
        row["told"] = [str(one.message) for one in told]
    return row


def _touched(problem: Problem, file: Path, name: str) -> dict[str, Any]:
    """What the samples of a file touch, and how far its end is from a tool's goal."""
    with file.open() as lines:
        header, *rows = csv.reader(lines)
    table = np.array(rows, dtype=float)
    q = table[:, [k for k, title in enumerate(header) if title.startswith("q:")]]
    found = {"touches": Touching.of(problem).first(table[:, 0], q), "away": 0.0}
    for frame in problem.goal.frames:
        robot, target = problem.robot, frame.target
        pin.framesForwardKinematics(robot.model, data := robot.model.createData(), q[-1])
        at = data.oMf[robot.model.getFrameId(TOOLS[name])]
        wanted = pin.SE3(pin.Quaternion(target.orientation), target.position)
        found["away"] = float(np.abs(pin.log6(wanted.actInv(at)).vector).max())
    return found


def main() -> int:
    """Run or go on; 1 if a converged motion leaves a limit, touches something, or misses its goal."""
    parser = argparse.ArgumentParser(prog="python -m tests.sent.scenes", description=__doc__)
    add_options(parser, 100, "build/scenes.jsonl")
    options = parser.parse_args()
    rows = rows_of(options, row_of)
    print("| robot | scenes | converged | seconds: median, 90 % | touch something | largest violation |")
    print("|---|---|---|---|---|---|")
    is_good = True
    for name in options.robots:
        own = [row for row in rows if row["robot"] == name and row["status"] != "refused"]
        good = [row for row in own if row["status"] == "converged"]
        seconds = np.quantile([row["seconds"] for row in own], [0.5, 0.9])
        worst = max((v, kind, row["seed"]) for row in good for kind, v in row["violations"].items())
        touching = sum(row["touches"] is not None for row in good)
        is_good &= worst[0] <= TOLERANCE and not touching and max(row["away"] for row in good) < _EXACT
        print(
            f"| {name} | {len(own)} | {len(good)} | {seconds[0]:.2f}, {seconds[1]:.2f} | {touching} "
            f"| {worst[0]:.1e} ({worst[1]}, {worst[2]}) |"
        )
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
