"""Problems with limits, by mbocp's own solver, fatrop and IPOPT: `python -m benchmarks.limits`."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.newton import EXAMPLES, SE1
from benchmarks.tables import Table, present
from mbocp.problem import Problem
from mbocp.study.run_task import solver_seconds

__all__ = ["random_table", "solver_table"]

SOLVERS = ("monolithic", "fatrop", "ipopt")
_ROUNDS = 5
_DOCS = Path(__file__).parent / "measured" / "limits.md"
_BEGIN = "<!-- tables: python -m benchmarks.limits --docs -->"
_WALL = 'path=[{frame="tool0", kind="position", y=[-9, 0.55]}, {frame="tool0", kind="speed", max=2.5}]'
_BOX = "limits={effort=30.0, velocity=[9.0, 9.0, 1.6, 9.0, 9.0, 9.0]}"


@dataclass(frozen=True)
class _Case:
    name: str
    path: str
    settings: tuple[str, ...] = ()

    def problem(self, solver: str) -> Problem:
        settings = (*self.settings, f"solver.method={solver}", "guess.kind=line")
        return mbocp.load_problem(EXAMPLES / self.path, settings)


_ALL = "limits={effort=true, velocity=true, position=true}"
_UNICYCLE = "so3/unicycle_pendulum.toml"
CASES = (
    _Case("UR5 within its limits", "arms/ur5_limits.toml", SE1),
    _Case("UR5 before a wall, tool below 2.5 m/s", "arms/ur5_limits.toml", (*SE1, "limits={}", _WALL)),
    _Case("Panda within its limits, in 1.1 s", "arms/panda_reach.toml", (*SE1, _ALL, "horizon.duration=1.1")),
    _Case("drone, thrust and climb limited", "free_flyer/drone_flip.toml", (*SE1, _BOX)),
    _Case("unicycle, Q RK", _UNICYCLE, ("integrator.lie=plain",)),
    _Case("unicycle, Q RK-MK", _UNICYCLE),
    _Case("unicycle, DCM RK", _UNICYCLE, ("integrator.lie=plain", "robot.rotations=dcm")),
    _Case("unicycle, DCM RK-MK", _UNICYCLE, ("robot.rotations=dcm",)),
)


def solver_table(rounds: int = _ROUNDS) -> Table:
    """Iterations and time of each solver, in turn in one process."""
    rows = []
    for case in CASES:
        found = {solver: mbocp.solve(case.problem(solver)) for solver in SOLVERS}  # compiles, too
        times: dict[str, list[float]] = {solver: [] for solver in SOLVERS}
        for _ in range(rounds):
            for solver in SOLVERS:
                times[solver].append(1e3 * solver_seconds(mbocp.solve(case.problem(solver))))
        own = median(times["monolithic"])
        for solver in SOLVERS:
            s, taken = found[solver], median(times[solver])
            status = "" if s.converged else f" ({s.status})"
            rows.append(
                (
                    case.name if solver == SOLVERS[0] else "",
                    solver,
                    f"{s.iterations}{status}",
                    f"{taken:.1f}",
                    f"{taken / s.iterations:.2f}",
                    f"{taken / own:.1f}",
                    f"{s.cost:.8g}",
                )
            )
    columns = ("problem, N = 100", "solver", "iterations", "wall [ms]", "per iteration [ms]", "ratio", "cost")
    note = (
        "One guess, a straight line. Wall time of the solver alone, median of "
        f"{rounds} runs in turn; nothing is compiled in it. Tolerance 1e-9 for all; each by its own measure."
    )
    return Table("Limits: mbocp's own solver beside fatrop and IPOPT", columns, rows, note)


def _random(number: int) -> Iterator[tuple[str, Problem]]:
    """Rest to rest between random poses inside the limits of the URDF, with little time."""
    rng = np.random.default_rng(11)
    for name, robot in (("random UR5", _robot("ur5")), ("random Panda", _robot("panda"))):
        lower, upper = robot.limits.position_lower, robot.limits.position_upper
        lower, upper = np.maximum(lower, -2.5) + 0.1, np.minimum(upper, 2.5) - 0.1
        speed = np.minimum(robot.limits.velocity, 1e3)
        for _ in range(number):
            q0, q1 = rng.uniform(lower, upper, (2, robot.nq))
            duration = 1.35 * float(np.max(np.abs(q1 - q0) / speed)) + 0.25
            yield (
                name,
                Problem.create(
                    robot,
                    duration,
                    100,
                    start={"q": q0},
                    goal={"q": q1, "v": np.zeros(robot.nv)},
                    cost={"effort": 1.0, "velocity": 100.0},
                    limits={"effort": True, "velocity": True, "position": True},
                    guess={"kind": "line"},
                    scheme="se1",
                ),
            )


def _robot(name: str) -> Any:
    locked = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}
    return mbocp.load_robot(name, lock=locked, damping=False) if name == "panda" else mbocp.load_robot(name)


def random_table(number: int = 25) -> Table:
    """How many random motions within limits each solver finds."""
    found: dict[tuple[str, str], list[mbocp.Solution]] = {}
    groups: dict[str, int] = {}
    methods = (*SOLVERS, "auto")
    for group, problem in _random(number):
        groups[group] = groups.get(group, 0) + 1
        for method in methods:
            chosen = problem.with_(solver=replace(problem.solver, method=method))
            found.setdefault((group, method), []).append(mbocp.solve(chosen))
    rows = []
    for method in methods:
        cells = []
        for group, size in groups.items():
            good = [s for s in found[group, method] if s.converged]
            times = [1e3 * solver_seconds(s) for s in good]
            told = f"{median(times):.0f} ms, {median(s.iterations for s in good):.0f}" if good else "-"
            cells += [f"{len(good)} / {size}", told]
        rows.append((method, *cells))
    columns = [c for group in groups for c in (group, "median time, iterations")]
    note = (
        "Rest to rest between random poses within the limits of the URDF on efforts, velocities and "
        "positions, in 0.25 s more than 1.35 times what the slowest joint takes at full speed: some may have "
        "no solution."
    )
    return Table("Random motions within limits", ("solver", *columns), rows, note)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables, or put them into the data that the documentation is about."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.limits", description=__doc__)
    parser.add_argument("--docs", action="store_true", help=f"rewrite measured/{_DOCS.name}")
    parser.add_argument("--number", type=int, default=25, help="random tasks of each kind")
    options = parser.parse_args(arguments)
    one_core()
    tables = [header()]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tables += [solver_table(), random_table(options.number)]
    present(tables, _DOCS, _BEGIN, into_page=options.docs)


if __name__ == "__main__":
    main()
