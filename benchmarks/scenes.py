"""Random scenes of spheres and boxes: `python -m benchmarks.scenes`.

UR5 and Panda go from rest to rest between three and ten obstacles, and keep away from themselves. Start and
goal are clear; whether there is a way between them nobody knows. Every motion is looked at at a thousand
poses a second, by coal on the meshes of the links.

Scenes that are done stand in a file, a line of JSON each; the same command goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.machine import header
from benchmarks.tables import Table, show
from benchmarks.touching import Touching
from mbocp._arrays import Array
from mbocp.guesses.around import has_no_way
from mbocp.problem import Problem
from mbocp.robot import Robot

__all__ = ["ROBOTS", "record_of", "scene", "scene_table"]

ROBOTS: Mapping[str, Mapping[str, float]] = {
    "ur5": {},
    "panda": {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02},
}
_DURATION, _STEPS = 3.0, 60  # [s]
_FEWEST, _MOST = 3, 10  # obstacles
_ROOM = 0.02  # [m] around start and goal
_TRIES = 1000
_REACH = {"ur5": 0.85, "panda": 0.8}  # [m] from the shoulder
_SHOULDER = {"ur5": 0.09, "panda": 0.33}  # [m] above the base


def scene(name: str, number: int, seed: int = 0) -> Problem:
    """One problem; it depends on nothing but robot, number and seed."""
    rng = np.random.default_rng([seed, sorted(ROBOTS).index(name), number])
    robot = _robot(name)
    while True:
        q0, q1 = _pose(rng, robot), _pose(rng, robot)
        obstacles = _obstacles(rng, name, np.vstack([_spheres(robot, q) for q in (q0, q1)]))
        if obstacles is None:
            continue
        try:
            return Problem.create(
                robot,
                _DURATION,
                _STEPS,
                start={"q": q0},
                goal={"q": q1, "v": 0},
                cost={"effort": 1e-3, "velocity": 0.1},
                limits={"position": True},
                obstacle=obstacles,
                self_collision=True,
                scheme="se1",
            )
        except mbocp.exceptions.ProblemError as error:  # a pose in which the robot touches itself
            if "self_collision" not in str(error):
                raise


def record_of(problem: Problem, number: int, starts: int) -> dict[str, Any]:
    """What came of a scene."""
    problem = problem.with_(solver={"method": "auto", "starts": starts})
    used, clock = time.process_time(), time.perf_counter()
    solution = mbocp.solve(problem)
    seconds, used = time.perf_counter() - clock, time.process_time() - used
    compiled = sum(phase.wall_time_s for phase in solution.phases if phase.name == "compile")
    touching = Touching.of(problem)
    ends = [problem.robot.model, np.array(problem.q_start), np.array(problem.goal.q)]
    line = np.array([pin.interpolate(*ends, share) for share in np.linspace(0.0, 1.0, _STEPS + 1)])
    return {
        "number": number,
        "obstacles": len(problem.obstacle),
        "way": solution.converged or not has_no_way(problem),
        "line": touching.first(solution.t, line) is not None,
        "status": str(solution.status),
        "iterations": solution.iterations,
        "seconds": round(seconds - compiled, 4),
        "process": round(used, 4),
        "clearance": solution.clearance,
        "touches": touching.first(solution.t, solution.qs),
        "advice": solution.advice,
    }


def scene_table(records: Mapping[str, Sequence[Mapping[str, Any]]]) -> Table:
    """Success, time and what touches, a line for each robot."""
    rows = []
    for name, found in records.items():
        if not found:
            continue
        done = [one for one in found if one["status"] == "converged"]
        blocked = [one for one in found if one["line"]]
        possible = [one for one in found if one["way"]]
        seconds = np.array([one["seconds"] for one in found])
        rows.append(
            (
                name,
                str(len(found)),
                str(len(blocked)),
                f"{100.0 * len(done) / len(found):.1f} %",
                f"{len(done)} of {len(possible)}",
                f"{100.0 * np.mean([one['status'] == 'converged' for one in blocked] or [1.0]):.1f} %",
                str(sum(one["touches"] is not None for one in done)),
                f"{1e3 * np.median(seconds):.0f} ms",
                f"{1e3 * np.quantile(seconds, 0.95):.0f} ms",
            )
        )
    columns = (
        "",
        "scenes",
        "line blocked",
        "converged",
        "with a way",
        "of blocked",
        "of them touch",
        "median",
        "95 %",
    )
    note = (
        f"{_DURATION:g} s in {_STEPS} steps, {_FEWEST} to {_MOST} spheres and boxes, and the robot itself. "
        '"with a way": of scenes whose line touches nothing, or where a search has found a way. '
        '"touch": coal finds a link in contact at one of 1000 poses a second.'
    )
    return Table("Random scenes", columns, rows, note)


@cache
def _robot(name: str) -> Robot:
    return mbocp.load_robot(name, lock=dict(ROBOTS[name]))


def _pose(rng: np.random.Generator, robot: Robot) -> Array:
    """Joints anywhere within a half-turn and their limits."""
    low = np.maximum(robot.model.lowerPositionLimit, -np.pi)
    high = np.minimum(robot.model.upperPositionLimit, np.pi)
    return low + (high - low) * rng.uniform(0.05, 0.95, robot.nq)


def _obstacles(rng: np.random.Generator, name: str, spheres: Array) -> list[dict[str, Any]] | None:
    """Spheres and boxes that leave both ends clear; None if there is no room."""
    found: list[dict[str, Any]] = []
    count = int(rng.integers(_FEWEST, _MOST + 1))
    for _ in range(_TRIES):
        shape = "sphere" if rng.uniform() < 0.5 else "box"
        placed = {"name": f"{shape} {len(found)}", "shape": shape, **_somewhere(rng, name, shape)}
        if _gap(placed, spheres) > _ROOM:
            found.append(placed)
        if len(found) == count:
            return found
    return None


def _somewhere(rng: np.random.Generator, name: str, shape: str) -> dict[str, Any]:
    direction = rng.normal(size=3)
    away = rng.uniform(0.3, 1.0) * _REACH[name] * direction / np.linalg.norm(direction)
    words: dict[str, Any] = {"position": (away + np.array([0.0, 0.0, _SHOULDER[name]])).tolist()}
    if shape == "sphere":
        return {**words, "radius": float(rng.uniform(0.05, 0.15))}
    quaternion = rng.normal(size=4)
    turned = (quaternion / np.linalg.norm(quaternion)).tolist()
    return {**words, "size": rng.uniform(0.08, 0.3, 3).tolist(), "orientation": turned}


def _spheres(robot: Robot, q: Array) -> Array:
    """Centres and radii of the robot's spheres in the world, shape (n, 4) [m]; of the base, too."""
    data, found = robot.model.createData(), []
    pin.framesForwardKinematics(robot.model, data, q)
    for link in robot.collision_spheres:
        at = data.oMf[link.frame]
        found.append(np.column_stack([link.centers @ at.rotation.T + at.translation, link.radii]))
    return np.vstack(found)


