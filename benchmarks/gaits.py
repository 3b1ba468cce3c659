"""Gaits at random speeds and headings, from the default guess: `python -m benchmarks.gaits`.

Four swings of 0.2 s and a stand, on a level ground with friction 0.7, from rest to rest, at
up to 0.4 m/s in any direction, turned by up to half a radian, within limits of efforts and positions. Two
hops, with stands of 0.2 s between. Cost of transport: the positive work of the motors, by weight and way.

`--cycles`: gaits that go on and on, of robots with four legs, at 0.3 m/s.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.machine import header
from benchmarks.tables import Table, show
from mbocp import Solution
from mbocp.problem import Problem
from mbocp.robot import load_robot
from tests.checker.system import read_system
from tests.checker.walking import Stance, Steps, check_walk

__all__ = ["GAITS", "gait", "gait_table", "judged", "record_of"]

_SECONDS, _STEPS, _FASTEST, _TURN = 0.2, 12, 0.4, 0.5  # [s], 1, [m/s], [rad]
_NUM_SWINGS, _FRICTION = 4, 0.7
_FAR = 0.15  # [m] of motions whose work is compared
_LIMITS = {"solo12": 2.7}  # [N m]; those of the other robots are in their files
_IN_FLIGHT = 10.0  # times the weight of velocities, for hops: with less, legs spin in the air
FEET = ["FL", "FR", "HL", "HR"]
GAITS = {"bound": 2, "pace": 2, "trot": 2, "walk": 1, "hop": 2}  # and how many cycles
SWINGS = {"trot": 2, "pace": 2, "walk": 4, "bound": 2, "hop": 1}  # of a cycle
_OF_UNITREE = {name: f"{name}_foot" for name in ("FL", "FR", "RL", "RR")}
ROBOTS: Mapping[str, tuple[Mapping[str, str], float]] = {  # feet, and the weight of the velocities
    "solo12": ({name: f"{name}_FOOT" for name in FEET}, 0.01),
    "anymal_c": ({name: f"{name}_FOOT" for name in ("LF", "RF", "LH", "RH")}, 1.0),
    "hyq": ({name: f"{name}_foot" for name in ("lf", "rf", "lh", "rh")}, 1.0),
    **dict.fromkeys(("go1", "go2", "a1", "b1"), (_OF_UNITREE, 1.0)),
}


def gait(name: str, number: int, robot_name: str = "solo12", scheme: str = "auto") -> Problem:
    """One motion; it depends on nothing but the gait, its number and the robot."""
    rng = np.random.default_rng([number, [*GAITS].index(name)])
    speed, heading, turn = rng.uniform([0.0, -np.pi, -_TURN], [_FASTEST, np.pi, _TURN])
    robot, (feet, weight) = load_robot(robot_name), ROBOTS[robot_name]
    way, is_hop, goal = speed * _SECONDS * _NUM_SWINGS, name == "hop", np.array(robot.q0)
    goal[:2] += way * np.cos(heading), way * np.sin(heading)
    goal[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, turn)).coeffs()
    stance = {"stance": _SECONDS} if is_hop else {}
    return Problem.create(
        robot,
        gait={"swings": name, "cycles": GAITS[name], "duration": _SECONDS, "steps": _STEPS, **stance},
        ground={"feet": feet, "friction": _FRICTION},
        goal={"v": 0, "q": goal},
        cost={"effort": 1.0, "velocity": weight * (_IN_FLIGHT if is_hop else 1.0)},
        limits={"effort": _LIMITS.get(robot_name, True), "position": True},
        scheme=scheme,
    )


def record_of(name: str, number: int, robot_name: str = "solo12", scheme: str = "auto") -> dict[str, Any]:
    """What came of a motion."""
    problem = gait(name, number, robot_name, scheme)
    begun = time.process_time()
    solution = mbocp.solve(problem, time_limit=120.0)
    seconds = time.process_time() - begun
    weight = pin.computeTotalMass(problem.robot.model) * np.linalg.norm(problem.robot.model.gravity.linear)
    way = np.linalg.norm(solution.qs[-1, :2] - solution.qs[0, :2])
    found = {"status": str(solution.status), "iterations": solution.iterations, "seconds": seconds}
    transport = solution.positive_work / (weight * way)
    return {**found, "transport": transport, "way": way, "judged": judged(problem, solution)}


def judged(problem: Problem, solution: Solution) -> dict[str, float]:
    """What the tests' checker finds, see `tests.checker.walking.check_walk`."""
    assert problem.robot.source is not None
    places = zip(problem.phase, solution.named_phases, strict=True)
    stances = [
        Stance(place.first, place.last, tuple(held.hold.frame for held in phase.holds))
        for phase, place in places
    ]
    steps = Steps(solution.t, solution.qs, solution.vs, solution.us)
    system = read_system(problem.robot.source, free_flyer=True)
    return check_walk(system, stances, steps, _FRICTION, problem.scheme)


