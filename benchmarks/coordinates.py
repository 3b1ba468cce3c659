"""`python -m benchmarks.coordinates`: joint against natural coordinates, their optima and their time."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.newton import EXAMPLES, SE1
from benchmarks.tables import Table, put_into, show
from mbocp.formulation import formulate
from mbocp.guesses import make_guess
from mbocp.problem import Problem
from mbocp.problem.problem import problem_from_tables
from mbocp.solution import Solution
from mbocp.solvers import SolverSettings, Start, run_strategy

__all__ = ["chain_table", "convergence_table", "iteration_table"]

_STEPS = (50, 100, 200, 400)
_LINKS = (2, 4, 8, 16, 32)
_ROUNDS = 5
_FIRST = 6  # iterations of a chain that are timed
_DOCS = Path(__file__).parent / "measured" / "coordinates.md"
_BEGIN = "<!-- tables: python -m benchmarks.coordinates --docs -->"


def reference_task(robot: str, start: Sequence[float], goal: Sequence[float], steps: int) -> Problem:
    """Rest to rest in 1.5 s with |u|^2 for a cost."""
    return problem_from_tables(
        {
            "robot": {"name": robot, "damping": False},  # as in the reference
            "horizon": {"duration": 1.5, "steps": steps},
            "start": {"q": list(start)},
            "goal": {"q": list(goal), "p": [0.0] * len(goal)},
        }
    )


def _arm(name: str, steps: int) -> Problem:
    return mbocp.load_problem(EXAMPLES / "arms" / f"{name}.toml", SE1).with_(num_steps=steps)


def _tasks() -> Iterator[tuple[str, Any]]:
    yield "double_pendulum", lambda n: reference_task("double_pendulum", (0, 0), (0.8, -0.6), n)
    arm = ((0, np.pi / 2, 0, 0, 0, 0), (0.5, 1.2, 0.5, -0.3, 0.4, 0.2))
    yield "ur5, reference task", lambda n: reference_task("ur5", *arm, n)
    for name in ("ur5_reach", "panda_reach"):
        yield (
            name,
            lambda n, name=name: mbocp.load_problem(EXAMPLES / "arms" / f"{name}.toml", SE1).with_(
                num_steps=n
            ),
        )


def _solved(problem: Problem) -> Solution:
    return mbocp.solve(problem, check=True)


def convergence_table() -> Table:
    """Optima in both coordinates over the length of a step."""
    rows = []
    for name, task in _tasks():
        for steps in _STEPS:
            joint, natural = _solved(task(steps)), _solved(task(steps).with_(coordinates="natural"))
            rows.append(
                (
                    name if steps == _STEPS[0] else "",
                    f"{joint.duration / steps:.5g}",
                    f"{joint.cost:.9g}",
                    f"{natural.cost:.9g}",
                    f"{abs(natural.cost / joint.cost - 1.0):.1e}",
                    f"{np.abs(natural.qs - joint.qs).max():.1e}",
                    f"{natural.constraint_violation:.0e}",
                )
            )
    return Table(
        "The same optimum, to first order",
        ("task", "dt [s]", "J, joint", "J, natural", "relative", "largest difference of q", "constraints"),
        rows,
    )


def _iteration(problem: Problem, kind: str = "") -> tuple[float, int, float]:
    """Time of an iteration and of the solve from its guess [s], and the number of iterations."""
    formulation = formulate(problem)
    programme = formulation.programme
    kind = kind or ("joint" if problem.coordinates == "natural" else "line")
    iterate, _ = make_guess(kind, formulation)
    settings = SolverSettings.of(problem.solver, programme)
    times, count = [], 0
    for _ in range(_ROUNDS):
        clock = time.perf_counter()
        outcome = run_strategy(settings, Start(programme, iterate))
        times.append(time.perf_counter() - clock)
        count = sum(phase.iterations for phase in outcome.phases)
    best = median(times)
    return best / count, count, best


def iteration_table() -> Table:
    """A Newton iteration with 100 steps, and a solve in natural coordinates from the joints' optimum."""
    rows = []
    for name, task in _tasks():
        problem = task(100)
        natural = problem.with_(coordinates="natural")
        made = formulate(natural)
        sizes = made.programme
        joint_time, natural_time = _iteration(problem), _iteration(natural)
        rows.append(
            (
                name,
                f"{2 * problem.robot.nv}",
                f"{made.layout.nx} + {sizes.kind.ny}",
                f"{1e3 * joint_time[0]:.2f}",
                f"{1e3 * natural_time[0]:.2f}",
                f"{natural_time[0] / joint_time[0]:.1f}",
                f"{natural_time[1]}",
                f"{1e3 * natural_time[2]:.0f}",
            )
        )
    columns = ("task", "state, joint", "state + constraints, natural", "joint [ms]", "natural [ms]", "ratio")
    return Table(
        "A Newton iteration, 100 steps",
        (*columns, "iterations from the joints' optimum", "all of them [ms]"),
        rows,
        "Time of a whole iteration: factorise, solve, line search, evaluate.",
    )


def chain_table(links: Sequence[int] = _LINKS, steps: int = 50) -> Table:
    """Time of an iteration against the number of links of a hanging chain."""
    rows = []
    for count in links:
        problem = problem_from_tables(
            {
                "robot": f"chain_{count}",
                "horizon": {"duration": 1.0, "steps": steps},
                "goal": {"q": [0.5 / count] * count, "v": [0.0] * count},
                "solver": {"method": "monolithic", "max_iterations": _FIRST},
            }
        )
        natural = problem.with_(coordinates="natural")
        joint_time, natural_time = _iteration(problem, "line")[0], _iteration(natural, "line")[0]
        rows.append(
            (
                str(count),
                f"{1e3 * joint_time:.2f}",
                f"{1e3 * natural_time:.2f}",
                f"{natural_time / joint_time:.2f}",
            )
        )
    columns = ("links", "joint [ms]", "natural [ms]", "ratio")
    return Table(
        f"A Newton iteration of a chain, {steps} steps",
        columns,
        rows,
        f"The first {_FIRST} iterations from a straight line; in joint coordinates 32 links are compiled "
        "without optimisation.",
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print all tables, or put them into the data that the documentation is about."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.coordinates", description=__doc__)
    parser.add_argument("--docs", action="store_true", help=f"write them into measured/{_DOCS.name}")
    parser.add_argument("--links", type=int, nargs="+", default=list(_LINKS), help="of the chains")
    options = parser.parse_args(arguments)
    one_core()
    tables = [header()]
    for table in (iteration_table, lambda: chain_table(options.links), convergence_table):
        tables.append(table())
        show(tables[-1])
    if options.docs:
        put_into(_DOCS, _BEGIN, tables)


if __name__ == "__main__":
    main()