def _gap(placed: Mapping[str, Any], spheres: Array) -> float:
    """Least distance of an obstacle from spheres [m]; not above 0 where they meet."""
    away = spheres[:, :3] - np.array(placed["position"])
    if placed["shape"] == "sphere":
        return float((np.linalg.norm(away, axis=1) - placed["radius"] - spheres[:, 3]).min())
    local = away @ pin.Quaternion(np.array(placed["orientation"])).matrix()
    beyond = np.maximum(np.abs(local) - np.array(placed["size"]) / 2.0, 0.0)
    return float((np.linalg.norm(beyond, axis=1) - spheres[:, 3]).min())


def _read(path: Path) -> list[dict[str, Any]]:
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [json.loads(line) for line in lines]


def main(arguments: Sequence[str] | None = None) -> None:
    """Solve what is missing, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scenes", description=__doc__)
    parser.add_argument("--scenes", type=int, default=250, help="of each robot")
    parser.add_argument("--robot", choices=tuple(ROBOTS), action="append")
    parser.add_argument("--starts", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=Path("scenes"), help="of the lines that are done")
    options = parser.parse_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    show(header())
    records = {}
    for name in options.robot or ROBOTS:
        path = options.folder / f"{name}_{options.seed}_{options.starts}.jsonl"
        done = {one["number"] for one in _read(path)}
        for number in sorted(set(range(options.scenes)) - done):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                record = record_of(scene(name, number, options.seed), number, options.starts)
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(record) + "\n")
        records[name] = [one for one in _read(path) if one["number"] < options.scenes]
    show(scene_table(records))


if __name__ == "__main__":
    main()
