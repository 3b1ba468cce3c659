"""Panda among obstacles, MotionBenchMaker's problems: `python -m benchmarks.motion_bench_maker`.

They are in the source archive of the package `vamp-planner`, which pip downloads into a folder. Each is
solved in minimum time within limits of torque, velocity and jerk, and the motion is checked at a thousand
poses a second. Times of motions are compared with those of a path of lines that TOPP-RA times within limits
of torque and velocity, at rest in its corners, and with those of a cubic spline through the corners, which
need not rest there, and may touch something: VAMP's path where that package can be imported, otherwise that
of `mbocp.guesses.around`. With `--guess vamp` each solve begins with VAMP's path.

Results are lines of JSON, so that a run can be stopped and taken up again.

References
----------
Chamzas et al., "MotionBenchMaker: a tool to generate and benchmark motion planning datasets", 2022.
Thomason, Kingston, Kavraki, "Motions in microseconds via vectorized sampling-based planning", 2024.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import multiprocessing
import subprocess
import sys
import tarfile
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

import mbocp
from benchmarks.machine import header
from benchmarks.straight_path import fastest_on_line, fastest_on_spline, has_toppra
from benchmarks.tables import Table, show
from mbocp._arrays import Array
from mbocp.guesses.around import around
from mbocp.problem import Problem
from mbocp.robot import Robot

__all__ = ["Line", "Task", "archive", "names", "problem_of", "scene_of", "table_of"]

_NAME, _VERSION = "vamp-planner", "0.6.4"
_JOINTS = tuple(f"panda_joint{k}" for k in range(1, 8))
_JERK = (750.0, 375.0, 500.0, 625.0, 750.0, 1000.0, 1000.0)  # [rad/s^3], a tenth of the maker's
_FOLDER = Path.home() / ".cache" / "mbocp-benchmarks"
_STEPS, _FINER = 50, 2  # and times as many where something touches between nodes
_EFFORT = 1e-5  # 1/(N m)^2 s
_SAME = 1e-4  # relative: durations that the steps do not tell apart
_LIMIT = 600.0  # [s] of a problem, what is compiled for the first of them included
_GRID = 200  # intervals of TOPP-RA on a line
_CORNER = 1e-3  # [rad] from a line: what is no corner

Scene = tuple[list[dict[str, Any]], Array, Array]  # obstacles, start and goal


def archive() -> Path:
    """Folder of the unpacked archive, downloaded the first time by pip."""
    folder = _FOLDER
    found = folder / f"{_NAME.replace('-', '_')}-{_VERSION}" / "resources" / "panda"
    if not (found / "problems").is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-m", "pip", "download", "--no-binary", _NAME, "--no-deps", "--dest"]
        subprocess.run([*command, str(folder), f"{_NAME}=={_VERSION}"], check=True)
        with tarfile.open(next(folder.glob("vamp*.tar.gz"))) as packed:
            packed.extractall(folder, filter="data")
        with tarfile.open(found / "problems.tar.bz2") as packed:
            packed.extractall(found, filter="data")
    return found


def names(each: int | None = None, every: int = 1) -> Iterator[tuple[str, int]]:
    """Scenes and numbers of problems: of every scene in turn the first `each`, or of these every so many."""
    scenes = sorted(path.name for path in (archive() / "problems").iterdir())
    for number in range(every, 1 + (each or 100), every):
        yield from ((scene, number) for scene in scenes)


@cache
def _robot() -> Robot:
    return mbocp.load_robot(archive() / "panda_spherized.urdf", mimic=False, damping=False)


def scene_of(scene: str, number: int) -> Scene:
    """Obstacles as in a problem file, start and goal [rad]."""
    folder = archive() / "problems" / scene
    request = yaml.safe_load((folder / f"request{number:04d}.yaml").read_text())
    obstacles = [{"shape": "scene", "file": str(folder / f"scene{number:04d}.yaml")}]
    state = request["start_state"]["joint_state"]
    start = dict(zip(state["name"], state["position"], strict=True))
    asked = request["goal_constraints"][0]["joint_constraints"]
    goal = {joint["joint_name"]: joint["position"] for joint in asked}
    q0, q1 = (np.array([place[joint] for joint in _JOINTS], dtype=float) for place in (start, goal))
    return obstacles, q0, q1


def problem_of(scene: str, number: int, starts: int = 1, steps: int = _STEPS) -> Problem:
    """Minimum time from rest to rest."""
    return _problem(scene_of(scene, number), starts, steps)


def _problem(scene: Scene, starts: int, steps: int, threads: int = 1) -> Problem:
    robot, (obstacles, q0, q1) = _robot(), scene
    alone = float(np.max(np.abs(q1 - q0) / robot.limits.velocity))
    return Problem.create(
        robot,
        {"min": 0.5 * alone, "max": 8.0 * alone + 4.0},
        steps,
        start={"q": q0},
        goal={"q": q1, "v": np.zeros(robot.nv), "a": "free"},
        cost={"time": 1.0, "effort": _EFFORT},
        limits={"effort": True, "velocity": True, "position": True, "jerk": list(_JERK)},
        obstacle=obstacles,
        self_collision=True,
        integrator={"scheme": "midpoint"},
        solver={"method": "monolithic", "starts": starts, "time_limit": _LIMIT, "threads": threads},
    )


@dataclass(frozen=True)
class Task:
    """One problem, how many starts, steps and threads it may have, and where it begins, see `Line`."""

    scene: str
    number: int
    starts: int = 1
    steps: int = _STEPS
    guess: str = "auto"
    threads: int = 1

    @property
    def key(self) -> tuple[str, int, int, str, int]:
        """What tells it from others, as in a line."""
        return self.scene, self.number, self.starts, self.guess, self.threads

    def problem(self, scene: Scene, starts: int = 1, finer: int = 1) -> Problem:
        """From so many starts, with so many times the steps."""
        return _guessed(_problem(scene, starts, finer * self.steps, self.threads), self.guess)


@dataclass(frozen=True)
class Line:
    """What one problem came to.

    Attributes
    ----------
    guess : {"auto", "vamp"}
        Where the first solve began.
    threads : int
        Of the process that solved it.
    status : str
        Of the solution; "refused" where start or goal touch something.
    duration, timed, smooth : float
        Of the motion, and of the path and of its spline that TOPP-RA timed [s]; NaN where there is none.
    clearance : float
        Smallest at a thousand poses a second [m].
    seconds, cpu : float
        Of `Problem.create` and `mbocp.solve`, by the clock and by the processor [s].
    """

    scene: str
    number: int
    starts: int
    guess: str
    threads: int
    status: str
    duration: float = np.nan
    timed: float = np.nan
    smooth: float = np.nan
    clearance: float = np.nan
    iterations: int = 0
    seconds: float = np.nan
    cpu: float = np.nan
    words: str = ""

    @property
    def key(self) -> tuple[str, int, int, str, int]:
        """Of the task, see `Task.key`."""
        return self.scene, self.number, self.starts, self.guess, self.threads

    @property
    def is_clear(self) -> bool:
        """Whether it is solved, and touches nothing."""
        return self.status == "converged" and self.clearance >= 0.0


def measure(task: Task) -> Line:
    """Solve one problem from one start; with more steps, and from all starts, where that comes to nothing."""
    read, _ = scene_of(task.scene, task.number), _robot()
    begun, processor = time.perf_counter(), time.process_time()
    try:
        problem = task.problem(read)
    except mbocp.MbocpError as error:
        return Line(*task.key, "refused", words=str(error))
    solution = mbocp.solve(problem)
    if solution.status == "under_resolved":  # what touches between nodes takes more steps, as it is told
        solution = mbocp.solve(task.problem(read, finer=_FINER))
    if task.starts > 1 and not _is_clear(solution):
        solution = mbocp.solve(task.problem(read, task.starts))
    seconds, cpu = time.perf_counter() - begun, time.process_time() - processor
    return Line(
        *task.key,
        str(solution.status),
        solution.duration,
        *_timed(problem),
        solution.clearance,
        solution.iterations,
        seconds,
        cpu,
        solution.advice,
    )


def _is_clear(solution: mbocp.Solution) -> bool:
    return solution.converged and solution.clearance >= 0.0


def _guessed(problem: Problem, guess: str) -> Problem:
    """The problem with VAMP's path as its guess, where that is asked for and there is one."""
    path = _vamp_path(problem) if guess == "vamp" else None
    return problem if path is None or len(path) < 3 else problem.with_(guess={"kind": "way", "q": path[1:-1]})