def gait_table(robot_name: str, records: Mapping[str, Sequence[Mapping[str, Any]]]) -> Table:
    """Success, iterations, time and cost of transport, a line for each gait."""
    rows = []
    for name, found in records.items():
        good = [one for one in found if one["status"] == "converged"]
        iterations, seconds = ([one[key] for one in good] for key in ("iterations", "seconds"))
        rows.append(
            (
                name,
                str(len(found)),
                str(len(good)),
                ", ".join(f"{x:.0f}" for x in np.quantile(iterations, [0.5, 0.9])),
                ", ".join(f"{x:.2f} s" for x in np.quantile(seconds, [0.5, 0.9])),
                f"{np.median([one['transport'] for one in good if one['way'] > _FAR] or [np.nan]):.2f}",
            )
        )
    columns = (
        "",
        "motions",
        "converged",
        "iterations: median, 90 %",
        "time: median, 90 %",
        "transport",
    )
    note = (
        "Of those that converged; seconds of a processor, those of building functions in the first. "
        f"Transport: the median of motions of more than {_FAR:g} m."
    )
    return Table(f"Gaits of {robot_name}", columns, rows, note)


def judged_table(robot_name: str, records: Mapping[str, Sequence[Mapping[str, Any]]]) -> Table:
    """The worst that the checker finds, a line for each gait."""
    rows, columns = [], list[str]()
    for name, found in records.items():
        good = [one["judged"] for one in found if one["status"] == "converged"]
        columns = sorted({key for one in good for key in one}) or columns
        rows.append((name, *(f"{max(one.get(key, 0.0) for one in good):.0e}" for key in columns)))
    return Table(f"{robot_name}, by `tests/checker/walking.py`", ("", *columns), rows)


def cycle(name: str, word: str) -> Problem:
    """A cycle of a gait at 0.3 m/s, swings of 0.3 s; between hops all feet stand as long."""
    (feet, weight), robot = ROBOTS[name], load_robot(name)
    weight *= _IN_FLIGHT if word == "hop" else 1.0
    swing, stance, base = 0.3, 0.3 if word == "hop" else 0.0, robot.joint_names[0]
    gait = {"swings": word, "duration": swing, "steps": _STEPS, **({"stance": stance} if stance else {})}
    still = [f"{base}.vx", f"{base}.vy", f"{base}.wz"]
    way = 0.3 * SWINGS[word] * (swing + stance)
    return Problem.create(
        robot,
        gait=gait,
        ground={"feet": feet, "friction": _FRICTION, "lift": 0.04},
        start={"free": {"v": True, "q": {"except": still}}},
        goal={"periodic": {"moved": {base: {"x": way}}}},
        cost={"effort": 1.0, "velocity": weight},
        limits={"effort": True, "position": True},
        scheme="se1",
    )


def cycles_table(names: Sequence[str]) -> Table:
    """Iterations and time of a cycle of each gait, a line for each robot."""
    rows = []
    for name in names:
        words = []
        for word in SWINGS:
            problem = cycle(name, word)
            begun = time.perf_counter()
            solution = mbocp.solve(problem, time_limit=60.0)
            seconds = time.perf_counter() - begun
            told = "" if solution.converged else f" {solution.status}"
            words.append(f"{solution.iterations}, {seconds:.1f} s{told}")
        rows.append((name, *words))
    note = (
        "Iterations and time from the default guess, with what it takes to build functions of a new problem."
    )
    return Table("Cycles of gaits at 0.3 m/s", ("", *SWINGS), rows, note)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gaits", description=__doc__)
    parser.add_argument("--count", type=int, default=50, help="of each gait")
    parser.add_argument("--markdown", action="store_true")
    parser.add_argument("--robot", choices=[*ROBOTS], default="solo12")
    parser.add_argument("--scheme", default="auto")
    parser.add_argument("--gaits", nargs="+", choices=[*GAITS], default=[*GAITS])
    parser.add_argument("--cycles", nargs="*", choices=[*ROBOTS], metavar="ROBOT", help="of these, or of all")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    if options.cycles is not None:
        for table in (header(), cycles_table(options.cycles or [*ROBOTS])):
            show(table, markdown=options.markdown)
        return
    records = {
        name: [record_of(name, k, options.robot, options.scheme) for k in range(options.count)]
        for name in options.gaits
    }
    for table in (header(), gait_table(options.robot, records), judged_table(options.robot, records)):
        show(table, markdown=options.markdown)


if __name__ == "__main__":
    main()
