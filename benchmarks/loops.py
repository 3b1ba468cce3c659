"""`python -m benchmarks.loops`: mechanisms with closed loops, simulated and driven, in both coordinates."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.newton import EXAMPLES
from benchmarks.tables import Table, put_into, show
from mbocp.formulation import formulate
from mbocp.mechanics import NaturalSpace
from mbocp.problem import Problem
from mbocp.problem.problem import problem_from_tables
from mbocp.programme.kernel import kernel_programme

__all__ = ["ROBOTS", "Simulation", "convergence_table", "simulate", "simulation_table", "solver_table"]

ROBOTS = ("four_bar", "slider_crank", "five_bar", "parallelogram_arm", "delta", "stewart")
_COORDINATES = ("joint", "natural")
_TURNING = ("four_bar", "slider_crank")  # whose cranks go all round
_STEPS_OF_EXAMPLES = 100
_DURATION = 10.0  # [s]
_ENERGY = 2.0  # [J] kinetic, at the start
_STEPS = (1000, 4000)
_PIECE = 100
_METHODS = ("monolithic", "fbsm_newton", "fbsm_bb+fbsm_newton", "fbsm_bb+monolithic")
_HALVINGS = (50, 100, 200, 400)
_DOCS = Path(__file__).parent / "measured" / "loops.md"
_BEGIN = "<!-- tables: python -m benchmarks.loops --docs -->"
_CONVERGENCE = Path(__file__).with_suffix(".csv")


class Simulation:
    """A mechanism left to itself from its initial pose, with some velocity along the constraints.

    Attributes
    ----------
    closure : float
        Largest residual of any row of any loop, redundant ones included [m, rad].
    energies : ndarray, shape (N + 1,)
        [J].
    """

    def __init__(self, problem: Problem) -> None:
        N, robot = problem.num_steps, problem.robot
        pieces = -(-N // _PIECE)
        formulation = formulate(problem.with_(num_steps=_PIECE, duration=_PIECE * problem.dt))
        programme = formulation.programme
        at, native = formulation.layout, kernel_programme(programme)
        native.u = np.zeros(native.u.shape)
        xs = np.zeros((pieces * _PIECE + 1, at.nx))
        xs[0] = programme.x_start
        for first in range(0, N, _PIECE):  # few steps at once: those of natural coordinates are large
            piece = np.zeros((_PIECE + 1, at.nx))
            piece[0] = xs[first]
            native.x = piece.ravel()
            swept = native.simulate(1e-12, 50)
            if not swept.ok:
                failed = (first + swept.failed_stage + 1) * problem.dt
                raise RuntimeError(f"{robot.name}: the step to {failed:g} s fails")
            xs[first : first + _PIECE + 1] = native.x.reshape(piece.shape)
        xs = xs[: N + 1]
        qs, vs = xs[:, at.z], xs[:, at.s]
        if isinstance(formulation.space, NaturalSpace):
            qs, vs = formulation.space.configurations(qs), formulation.space.velocities(qs, vs)
        self.closure = float(np.abs(robot.closure_along(qs)[0]).max())
        self.energies = np.array(
            [
                0.5 * v @ robot.mass_matrix(q) @ v + robot.potential_energy(q)
                for q, v in zip(qs, vs, strict=True)
            ]
        )


def simulate(name: str, coordinates: str, steps: int, duration: float = _DURATION) -> Simulation:
    """Simulate a robot without actuation by SE1."""
    robot = mbocp.load_robot(name)
    push = np.random.default_rng(1).standard_normal(robot.nv)
    velocity = robot.assemble_velocity(robot.q0, push)
    velocity = velocity * np.sqrt(2.0 * _ENERGY / (velocity @ robot.mass_matrix(robot.q0) @ velocity))
    document = {
        "robot": name,
        "coordinates": coordinates,
        "horizon": {"duration": duration, "steps": steps},
        "integrator": {"scheme": "se1"},
        "start": {"q": list(robot.q0), "v": list(velocity)},
        "goal": {"v": [0.0] * robot.nv},  # nothing is solved
    }
    return Simulation(problem_from_tables(document))


def simulation_table(robots: Sequence[str] = ROBOTS) -> Table:
    """Closure and energy over ten seconds without actuation."""
    rows = []
    for name in robots:
        for coordinates in _COORDINATES:
            found = [simulate(name, coordinates, steps) for steps in _STEPS]
            change = [f"{s.energies[-1] - s.energies[0]:.3g}" for s in found]
            rise = max(float((s.energies - s.energies[0]).max()) for s in found)
            rows.append(
                (
                    name if coordinates == "joint" else "",
                    coordinates,
                    f"{max(s.closure for s in found):.0e}",
                    *change,
                    f"{rise:.2g}",
                )
            )
    changes = tuple(f"dE, dt = {_DURATION / steps:g} s [J]" for steps in _STEPS)
    return Table(
        f"{_DURATION:g} s without actuation, by SE1",
        ("robot", "coordinates", "closure [m, rad]", *changes, "highest rise [J]"),
        rows,
        f"From the initial pose with a kinetic energy of {_ENERGY:g} J. dE: change of the energy, which SE1 "
        "dissipates; its highest rise above the start.",
    )


def example(name: str, steps: int | None = None, scheme: str | None = None) -> Problem:
    """Motion of a robot's example file, in 100 steps of a scheme for both coordinates, or in others."""
    own = "midpoint" if name in _TURNING else "se1"
    changes: dict[str, Any] = {"horizon.steps": steps or _STEPS_OF_EXAMPLES}
    changes |= {"integrator.scheme": scheme or own}
    return mbocp.load_problem(EXAMPLES / "loops" / f"{name}.toml", changes)