def _timed(problem: Problem) -> tuple[float, float]:
    """Durations of a path of lines, at rest in the corners, and of its spline, both timed by TOPP-RA [s]."""
    corners = _path(problem)
    if corners is None or not has_toppra():
        return float("nan"), float("nan")
    robot = problem.robot
    lines = sum(fastest_on_line(robot, a, b, None, grid=_GRID).duration for a, b in pairwise(corners))
    return lines, fastest_on_spline(robot, np.array(corners), None, grid=_GRID).duration


def _path(problem: Problem) -> list[Array] | None:
    q0, q1 = np.asarray(problem.q_start), np.asarray(problem.goal.q)
    if importlib.util.find_spec("vamp") is not None:
        return _vamp_path(problem)
    way = around(problem)
    return [q0, q1] if way is None else _corners(way(q0, np.linspace(0.0, 1.0, 60)))


def _vamp_path(problem: Problem) -> list[Array] | None:
    import vamp

    scene = vamp.Environment()
    for thing in problem.obstacle:
        turn, sizes = pin.rpy.matrixToRpy(thing.placement.rotation), np.asarray(thing.sizes)
        at = np.asarray(thing.position)
        if thing.shape == "box":
            scene.add_cuboid(vamp.Cuboid(at, turn, sizes / 2.0))
        elif thing.shape == "cylinder":
            scene.add_capsule(vamp.Cylinder(at, turn, sizes[0], sizes[1]))
        else:
            scene.add_sphere(vamp.Sphere(at, sizes[0]))
    panda, plan, settings, simplify = vamp.configure_robot_and_planner_with_kwargs("panda", "rrtc")
    found = plan(np.asarray(problem.q_start), np.asarray(problem.goal.q), scene, settings, panda.halton())
    if not found.solved:
        return None
    path = panda.simplify(found.path, scene, simplify, panda.halton()).path
    return [np.array(q, dtype=float) for q in path.numpy()]


