"""Random scenes: `python -m benchmarks.scenes`.

UR5 and Panda go from rest to rest between three and ten spheres and boxes, and keep away from themselves.
Start and goal are clear; whether there is a way between them nobody knows. With `--arm` others go in
the least time within their torques, velocities and jerks into, out of and around shelves, cages, boxes and
posts, their tools deep inside. Every motion is looked at at a thousand poses a second, by coal on the meshes
of the links.

Scenes that are done stand in a file, a line of JSON each; the same command goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.machine import header
from benchmarks.surfaces import SURFACES, surfaces_of
from benchmarks.tables import Table, show
from benchmarks.touching import Touching
from mbocp._arrays import Array
from mbocp.guesses.around import has_no_way
from mbocp.problem import Problem
from mbocp.robot import Robot

__all__ = ["ARMS", "ROBOTS", "narrow_scene", "record_of", "scene", "scene_table"]

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

ARMS: Mapping[str, tuple[str, tuple[float, float, float]]] = {  # frame of the tool, and what points out of it
    "ur5_gripper": ("tool0", (0.0, 0.0, 1.0)),
    "xarm7": ("link_eef", (0.0, 0.0, 1.0)),
    "kinova": ("j2s6s200_link_6", (0.0, 0.0, -1.0)),
}
_ARM_REACH = {"ur5_gripper": 0.85, "xarm7": 0.75, "kinova": 0.85}  # [m]
_FASTEST_STEPS = 50
_JERK = 500.0  # [rad/s^3]
_THICK = 0.02  # [m] boards and bars
_BRANCHES, _RESTARTS = 8, 12  # configurations of a place, and tries to find them

_AHEAD = np.array([1.0, 0.0, 0.0])

Place: TypeAlias = tuple[Array, Array]  # where a tool is, and where it points


def scene(
    name: str, number: int, seed: int = 0, surfaces: str | None = None, folder: Path | None = None
) -> Problem:
    """One problem; it depends on robot, number and seed; files in a folder may stand for its obstacles."""
    rng = np.random.default_rng([seed, sorted(ROBOTS).index(name), number])
    robot = _robot(name)
    while True:
        q0, q1 = _pose(rng, robot), _pose(rng, robot)
        obstacles = _obstacles(rng, name, np.vstack([_spheres(robot, q) for q in (q0, q1)]))
        if obstacles is None:
            continue
        if surfaces is not None and folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            obstacles = SURFACES[surfaces](obstacles, rng, folder)
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
        except mbocp.exceptions.ProblemError as error:  # a pose in which the robot touches itself, or a cube
            if "self_collision" not in str(error) and surfaces != "cloud":
                raise


def narrow_scene(name: str, number: int, seed: int = 0) -> Problem:
    """One problem of least time of an arm; its kind of scene is that of the number."""
    rng = np.random.default_rng([seed, list(ARMS).index(name), number, 1])
    robot, kind = _robot(name), list(_KINDS)[number % len(_KINDS)]
    while True:
        obstacles, places = _narrow(kind, _ARM_REACH[name], rng)
        ends = [_end(robot, name, place, obstacles, rng) for place in places]
        if any(end is None for end in ends):
            continue
        q0, q1 = (np.asarray(end) for end in ends)
        alone = float(np.max(np.abs(robot.difference(q0, q1)) / robot.limits.velocity))
        try:
            return Problem.create(
                robot,
                {"min": 0.5 * alone, "max": 8.0 * alone + 4.0},
                _FASTEST_STEPS,
                start={"q": q0},
                goal={"q": q1, "v": np.zeros(robot.nv), "a": "free"},
                cost={"time": 1.0, "effort": 1e-5},
                limits={"effort": True, "velocity": True, "position": True, "jerk": _JERK},
                obstacle=obstacles,
                self_collision=True,
                integrator={"scheme": "midpoint"},
            )
        except mbocp.exceptions.ProblemError as error:
            if "self_collision" not in str(error):
                raise


class _Scene:
    """Boxes about an arm, by where they are when the scene is ahead of it, and a turn about its axis."""

    def __init__(self, kind: str, rng: np.random.Generator) -> None:
        self.kind, self.rng, self.things = kind, rng, list[dict[str, Any]]()
        self.turn = pin.rpy.rpyToMatrix(0.0, 0.0, self.between(-np.pi, np.pi))

    def between(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def box(self, at: Sequence[float] | Array, size: Sequence[float]) -> None:
        turned = pin.Quaternion(self.turn).coeffs().tolist()
        words = {"position": (self.turn @ np.array(at)).tolist(), "size": list(size), "orientation": turned}
        self.things.append({"name": f"{self.kind} {len(self.things)}", "shape": "box", **words})


def _narrow(kind: str, reach: float, rng: np.random.Generator) -> tuple[list[dict[str, Any]], list[Place]]:
    """Obstacles, and the places of the tool at both ends, in any order."""
    scene = _Scene(kind, rng)
    far, wide = scene.between(0.6, 0.75) * reach, scene.between(0.4, 0.55)
    places = _KINDS[kind](scene, reach, far, wide)
    if scene.between(0.0, 1.0) < 0.5:
        places.reverse()
    return scene.things, [(scene.turn @ at, scene.turn @ pointing) for at, pointing in places]


def _shelf(scene: _Scene, reach: float, far: float, wide: float) -> list[Place]:
    """Six cells; the tool goes from one into another."""
    high, deep = scene.between(0.34, 0.42), 0.3
    for level in range(4):
        scene.box((far + deep / 2, 0.0, (level - 1) * high), (deep, 2 * wide, _THICK))
    for side in (-wide, scene.between(-0.1, 0.1), wide):
        scene.box((far + deep / 2, side, 0.5 * high), (deep, _THICK, 3 * high))
    scene.box((far + deep, 0.0, 0.5 * high), (_THICK, 2 * wide, 3 * high))
    return [
        (
            np.array([far + scene.between(0.0, 0.08), (cell % 2 - 0.5) * wide, (cell // 2 - 0.5) * high]),
            _AHEAD,
        )
        for cell in scene.rng.choice(6, 2, replace=False)
    ]


def _cage(scene: _Scene, reach: float, far: float, wide: float) -> list[Place]:
    """Bars about a cube, one side of it open; the tool goes from beside it into it."""
    half, low = scene.between(0.2, 0.26), scene.between(0.05, 0.25)
    middle = np.array([far, 0.0, low + half])
    upright = (_THICK, _THICK, 2 * half)
    for a, b in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        scene.box(middle + half * np.array([a, b, 0]), upright)
        scene.box(middle + half * np.array([a, 0, b]), (_THICK, 2 * half, _THICK))
        scene.box(middle + half * np.array([0, a, b]), (2 * half, _THICK, _THICK))
    for bar in ((1, -0.5, 0), (1, 0, 0), (1, 0.5, 0), (0, 1, 0), (0, -1, 0)):
        scene.box(middle + half * np.array(bar), upright)
    side = 1.0 if scene.between(0.0, 1.0) < 0.5 else -1.0
    beside = np.array([-0.05, side * (half + scene.between(0.15, 0.25)), scene.between(-0.1, 0.2)])
    return [(middle + beside, _AHEAD), (middle - np.array([scene.between(0.0, 0.1), 0.0, 0.0]), _AHEAD)]


def _box(scene: _Scene, reach: float, far: float, wide: float) -> list[Place]:
    """Two open boxes side by side; the tool goes from one into the other."""
    half, high = scene.between(0.17, 0.22), scene.between(0.2, 0.3)
    for side in (-1, 1):
        across = side * (half + scene.between(0.05, 0.15))
        scene.box((far, across, 0.0), (2 * half, 2 * half, _THICK))
        for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            size = (2 * half if b else _THICK, 2 * half if a else _THICK, high)
            scene.box((far + a * half, across + b * half, high / 2), size)
    return [
        (np.array([far, side * (half + 0.1), scene.between(0.12, high)]), np.array([0.0, 0.0, -1.0]))
        for side in (-1.0, 1.0)
    ]


def _posts(scene: _Scene, reach: float, far: float, wide: float) -> list[Place]:
    """A table with posts; the tool goes from one gap between them into another."""
    scene.box((0.0, 0.0, -0.15), (3.0, 3.0, _THICK))
    for k in range(5):
        angle, away = np.deg2rad(-60 + 30 * k) + scene.between(-0.1, 0.1), scene.between(0.5, 0.7) * reach
        at = (away * np.cos(angle), away * np.sin(angle), 0.3)
        scene.box(at, (0.05, 0.05, scene.between(0.5, 0.9)))
    angles = np.deg2rad(scene.rng.choice([-75.0, -45.0, -15.0, 15.0, 45.0, 75.0], 2, replace=False))
    places = []
    for angle, away in zip(angles, scene.rng.uniform(0.65, 0.8, 2) * reach, strict=True):
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        places.append((away * out + np.array([0.0, 0.0, scene.between(0.1, 0.4)]), out))
    return places


_KINDS: Mapping[str, Callable[[_Scene, float, float, float], list[Place]]] = {
    "shelf": _shelf,
    "cage": _cage,
    "box": _box,
    "posts": _posts,
}


def _end(
    robot: Robot, name: str, place: Place, obstacles: list[dict[str, Any]], rng: np.random.Generator
) -> Array | None:
    """A clear configuration with the tool in a place; None where none is found."""
    frame, axis = ARMS[name]
    target = {"name": frame, "position": place[0], "axis": axis, "direction": place[1]}
    found = robot.inverse_kinematics(
        target, branches=_BRANCHES, restarts=_RESTARTS, seed=int(rng.integers(1 << 30))
    )
    for q in rng.permutation(found.branches) if found.reached else ():
        spheres = _spheres(robot, q)
        if min(_gap(placed, spheres) for placed in obstacles) > _ROOM:
            return np.asarray(q)
    return None


def record_of(
    problem: Problem,
    number: int,
    starts: int,
    limit: float | None = None,
    surfaces: Sequence[pin.GeometryObject] | None = None,
) -> dict[str, Any]:
    """What came of a scene, in so many seconds at most."""
    problem = problem.with_(solver={"method": "auto", "starts": starts})
    used, clock = time.process_time(), time.perf_counter()
    try:
        solution = mbocp.solve(problem, time_limit=limit)
    except mbocp.exceptions.CompilationTimeout:  # the first of its kind is compiled without a limit
        mbocp.solve(problem)
        used, clock = time.process_time(), time.perf_counter()
        solution = mbocp.solve(problem, time_limit=limit)
    seconds, used = time.perf_counter() - clock, time.process_time() - used
    compiled = sum(phase.wall_time_s for phase in solution.phases if phase.name == "compile")
    touching = Touching.of(problem, surfaces)
    ends = [problem.robot.model, np.array(problem.q_start), np.array(problem.goal.q)]
    line = np.array([pin.interpolate(*ends, share) for share in np.linspace(0.0, 1.0, len(solution.t))])
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
        "touches": touching.first(solution.t, solution.qs, None if problem.scheme == "se1" else solution.vs),
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
                f"{100.0 * sum(one['seconds'] < 1.0 for one in done) / len(found):.1f} %",
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
        "within 1 s",
        "median",
        "95 %",
    )
    note = (
        f"{' and '.join(ROBOTS)}: {_DURATION:g} s in {_STEPS} steps, {_FEWEST} to {_MOST} spheres and boxes, "
        f"and the robot itself. Others: least time in {_FASTEST_STEPS} steps, {', '.join(_KINDS)} in turn. "
        '"with a way": of scenes whose line touches nothing, or where a search has found a way. '
        '"touch": coal finds a link in contact at one of 1000 poses a second.'
    )
    return Table("Random scenes", columns, rows, note)


@cache
def _robot(name: str) -> Robot:
    return mbocp.load_robot(name, lock=dict(ROBOTS.get(name, {})))


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


def _record(options: argparse.Namespace, name: str, number: int) -> dict[str, Any]:
    if name in ARMS:
        return record_of(narrow_scene(name, number, options.seed), number, options.starts, options.limit)
    files = options.folder / f"{name}_{options.seed}_{number}"
    problem = scene(name, number, options.seed, options.surfaces, files)
    surfaces = None if options.surfaces is None else surfaces_of(problem.document.tables["obstacle"])
    return record_of(problem, number, options.starts, options.limit, surfaces)


def main(arguments: Sequence[str] | None = None) -> None:
    """Solve what is missing, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scenes", description=__doc__)
    parser.add_argument("--count", type=int, default=250, help="scenes of each arm")
    parser.add_argument("--arm", choices=(*ROBOTS, *ARMS), action="append")
    parser.add_argument("--surfaces", choices=SURFACES, help="files in place of spheres and boxes")
    parser.add_argument("--first", type=int, default=0, help="number")
    parser.add_argument("--starts", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--limit", type=float, help="of each solve by the clock [s]; without, iterations end it"
    )
    parser.add_argument("--folder", type=Path, default=Path("scenes"), help="of the lines that are done")
    options = parser.parse_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    show(header())
    records = {}
    for name in options.arm or ROBOTS:
        kind = "" if options.surfaces is None else f"_{options.surfaces}"
        path = options.folder / f"{name}{kind}_{options.seed}_{options.starts}.jsonl"
        done = {one["number"] for one in _read(path)}
        numbers = range(options.first, options.first + options.count)
        for number in sorted(set(numbers) - done):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                record = _record(options, name, number)
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(record) + "\n")
        records[name] = [one for one in _read(path) if one["number"] in numbers]
    show(scene_table(records))


if __name__ == "__main__":
    main()