def solver_table(robots: Sequence[str] = ROBOTS) -> Table:
    """The examples by all strategies, in both coordinates."""
    rows = []
    for name in robots:
        for coordinates in _COORDINATES:
            problem = example(name).with_(coordinates=coordinates)
            cells, costs = [], []
            for method in _METHODS:
                mbocp.solve(problem, solver=method)  # compiles
                clock = time.perf_counter()
                solution = mbocp.solve(problem, solver=method, check=True)
                seconds = time.perf_counter() - clock
                cells.append(f"{solution.iterations} in {seconds:.2g} s")
                costs.append(solution.cost)
            spread = max(costs) - min(costs)
            rows.append((name, coordinates, f"{costs[0]:.8g}", f"{spread / abs(costs[0]):.0e}", *cells))
    return Table(
        "Rest to rest, by four strategies",
        ("robot", "coordinates", "J", "relative spread of J", *_METHODS),
        rows,
        "The example files in 100 steps of `midpoint` (four_bar, slider_crank) and `se1`. Iterations and "
        "time of the whole solve, with its guess; in natural coordinates "
        "the guess is a solve in joint coordinates by `auto`, whose iterations are not counted.",
    )


def convergence_table(robots: Sequence[str] = ROBOTS) -> Table:
    """Joint against natural coordinates over the length of a step."""
    rows = []
    for name in robots:
        for scheme in dict.fromkeys(("se1", example(name).scheme)):
            before = np.nan
            for steps in _HALVINGS:
                problem = example(name, steps, scheme)
                joint = mbocp.solve(problem, check=True)
                natural = mbocp.solve(problem.with_(coordinates="natural"), check=True)
                gap = float(np.abs(natural.qs - joint.qs).max())
                rows.append(
                    (
                        name,
                        scheme,
                        f"{problem.dt:.4g}",
                        f"{joint.cost:.7g}",
                        f"{natural.cost:.7g}",
                        f"{gap:.2g}",
                        "" if np.isnan(before) else f"{before / gap:.1f}",
                        f"{max(joint.constraint_violation, natural.constraint_violation):.0e}",
                    )
                )
                before = gap
    columns = ("robot", "scheme", "dt [s]", "J, joint", "J, natural", "largest difference of q", "ratio")
    return Table(
        "Joint against natural coordinates",
        (*columns, "constraints"),
        rows,
        "ratio: of the differences of two lines; 2 for a scheme of first order, 4 for one of second.",
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print all tables, or put them into the measured ones."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.loops", description=__doc__)
    parser.add_argument(
        "--docs", action="store_true", help=f"write them into measured/{_DOCS.name} and {_CONVERGENCE.name}"
    )
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=list(ROBOTS), metavar="NAME")
    options = parser.parse_args(arguments)
    one_core()
    tables = [header()]
    for make in (simulation_table, solver_table, convergence_table):
        tables.append(make(options.robots))
        show(tables[-1])
    if options.docs:
        put_into(_DOCS, _BEGIN, tables[:-1])
        tables[-1].to_csv(_CONVERGENCE)


if __name__ == "__main__":
    main()