def _corners(places: Array) -> list[Array]:
    """Few places whose lines stay near all of them (Ramer, Douglas, Peucker)."""
    along = np.linspace(0.0, 1.0, len(places))[:, None]
    away = np.linalg.norm(places - (places[0] + along * (places[-1] - places[0])), axis=1)
    far = int(away.argmax())
    if away[far] < _CORNER or len(places) < 3:
        return [places[0], places[-1]]
    return [*_corners(places[: far + 1])[:-1], *_corners(places[far:])]


def run(tasks: Sequence[Task], results: Path, processes: int) -> list[Line]:
    """Lines of all tasks: those of the file, and those that are missing there, which are added to it."""
    known = (
        [Line(**json.loads(text)) for text in results.read_text().splitlines()] if results.exists() else []
    )
    done = {line.key for line in known}
    left = [task for task in tasks if task.key not in done]
    with multiprocessing.get_context("spawn").Pool(processes) as pool, results.open("a") as file:
        for line in pool.imap_unordered(measure, left) if processes > 1 else map(measure, left):
            known.append(line)
            file.write(json.dumps(asdict(line)) + "\n")
            file.flush()
            told = (
                line.scene,
                line.number,
                line.status,
                f"{line.duration:.3f} s",
                f"{line.cpu:.2f} s of CPU",
            )
            print(*told, sep=" | ", flush=True)
    wanted = {task.key for task in tasks}
    return [line for line in known if line.key in wanted]


def table_of(lines: Sequence[Line]) -> Table:
    """Success, times, and durations beside those of the timed paths, by scene and in all."""
    rows = []
    for scene in (*sorted({line.scene for line in lines}), "all"):
        mine = [line for line in lines if scene in (line.scene, "all") and line.status != "refused"]
        if mine:
            rows.append((scene, *_cells(mine)))
    columns = (
        "scene",
        "clear",
        "wall [ms]",
        "CPU [ms]",
        "within 2 s",
        "shorter by [%]",
        "longer",
        "than the spline",
        "longer",
    )
    refused = sum(line.status == "refused" for line in lines)
    path = (
        "VAMP's path" if importlib.util.find_spec("vamp") is not None else "the way of mbocp.guesses.around"
    )
    note = (
        f"Clear: converged and touching nothing at 1 kHz. Times: median / 98 %. Shorter than {path}, timed "
        f"by TOPP-RA without limits of jerk, at rest in corners, and than a spline through these, which may "
        f"touch something: mean / least. {refused} problems are left "
        "out: their start or goal touches something."
    )
    return Table("MotionBenchMaker, Panda, minimum time", columns, rows, note)


def _cells(lines: Sequence[Line]) -> tuple[str, ...]:
    clear = [line for line in lines if line.is_clear]
    spreads = []
    for times in ([line.seconds for line in lines], [line.cpu for line in lines]):
        spreads.append(" / ".join(f"{1e3 * t:.0f}" for t in np.percentile(times, [50, 98])))
    within = sum(line.seconds <= 2.0 for line in lines)
    return (
        f"{len(clear)} of {len(lines)}",
        *spreads,
        f"{within} of {len(lines)}",
        *_gains([line.duration / line.timed for line in clear]),
        *_gains([line.duration / line.smooth for line in clear]),
    )


def _gains(ratios: list[float]) -> tuple[str, str]:
    """Mean and least gain in percent, and how many are none."""
    gains = 100.0 * (1.0 - np.array(ratios))
    gains = gains[np.isfinite(gains)]
    told = f"{gains.mean():.1f} / {gains.min():.1f}" if len(gains) else ""
    return told, f"{np.count_nonzero(gains < -100.0 * _SAME)} of {len(gains)}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Solve, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.motion_bench_maker", description=__doc__)
    parser.add_argument("--each", type=int, help="problems of each of the seven scenes; all 100 by default")
    parser.add_argument("--every", type=int, default=1, help="so many: 10 are numbers 10, 20, ..., 100")
    parser.add_argument("--starts", type=int, default=1, help="where one alone comes to nothing")
    parser.add_argument(
        "--guess", choices=("auto", "vamp"), default="auto", help="where the first solve begins"
    )
    parser.add_argument("--steps", type=int, default=_STEPS)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--threads", type=int, default=1, help="of each process")
    parser.add_argument("--results", type=Path, default=Path("motion_bench_maker.jsonl"))
    options = parser.parse_args(arguments)
    how = (options.starts, options.steps, options.guess, options.threads)
    tasks = [Task(*name, *how) for name in names(options.each, options.every)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        lines = run(tasks, options.results, options.processes)
    for table in (header(), table_of(lines)):
        show(table)


if __name__ == "__main__":
    main()
