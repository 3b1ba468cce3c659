"""How often each strategy succeeds, on many tasks: `python -m benchmarks.success`."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from statistics import median

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.newton import EXAMPLES, SE1
from benchmarks.random_tasks import rest_to_rest
from benchmarks.strategies import METHODS, seconds_of
from benchmarks.tables import Table, show

__all__ = ["success_table", "tasks"]

_PENALTY = ('goal.enforce="penalty"', "cost.effort=1e-3", "cost.terminal=1.0")
_PAPER = (
    ("elastic_pendulum", (), (10, 50, 100, 500)),
    ("rigid_pendulum", (), (4, 10, 20, 100)),
    ("rigid_pendulum", _PENALTY, (4, 10, 20, 100)),
    ("cart_pendulum_rigid", (), (20, 40, 200, 400)),
    ("cart_pendulum_elastic", (), (20, 40, 200, 400)),
)
_ROBOTS = ("arms/ur5_reach", "arms/panda_reach", "arms/kinova_reach", "free_flyer/drone_flip")
_GRADIENT_LIMIT = 1000


def tasks(number: int = 12) -> Iterator[tuple[str, str, mbocp.Problem]]:
    """Group, name and problem: the paper's, the examples', and `number` random ones of each kind."""
    for name, form, all_steps in _PAPER:
        for steps in all_steps:
            path = EXAMPLES / "paper" / f"{name}.toml"
            yield "paper", f"{name} {steps}", mbocp.load_problem(path, [*form, f"horizon.steps={steps}"])
    for name in _ROBOTS:
        yield "examples", name, mbocp.load_problem(EXAMPLES / f"{name}.toml", SE1)
    rng, drone = np.random.default_rng(7), mbocp.load_problem(EXAMPLES / "free_flyer/drone_flip.toml").robot
    arm, pendulum = (mbocp.load_robot(name, damping=False) for name in ("ur5", "double_pendulum"))
    for velocity in (1.0, 0.0):
        for i in range(number):
            q0, q1 = rng.uniform(-2.0, 2.0, (2, 6))
            yield (
                "random UR5" + ("" if velocity else ", effort only"),
                f"{i}",
                rest_to_rest(arm, float(rng.uniform(1.0, 3.0)), 60, q0, q1, velocity),
            )
    for i in range(number):
        q0, q1 = rng.uniform(-np.pi, np.pi, (2, 2))
        yield "random double pendulum", f"{i}", rest_to_rest(pendulum, 2.0, 80, q0, q1, 0.0)
    for i in range(number):
        tangent = np.concatenate([rng.uniform(-1.0, 1.0, 3), rng.uniform(-1.5, 1.5, 3)])
        goal = pin.integrate(drone.model, drone.q0, tangent)
        yield "random drone", f"{i}", rest_to_rest(drone, 1.5, 60, drone.q0, goal, 1.0)


def success_table(number: int = 12, methods: Sequence[str] = METHODS) -> Table:
    """Successes of each strategy by group, and the time they took."""
    found: dict[tuple[str, str], list[mbocp.Solution]] = {}
    groups: dict[str, int] = {}
    for group, _, problem in tasks(number):
        groups[group] = groups.get(group, 0) + 1
        for method in methods:
            options = {"method": method}
            limit = {"max_iterations": _GRADIENT_LIMIT} if method == "fbsm_bb" else {}
            chosen = problem.with_(solver=replace(problem.solver, **options, **limit))
            found.setdefault((group, method), []).append(mbocp.solve(chosen))
    rows = []
    for method in methods:
        cells, total = [], 0
        for group, size in groups.items():
            converged = sum(s.converged for s in found[group, method])
            total += converged
            cells.append(f"{converged} / {size}")
        times = [seconds_of(s) for group in groups for s in found[group, method] if s.converged]
        rows.append((method, *cells, f"{total} / {sum(groups.values())}", f"{1e3 * median(times):.3g}"))
    note = (
        "Converged to 1e-9, from the default guesses. "
        f"fbsm_bb is given {_GRADIENT_LIMIT} iterations. Time: median of the successes, solver alone."
    )
    return Table("Successes", ("strategy", *groups, "all", "time [ms]"), rows, note)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.success", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--number", type=int, default=12, help="random tasks of each kind")
    options = parser.parse_args(arguments)
    one_core()
    show(header(), markdown=options.markdown)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # goals beyond the limits of a joint: no matter here
        show(success_table(options.number), markdown=options.markdown)


if __name__ == "__main__":
    main()
