"""One iteration of each solver over the number of steps, in time and memory; and what robots need."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

import mbocp
from benchmarks.newton import SE1, Case, exponent, load, median_time
from benchmarks.tables import Table
from mbocp.formulation import formulate
from mbocp.guesses import iterate_from_solution
from mbocp.programme import StagewiseProgramme
from mbocp.programme.kernel import kernel_programme
from mbocp.solvers import Iterate
from mbocp.solvers.staggered.sweep import EndCondition, Sweeps

__all__ = ["GROWTH", "METHODS", "STEPS", "growth_table", "robot_table", "seconds_of"]

STEPS = (500, 2000, 6000, 20_000)
GROWTH = (
    Case("elastic_pendulum", "paper/elastic_pendulum.toml"),
    Case("rigid_pendulum", "paper/rigid_pendulum.toml"),
    Case("cart_pendulum_rigid", "paper/cart_pendulum_rigid.toml"),
    Case("cart_pendulum_elastic", "paper/cart_pendulum_elastic.toml"),
    Case("ur5_reach", "arms/ur5_reach.toml", SE1),
)
ROBOTS = (
    Case("ur5_reach", "arms/ur5_reach.toml", SE1),
    Case("panda_reach", "arms/panda_reach.toml", SE1),
    Case("kinova_reach", "arms/kinova_reach.toml", SE1),
    Case("drone_flip", "free_flyer/drone_flip.toml", SE1),
)
_DISTURBANCE = 1e-6  # relative, of the controls of an optimum: near enough for a full step
METHODS = ("monolithic", "fbsm_newton", "fbsm_bb", "fbsm_bb+monolithic", "fbsm_bb+fbsm_newton", "auto")


def growth_table(
    case: Case, steps: Sequence[int] = STEPS, repetitions: int = 9
) -> tuple[Table, dict[str, float]]:
    """Time of one iteration of each solver, memory of the stages, and the fitted exponents."""
    seconds: dict[str, list[float]] = {name: [] for name in ("monolithic", "fbsm_newton", "fbsm_bb")}
    memory = []
    optimum = mbocp.solve(load(case, f"horizon.steps={steps[0]}"), check=True)
    for n in steps:
        problem = load(case, f"horizon.steps={n}")
        formulation = formulate(problem)
        programme = formulation.programme
        native = kernel_programme(programme)
        near = _swept_near(iterate_from_solution(optimum, formulation), native, programme)
        memory.append(float(native.num_bytes))
        for name, iteration in _ITERATIONS.items():
            work, reset = partial(iteration, native), partial(near.load_into, native)
            seconds[name].append(median_time(work, reset, repetitions))
    rows = []
    for i, n in enumerate(steps):
        times = [f"{1e3 * seconds[name][i]:.3g}" for name in seconds]
        rows.append((str(n), *times, f"{memory[i] / 1e6:.1f}"))
    found = {name: exponent(steps, values) for name, values in seconds.items()}
    found["memory"] = exponent(steps, memory)
    rows.append(("exponent", *(f"{value:.3f}" for value in found.values())))
    columns = ("N", *(f"{name} [ms]" for name in seconds), "memory [MB]")
    note = f"Medians of {repetitions} full steps near an optimum, with their sweeps; memory: the stages'."
    return Table(f"One iteration of each solver: {case.label}", columns, rows, note), found


def _swept_near(iterate: Iterate, native: Any, programme: StagewiseProgramme) -> Iterate:
    """Swept trajectory with controls a little off it, so that a sweep has the same to do for every N."""
    iterate.load_into(native)
    _swept(native)
    swept = Iterate.read_from(native, programme)
    scale = _DISTURBANCE * np.abs(swept.us).max()
    return replace(swept, us=swept.us + scale * np.random.default_rng(0).standard_normal(swept.us.shape))


def _newton(native: Any) -> None:
    native.evaluate()
    if not native.factorise().ok or not native.solve().finite:
        raise RuntimeError("no Newton step from a coarser optimum")
    native.move(1.0)
    native.accept(1.0)


def _swept(native: Any) -> None:
    if Sweeps().run(native).evaluation is None:
        raise RuntimeError("no sweep from a coarser optimum")


def _fbsm_newton(native: Any) -> None:
    _swept(native)
    _newton(native)


def _fbsm_bb(native: Any) -> None:
    _swept(native)
    end, gradient = EndCondition.of(native), native.control_gradient
    eta = end.multiplier(gradient)
    native.u = native.u - 1e-6 * (gradient + end.G.T @ eta) + end.restoration()


_ITERATIONS: dict[str, Callable[[Any], None]] = {
    "monolithic": _newton,
    "fbsm_newton": _fbsm_newton,
    "fbsm_bb": _fbsm_bb,
}


def robot_table(cases: Sequence[Case] = ROBOTS, methods: Sequence[str] = METHODS) -> Table:
    """What each strategy needs on robots: iterations and wall time of its phases, from the default guess."""
    rows = []
    for case in cases:
        for method in methods:
            limit = ("solver.max_iterations=300",) if method == "fbsm_bb" else ()
            problem = load(case, 'guess.kind="line"', f'solver.method="{method}"', *limit)
            solution = min((mbocp.solve(problem) for _ in range(2)), key=seconds_of)
            counts = "+".join(str(p.iterations) for p in solution.phases if p.iterations)
            verdict = "converged" if solution.converged else f"no ({solution.status})"
            cells = (
                case.label,
                method,
                verdict,
                counts,
                f"{1e3 * seconds_of(solution):.3g}",
                f"{solution.cost:.9g}",
            )
            rows.append(cells)
    columns = ("problem", "strategy", "outcome", "iterations", "solver [ms]", "cost")
    note = "From the straight line; iterations by phase; the lesser of two runs; fbsm_bb is given 300."
    return Table("Strategies on robots", columns, rows, note)


def seconds_of(solution: mbocp.Solution) -> float:
    """Wall time of the solver's phases."""
    others = ("compile", "guess", "diagnostics")
    return sum(p.wall_time_s for p in solution.phases if p.name not in others)
