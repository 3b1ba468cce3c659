"""Iterations of `monolithic` beside IPOPT's, on random tasks: `python -m benchmarks.iterations`.

Same programme, guess (the line) and tolerance. Arms, chains and a drone go from rest to rest; half of the
arms' poses are far apart. Two arms carry a box (`examples/worlds/two_arms_one_load.toml`) to random places.
Limits of torques are shares of the largest torques of the motion without them, but room to hold both ends.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.newton import EXAMPLES
from benchmarks.random_tasks import rest_to_rest
from benchmarks.tables import Table, show
from mbocp import Problem, Robot
from mbocp.exceptions import UnreachablePose
from mbocp.formulation import formulate
from mbocp.guesses import make_guess
from mbocp.solvers import SolverSettings, Start, run_strategy

__all__ = ["ROBOTS", "Count", "iteration_counts", "random_task"]

ROBOTS = ("ur5", "panda", "drone", "baxter", "chain_12", "chain_16", "two_arms_one_load")
_METHODS = ("monolithic", "ipopt")
_FINGERS = {"panda_finger_joint1": 0.0, "panda_finger_joint2": 0.0}
_MOST = 500
_HIGHER = 1e-2  # relative: costs farther apart are those of different minima
_COLUMNS = (
    "robot",
    "method",
    "solved",
    "median",
    "90th percentile",
    "mean",
    "more than the other",
    "cost higher",
)
Rng = np.random.Generator


@dataclass(frozen=True)
class Count:
    """What one method came to on one task."""

    iterations: int
    cost: float
    converged: bool


@cache
def _robot(name: str) -> Robot:
    if name == "drone":
        return mbocp.load_robot("hector", actuated=["root_joint"], damping=False)
    return mbocp.load_robot(name, lock=_FINGERS if name == "panda" else {}, damping=False)


def random_task(name: str, seed: int, number: int) -> Problem:
    """Rest to rest; the i-th of a seed does not depend on how many there are."""
    rng = np.random.default_rng([seed, ROBOTS.index(name), number])
    if name == "two_arms_one_load":
        return _load(rng)
    robot = _robot(name)
    model = robot.model
    if name == "drone":
        q0 = pin.neutral(model)
        turn = rng.uniform(-1.0, 1.0, 3)
        turn *= rng.uniform(0.0, 2.5) / np.linalg.norm(turn)
        q1 = pin.integrate(model, q0, np.concatenate([rng.uniform(-1.5, 1.5, 3), turn]))
    else:
        q0 = _pose(rng, robot)
        q1 = _pose(rng, robot)
        q1 = q1 if rng.random() < 0.5 else q0 + 0.4 * (q1 - q0)
    weight = float(rng.choice([0.0, 1.0, 10.0, 10.0])) if name != "drone" else float(rng.choice([1.0, 10.0]))
    duration, steps = float(rng.uniform(0.8, 2.5)), int(rng.integers(40, 121))
    return rest_to_rest(robot, duration, steps, q0, q1, weight)


def _load(rng: Rng) -> Problem:
    """A box that two arms hold, to a place and heading near that of the example."""
    problem = mbocp.load_problem(EXAMPLES / "worlds" / "two_arms_one_load.toml")
    duration, steps = float(rng.uniform(0.8, 2.5)), int(rng.integers(30, 81))
    weight = float(rng.choice([1.0, 10.0, 30.0]))
    asked = {"duration": duration, "num_steps": steps, "cost": {"velocity": weight}}
    while True:
        place = np.array([0.4, 0.0, 0.35]) + rng.uniform(-0.15, 0.15, 3)
        yaw = float(rng.uniform(-0.4, 0.4))
        box = {"name": "load/body", "position": place.tolist(), "rpy": [0.0, 0.0, yaw]}
        with suppress(UnreachablePose):  # then another one
            return problem.with_(goal={"frame": box}, integrator={"scheme": "se1"}, **asked)


def _pose(rng: Rng, robot: Robot) -> np.ndarray:
    """Joints between their limits, where they have some, at most two radians from the middle or from zero."""
    low, high = robot.model.lowerPositionLimit, robot.model.upperPositionLimit
    is_free = low >= high
    low = np.maximum(np.where(is_free, -np.pi, low), -np.pi)
    high = np.minimum(np.where(is_free, np.pi, high), np.pi)
    middle = np.where((low < 0.0) & (high > 0.0), 0.0, 0.5 * (low + high))
    return rng.uniform(np.maximum(low, middle - 2.0), np.minimum(high, middle + 2.0))


def limited(problem: Problem, us: np.ndarray, seed: int, number: int) -> Problem:
    """Within limits of torques that the motion with the controls `us` exceeds."""
    rng = np.random.default_rng([seed, number, 1])
    held = np.abs(us[[0, -1]]) if problem.robot.constraints else _holding(problem)
    room = 1.15 * held.max(axis=0) + 1e-3
    bound = np.maximum(rng.uniform(0.6, 0.9) * np.abs(us).max(axis=0), room)
    return problem.with_(limits={"effort": bound})


def _holding(problem: Problem) -> np.ndarray:
    """Torques that hold a tree still at both ends, shape (2, nu)."""
    model, data = problem.robot.model, problem.robot.model.createData()
    ends = (problem.q_start, problem.goal.q)
    return np.abs([pin.computeGeneralizedGravity(model, data, q) for q in ends])


def iteration_counts(problem: Problem, methods: Sequence[str] = _METHODS) -> tuple[list[Count], np.ndarray]:
    """What each method comes to from the line, and the first one's controls."""
    counts, controls = [], np.zeros((problem.num_steps, problem.robot.nu))
    for method in methods:
        chosen = problem.with_(solver=replace(problem.solver, method=method, max_iterations=_MOST))
        formulation = formulate(chosen)  # interior-point methods count quaternions as plain numbers
        guess, _ = make_guess("line", formulation)
        programme = formulation.programme
        settings = SolverSettings.of(chosen.solver, programme, has_inequalities=problem.is_bounded)
        result = run_strategy(settings, Start(programme, guess)).result
        done = result.status == "converged"
        taken = sum(not record.is_guess for record in result.history)
        counts.append(Count(taken, result.record.cost, done))
        if method == methods[0]:
            controls = formulation.motion_of(result.iterate).us
    return counts, controls


