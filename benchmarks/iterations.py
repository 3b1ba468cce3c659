"""Iterations of `monolithic` beside IPOPT's, on random tasks: `python -m benchmarks.iterations`.

Same programme, guess (the line) and tolerance. Arms and a drone go from rest to rest; half of the arms' poses
are far apart. Limits of torques are shares of the largest torques of the motion without them, but room to
hold both ends.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.random_tasks import rest_to_rest
from benchmarks.tables import Table, show
from mbocp import Problem, Robot
from mbocp.formulation import formulate
from mbocp.guesses import make_guess
from mbocp.solvers import SolverSettings, Start, run_strategy

__all__ = ["ROBOTS", "Count", "iteration_counts", "random_task"]

ROBOTS = ("ur5", "panda", "drone")
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


def _pose(rng: Rng, robot: Robot) -> np.ndarray:
    """Joints between their limits, at most two radians from the middle or from zero."""
    low = np.maximum(robot.model.lowerPositionLimit, -np.pi)
    high = np.minimum(robot.model.upperPositionLimit, np.pi)
    middle = np.where((low < 0.0) & (high > 0.0), 0.0, 0.5 * (low + high))
    return rng.uniform(np.maximum(low, middle - 2.0), np.minimum(high, middle + 2.0))


def limited(problem: Problem, us: np.ndarray, seed: int, number: int) -> Problem:
    """Within limits of torques that the motion with the controls `us` exceeds."""
    rng = np.random.default_rng([seed, number, 1])
    robot, data = problem.robot, problem.robot.model.createData()
    held = [
        np.abs(pin.computeGeneralizedGravity(robot.model, data, q)) for q in (problem.q_start, problem.goal.q)
    ]
    room = 1.15 * np.maximum(*held) + 1e-3
    bound = np.maximum(rng.uniform(0.6, 0.9) * np.abs(us).max(axis=0), room)
    cost = {"effort": 1.0, "velocity": np.asarray(problem.cost.velocity)}
    ends = {"start": {"q": problem.q_start}, "goal": {"q": problem.goal.q, "v": np.zeros(robot.nv)}}
    limits = {"effort": bound}
    return Problem.create(
        robot,
        problem.duration,
        problem.num_steps,
        **ends,
        cost=cost,
        limits=limits,
        scheme="se1",
    )


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
