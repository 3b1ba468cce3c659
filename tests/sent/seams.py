"""Seams of 0.3 m at a steady speed of a tool, written and read back: `python -m tests.sent.seams`.

From rest to the seam and from its end to rest; on it within 1 % of the speed, 0.5 mm and 20 mrad. The speed
in the files is that of differences of positions, from sample to sample.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import mbocp
from mbocp.problem import Problem
from mbocp.robot import Robot
from tests.sent.cases import PROFILES, ROBOTS
from tests.sent.reader import limits_of, samples_of, violation_of_samples

LENGTH, BULGE, BAND, TUBE, TURN = 0.3, 0.04, 0.01, 5e-4, 0.02  # [m], [m], 1, [m], [rad]
MOST_OFF = 0.02  # of the speed, in files: band, and what exports may leave of it
RATES = (125, 500, 1000)  # samples a second
SPEEDS = (0.05, 0.1, 0.2)  # [m/s]
TOOLS = {"ur5e": "tool0", "fr3": "panda_hand"}
STARTS = {
    "ur5e": [0.0, -1.57, 1.57, -1.57, -1.57, 0.0],
    "fr3": [0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.785],
}
_STEPS = 110
_COST = {"time": 1.0, "effort": 1e-5, "velocity": 0, "acceleration": 0.05}


def problem_of(name: str, speed: float, *, is_curved: bool) -> Problem:
    """Lead-in, seam and lead-out, from rest to rest."""
    (robot, limits), tool, q = ROBOTS[name], TOOLS[name], np.array(STARTS[name])
    limits = {**limits, "effort": False, **({"effort_rate": False} if name == "fr3" else {})}
    still = Problem.create(robot, 1.0, 2, goal={"q": q, "v": 0})
    at = still.robot.frame_placement(tool, q)
    seam = seam_of(at.translation, BULGE if is_curved else 0.0)
    ends = [speed * way / np.linalg.norm(way) for way in (seam[1] - seam[0], seam[-1] - seam[-2])]
    time, turn = LENGTH / speed, pin.Quaternion(at.rotation).coeffs()
    via = [
        {
            "name": word,
            "time": {"min": 0.1, "max": 1.2 * time + 5.0, "guess": 0.8 + k * time},
            "share": (0.15, 0.85)[k],
            "frame": {"name": tool, "position": seam[-k], "orientation": turn, "velocity": ends[k]},
        }
        for k, word in enumerate(("in", "out"))
    ]
    on_seam = {"frame": tool, "from": "in", "until": "out"}
    line = {"kind": "line", "a": seam[0], "b": seam[-1]}
    way = {"kind": "follow", "points": seam[:: len(seam) // 9]} if is_curved else line
    along = {"kind": "speed", "direction": seam[-1] - seam[0]}
    band = {"min": (1.0 - BAND) * speed, "max": (1.0 + BAND) * speed}
    forwards = {**along, "name": "forwards", "min": speed / 2.0}  # where the seam turns: no way back
    speeds = [{"kind": "speed", **band}, forwards] if is_curved else [{**along, **band}]
    return still.with_(
        duration={"min": time, "max": 1.2 * time + 6.0, "guess": time + 1.6},
        steps=_STEPS,
        start={"q": q},
        limits=limits,
        cost=_COST,
        via=via,
        path=[
            {**way, "tolerance": TUBE, **on_seam},
            {"kind": "orientation_kept", "tolerance": TURN, **on_seam},
            *({**one, **on_seam} for one in speeds),
        ],
    )


def seam_of(middle: np.ndarray, bulge: float) -> np.ndarray:
    """Points along y, 5 cm below a place, half a wave aside, shape (901, 3) [m]."""
    share = np.linspace(0.0, 1.0, 901)
    ways = (-bulge * np.sin(np.pi * share), LENGTH * (share - 0.5), np.full(len(share), -0.05))
    return middle + np.stack(ways, axis=1)


def row_of(name: str, speed: float, folder: Path, *, is_curved: bool) -> dict[str, Any]:
    """Solve, write, read back."""
    problem = problem_of(name, speed, is_curved=is_curved)
    solution = mbocp.solve(problem, time_limit=120.0)
    row = {"status": str(solution.status), "iterations": solution.iterations, "off": 0.0, "aside": 0.0}
    limits = limits_of(PROFILES / f"{name}.toml", **({"acceleration": 15.0} if name == "ur5e" else {}))
    worst = 0.0
    for rate in RATES:
        file = solution.export(folder / f"{rate}.csv", rate=float(rate))
        worst = max(worst, *violation_of_samples(file, float(rate), limits).values())
        off, aside = _on_seam(file, problem.robot, TOOLS[name], speed, BULGE if is_curved else 0.0)
        row |= {"off": max(row["off"], off), "aside": max(row["aside"], aside)}
    return row | {"violation": worst}


def _on_seam(file: Path, robot: Robot, tool: str, speed: float, bulge: float) -> tuple[float, float]:
    """How far the speed between samples is off, relative, and the tool aside of the seam [m]."""
    t, q = samples_of(file)
    model, data = robot.model, robot.model.createData()
    frame, places = model.getFrameId(tool), []
    for row in q:
        pin.framesForwardKinematics(model, data, row)
        places.append(data.oMf[frame].translation.copy())
    tips = np.array(places)
    seam = seam_of(tips[0], bulge)
    is_on = np.abs(tips[:, 1] - tips[0, 1]) < LENGTH / 2.0
    is_on &= tips[:, 2] - seam[0, 2] < 2.0 * TUBE
    ends = np.flatnonzero(np.diff(np.concatenate([[0], is_on, [0]]))).reshape(-1, 2)
    on = slice(*ends[np.diff(ends, axis=1)[:, 0].argmax()])  # leads may pass near it
    speeds = np.linalg.norm(np.diff(tips[on], axis=0), axis=1) / np.diff(t[on])
    aside = [np.linalg.norm(seam - tip, axis=1).min() for tip in tips[on]]
    return float(np.abs(speeds / speed - 1.0).max()), float(max(aside))


def main() -> int:
    """Print a row for each; 1 if one does not converge, is not written, or leaves a limit or the band."""
    parser = argparse.ArgumentParser(prog="python -m tests.sent.seams", description=__doc__)
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=list(ROBOTS))
    options = parser.parse_args()
    print("| robot | seam | speed | iterations | speed off | aside | largest violation |")
    is_good = True
    for name, is_curved, speed in product(options.robots, (False, True), SPEEDS):
        what = f"| {name} | {'curved' if is_curved else 'straight'} | {speed} m/s"
        with tempfile.TemporaryDirectory() as folder:
            try:
                row = row_of(name, speed, Path(folder), is_curved=is_curved)
            except mbocp.exceptions.MbocpError as error:
                is_good = False
                print(f"{what} | {error} |", flush=True)
                continue
        is_good &= row["status"] == "converged" and row["off"] <= MOST_OFF and row["violation"] < 1e-6
        print(
            f"{what} | {row['iterations']} | {row['off']:.2%} | {1e3 * row['aside']:.2f} mm "
            f"| {row['violation']:.0e} | {row['status']}",
            flush=True,
        )
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
