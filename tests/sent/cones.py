"""Random motions of a tool in a cone, a tube and clear of spheres, as sent: `python -m tests.sent.cones`.

Within what makers publish, in the least time, without torques. The tool's axis stays within a cone about its
direction at the start; every third keeps in a tube along the line to its goal, the others off two spheres.
Files are read by the program of `tests.sent.reader`, angles and distances at each of their samples.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.touching import Touching
from mbocp.exceptions import MbocpError
from mbocp.problem import Problem
from tests.sent.cases import LEAST, PROFILES, ROBOTS
from tests.sent.reader import limits_of, samples_of, violation_of_samples
from tests.sent.rows import add_options, rows_of
from tests.sent.seams import STARTS, TOOLS

CONE, TUBE, STEPS, RATE = 0.15, 0.01, 60, 1000.0  # [rad], [m], 1, [1/s]
_REACH, _RADII, _AROUND = 0.3, (0.04, 0.1), 0.35  # [m]
_TURNS = 0.3  # [rad], of the joints at the start
_MORE = 5e-3, 5e-4  # [rad], [m]: what exports may leave
_KEPT = 1e-6  # of a limit


def problem_of(name: str, seed: int) -> Problem:
    """A random start, a goal of the tool's place, and what is in between.

    Raises
    ------
    MbocpError
        If start or goal touch something or are out of reach.
    """
    (robot, limits), tool, rng = ROBOTS[name], TOOLS[name], np.random.default_rng(seed)
    limits = {**limits, "effort": False, **({"effort_rate": False} if name == "fr3" else {})}
    q = STARTS[name] + rng.uniform(-_TURNS, _TURNS, len(STARTS[name]))
    at = Problem.create(robot, 1.0, 2, goal={"q": q}).robot.frame_placement(tool, q)
    points, way = at.rotation[:, 2], rng.uniform(-_REACH, _REACH, 3)
    goal = {"name": tool, "position": at.translation + way, "axis": [0, 0, 1], "direction": points}
    path: list[dict[str, Any]] = [{"kind": "orientation", "frame": tool, "direction": points, "max": CONE}]
    spheres = [
        {
            "shape": "sphere",
            "radius": float(rng.uniform(*_RADII)),
            "position": at.translation + way / 2.0 + rng.uniform(-_AROUND, _AROUND, 3),
        }
        for _ in range(2)
    ]
    is_tube = seed % 3 == 0
    path += [{"kind": "line", "frame": tool, "tolerance": TUBE}] * is_tube
    return Problem.create(
        robot,
        {"min": 0.2, "max": 6.0},
        STEPS,
        start={"q": q},
        goal={"frame": {**goal, "orientation_tolerance": 0.95 * CONE}, "v": 0},
        limits=limits,
        cost=LEAST,
        path=path,
        obstacle=[] if is_tube else spheres,
    )


def row_of(name: str, seed: int) -> dict[str, Any]:
    """Solve, write, read back."""
    row: dict[str, Any] = {"robot": name, "seed": seed}
    try:
        problem = problem_of(name, seed)
    except MbocpError as error:
        return row | {"status": "refused", "why": str(error)}
    begun = time.process_time()
    solution = mbocp.solve(problem, time_limit=60.0)
    row |= {"status": str(solution.status), "iterations": solution.iterations, "advice": solution.advice}
    row["seconds"] = time.process_time() - begun
    if not solution.converged:
        return row
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            file = solution.export(Path(folder) / "motion.csv", rate=RATE)
        except MbocpError as error:
            return row | {"status": "not written", "why": str(error)}
        limits = limits_of(PROFILES / f"{name}.toml", **({"acceleration": 15.0} if name == "ur5e" else {}))
        row["violation"] = max(violation_of_samples(file, RATE, limits).values())
        return row | _left(problem, file, TOOLS[name], is_tube=seed % 3 == 0)


def _left(problem: Problem, file: Path, tool: str, *, is_tube: bool) -> dict[str, Any]:
    """By what samples leave cone [rad] and tube [m], and whether they touch something."""
    t, q = samples_of(file)
    model, data = problem.robot.model, problem.robot.model.createData()
    frame, tips, axes = model.getFrameId(tool), [], []
    for row in q:
        pin.framesForwardKinematics(model, data, row)
        tips.append(data.oMf[frame].translation.copy())
        axes.append(data.oMf[frame].rotation[:, 2].copy())
    angles = np.arccos(np.clip(np.array(axes) @ axes[0], -1.0, 1.0))
    away, along = np.array(tips) - tips[0], tips[-1] - tips[0]
    aside = np.linalg.norm(np.cross(away, along), axis=1) / np.linalg.norm(along)
    touched = None if is_tube else Touching.of(problem).first(t, q)
    return {
        "cone": float(angles.max() - CONE),
        "tube": float(aside.max() - TUBE) if is_tube else 0.0,
        "touches": touched is not None,
    }


def main() -> int:
    """Run or go on; 1 if a converged motion is not written, or a file leaves something."""
    parser = argparse.ArgumentParser(prog="python -m tests.sent.cones", description=__doc__)
    add_options(parser, 200, "build/cones.jsonl")
    options = parser.parse_args()
    rows, is_good = rows_of(options, row_of), True
    print("| robot | problems | converged | not written | cone | tube | touch | largest violation |")
    for name in options.robots:
        own = [row for row in rows if row["robot"] == name and row["status"] != "refused"]
        good = [row for row in own if row["status"] == "converged"]
        unwritten = sum(row["status"] == "not written" for row in own)
        cone, tube, violation = (max(row[key] for row in good) for key in ("cone", "tube", "violation"))
        touching = sum(row["touches"] for row in good)
        is_good &= (
            not (unwritten or touching) and violation <= _KEPT and cone <= _MORE[0] and tube <= _MORE[1]
        )
        print(
            f"| {name} | {len(own)} | {len(good) + unwritten} | {unwritten} | {1e3 * cone:.2g} mrad "
            f"| {1e3 * tube:.2g} mm | {touching} | {violation:.0e} |"
        )
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