def _both(name: str, seed: int, number: int) -> list[list[Count]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        problem = random_task(name, seed, number)
        free, us = iteration_counts(problem)
        return [free, iteration_counts(limited(problem, us, seed, number))[0]]


def iteration_tables(tasks: int, seed: int, robots: Sequence[str] = ROBOTS) -> Iterator[Table]:
    """One table for motions without limits, one for those within."""
    found = {name: [_both(name, seed, i) for i in range(tasks)] for name in robots}
    for case, title in enumerate(("without limits", "within limits of torques")):
        rows = []
        for name, runs in found.items():
            counts = [run[case] for run in runs]
            rows += [_row(name, k, counts) for k in range(len(_METHODS))]
        yield Table(
            f"Iterations, {tasks} random tasks a robot, seed {seed}, {title}",
            _COLUMNS,
            rows,
            "Statistics over the tasks that both solve. "
            f"Same guess, tolerance 1e-9, at most {_MOST} iterations; cost higher: by more than 1 %.",
        )


def _row(name: str, which: int, counts: list[list[Count]]) -> tuple[str, ...]:
    both = [c for c in counts if all(one.converged for one in c)]
    numbers = np.array([c[which].iterations for c in both] or [np.nan], dtype=float)
    more = sum(c[which].iterations > c[1 - which].iterations for c in both)
    higher = sum(c[which].cost > (1.0 + _HIGHER) * c[1 - which].cost for c in both)
    solved = sum(c[which].converged for c in counts)
    return (
        name,
        _METHODS[which],
        f"{solved} / {len(counts)}",
        f"{np.median(numbers):.0f}",
        f"{np.percentile(numbers, 90):.0f}",
        f"{numbers.mean():.1f}",
        str(more),
        str(higher),
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.iterations", description=__doc__)
    parser.add_argument("--tasks", type=int, default=500, help="random tasks of each robot")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=ROBOTS)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    options = parser.parse_args(arguments)
    one_core()
    show(header(), markdown=options.markdown)
    for table in iteration_tables(options.tasks, options.seed, options.robots):
        show(table, markdown=options.markdown)


if __name__ == "__main__":
    main()
