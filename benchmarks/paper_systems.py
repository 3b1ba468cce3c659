"""The first paper's systems at the step sizes of its tables: `python -m benchmarks.paper_systems`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.newton import EXAMPLES
from benchmarks.tables import Table, show

__all__ = ["SYSTEMS", "System", "table"]

_PENALTY = ('goal.enforce="penalty"', "cost.effort=1e-3", "cost.terminal=1.0")


@dataclass(frozen=True)
class System:
    """One table of the paper: steps, its DOF column, iterations and CPU time [s] of its monolithic solver."""

    title: str
    name: str
    steps: tuple[int, ...]
    dofs: tuple[int, ...]
    iterations: tuple[int, ...]
    seconds: tuple[float, ...]
    settings: tuple[str, ...] = ()


SYSTEMS = (
    System(
        "Table 2, elastic pendulum, exact end condition (15 N + 15)",
        "elastic_pendulum",
        (10, 50, 100, 500),
        (165, 765, 1515, 7515),
        (7, 9, 11, 15),
        (2.57, 56.29, 250.67, 8080.22),
    ),
    System(
        "Table 4, rigid pendulum, penalty (17 N + 3)",
        "rigid_pendulum",
        (4, 10, 20, 100),
        (71, 173, 343, 1703),
        (8, 8, 8, 7),
        (0.37, 1.44, 4.16, 82.94),
        _PENALTY,
    ),
    System("Rigid pendulum, exact end condition (no table)", "rigid_pendulum", (4, 10, 20, 100), (), (), ()),
    System(
        "Table 6, cart and rigid pendulum (15 N + 1)",
        "cart_pendulum_rigid",
        (20, 40, 200, 400),
        (301, 601, 3001, 6001),
        (13, 13, 12, 13),
        (8.90, 33.64, 745.7, 3394.41),
    ),
    System(
        "Table 7, cart and elastic pendulum (13 N + 1)",
        "cart_pendulum_elastic",
        (20, 40, 200, 400),
        (261, 521, 2601, 5201),
        (14, 14, 19, 18),
        (9.48, 36.33, 1190.3, 4708.65),
    ),
)


def table(system: System, repetitions: int = 5, most_steps: int | None = None) -> Table:
    """Solve at all step sizes with both globalisations."""
    rows = []
    for i, steps in enumerate(system.steps):
        if most_steps is not None and steps > most_steps:
            continue
        problem = mbocp.load_problem(
            EXAMPLES / "paper" / f"{system.name}.toml", [*system.settings, f"horizon.steps={steps}"]
        )
        default = [mbocp.solve(problem) for _ in range(repetitions)]
        plain = replace(problem.solver, globalisation="none", max_iterations=60)
        pure = mbocp.solve(problem.with_(solver=plain))
        s = default[-1]
        seconds = median(sum(p.wall_time_s for p in d.phases if p.iterations) for d in default)
        rows.append(
            (
                f"{problem.dt:g}",
                str(steps),
                _at(system.dofs, i),
                str(s.unknowns),
                _at(system.iterations, i),
                _pure(pure, s),
                f"{s.iterations}" if s.converged else str(s.status),
                f"{s.cost:.9g}",
                _at(system.seconds, i),
                f"{1e3 * seconds:.2f}",
            )
        )
    columns = ("dt [s]", "N", "paper: DOF", "unknowns", "paper: iterations", "none", "default", "cost")
    return Table(system.title, (*columns, "paper: CPU [s]", "Newton [ms]"), rows)


def _at(column: Sequence[float], i: int) -> str:
    return f"{column[i]:.10g}" if column else "-"


def _pure(pure: mbocp.Solution, default: mbocp.Solution) -> str:
    if not pure.converged:
        return f"no ({pure.status}, {pure.iterations})"
    same = abs(pure.cost - default.cost) <= 1e-9 * abs(default.cost)
    if same:
        return str(pure.iterations)
    kind = "" if "strict local minimum" in pure.advice else ", no minimum"
    return f"{pure.iterations} (J = {pure.cost:.4g}{kind})"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.paper_systems", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    options = parser.parse_args(arguments)
    one_core()
    show(header(), markdown=options.markdown)
    for system in SYSTEMS:
        show(table(system), markdown=options.markdown)


if __name__ == "__main__":
    main()
