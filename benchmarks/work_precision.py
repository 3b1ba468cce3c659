r"""`python -m benchmarks.work_precision`: time against true errors of cost, motion and adjoints.

A system is solved with N, 2 N, 4 N, ... equal steps. Its true cost is in `tests/data/reference_costs.json`;
its true motion and adjoints are those of the finest steps of a scheme of order four whose controls vary
within steps, extrapolated once. Between
the numbers of steps errors and times are interpolated on logarithms: so many steps, and so much time, to 1e-4
and to 1e-6 of the cost. Beyond the finest steps errors are extrapolated with the last slope and times grow
with the steps, which a "~" says.

- The error of the motion is the largest of a joint [rad, m] at the nodes that all solutions have.
- The error of the adjoint is that of the derivative of the cost to go in velocities that the constraints
  allow, :math:`Z^T M \mu^p`, by its largest value.
- The rival is CasADi with IPOPT by Gauss collocation (`benchmarks.collocation`), compiled, from the
  same guess.

Times are those of solvers alone, with functions from the cache, the least of a few.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.linalg import null_space

import mbocp
from benchmarks.collocation import Collocation
from benchmarks.machine import header, one_core
from benchmarks.newton import EXAMPLES
from benchmarks.tables import Table, show
from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.formulation import formulate
from mbocp.guesses import guess_candidates, make_guess
from mbocp.integrators import PAIRS, TABLEAUX, TAU

__all__ = ["SYSTEMS", "Point", "System", "main", "reached", "sweep"]

_DATA = Path(__file__).parent.parent / "tests" / "data" / "reference_costs.json"
_ASKED = (1e-4, 1e-6)
_LEVELS = 6
_FEW = 3  # solves, of which the fastest counts
_ROUND_OFF = 1e-11  # of a cost: below it there is nothing to see
_NEXT = 2.0**4 - 1.0  # of Richardson's extrapolation at order four
_RIVAL_LEVELS = 3  # each is compiled anew
_RIVALS = ("ipopt/gauss2", "ipopt/gauss2/stages", "ipopt/gauss3/stages")
SCHEMES = (
    *TAU,
    *PAIRS,
    *(f"{name}/stages" for name in PAIRS),
    "gauss2/linear",
    "lobatto3/linear",
    *(name for name in TABLEAUX if name != "euler"),
)


@dataclass(frozen=True)
class System:
    """A problem file, the number of steps with which tables begin, and changes."""

    name: str
    file: str
    steps: int
    settings: tuple[str, ...] = ()

    @property
    def problem(self) -> mbocp.Problem:
        problem = mbocp.load_problem(EXAMPLES / f"{self.file}.toml", self.settings)
        # None of these is reached: without them a solve needs no barrier, nor does the rival's.
        return problem.with_(limits={}) if self.name == "cart_pole" else problem


SYSTEMS = (
    System("elastic_pendulum", "paper/elastic_pendulum", 20),
    System("rigid_pendulum", "paper/rigid_pendulum", 10),
    System("cart_pole", "optima/cart_pole", 20),
    System("ur5_reach", "arms/ur5_reach", 25),
    System("panda_reach", "arms/panda_reach", 40),
    System("kinova_reach", "arms/kinova_reach", 25),
    System("drone_flip", "free_flyer/drone_flip", 20),
    System("four_bar", "loops/four_bar", 25),
)


@dataclass(frozen=True)
class Point:
    """A solve: its time [s], and errors of the cost (a part of it), the motion [rad, m] and the adjoints."""

    steps: int
    seconds: float
    iterations: int
    cost: float
    motion: float
    adjoint: float


@dataclass(frozen=True)
class _Truth:
    cost: float
    qs: Array  # at the nodes of the fewest steps
    adjoints: Array

    def errors(self, robot: mbocp.Robot, cost: float, qs: Array, adjoints: Array | None) -> tuple[float, ...]:
        """Of the cost, the motion and the adjoints."""
        every = (len(qs) - 1) // (len(self.qs) - 1)
        pairs = zip(self.qs, qs[::every], strict=True)
        moved = max(float(np.abs(pin.difference(robot.model, a, b)).max()) for a, b in pairs)
        if adjoints is None:
            return abs(cost / self.cost - 1.0), moved, np.nan
        off = np.abs(adjoints[::every] - self.adjoints).max() / np.abs(self.adjoints).max()
        return abs(cost / self.cost - 1.0), moved, float(off)


def _problem_with(system: System, scheme: str, num_steps: int) -> mbocp.Problem:
    """Problem of a scheme that may say how controls vary, as `gauss2/stages`."""
    name, _, controls = scheme.partition("/")
    return system.problem.with_(scheme=name, num_steps=num_steps, controls=controls or "constant")


def _adjoints(robot: mbocp.Robot, solution: mbocp.Solution) -> Array:
    """Derivatives of the cost to go in velocities, at each node; not those that constraints forbid."""
    found = np.array(
        [robot.mass_matrix(q) @ mu[robot.nv :] for q, mu in zip(solution.qs, solution.mus, strict=True)]
    )
    if not robot.nc:
        return found
    allowed = [_projection(robot, q) for q in solution.qs]
    return np.einsum("nij,nj->ni", np.array(allowed), found)


def _projection(robot: mbocp.Robot, q: Array) -> Array:
    """To velocities that the constraints allow, shape (nv, nv): a basis of them would not be unique."""
    basis = null_space(robot.constraint_jacobian(q))
    return basis @ basis.T


def _truth(system: System, level: int) -> _Truth:
    """The finest two of the scheme with the smallest errors, once extrapolated; costs from the data."""
    scheme = "lobatto3/stages" if system.problem.robot.nc else "gauss2/stages"
    robot, found, before = system.problem.robot, [], None
    for steps in (system.steps * 2 ** (level - 1), system.steps * 2**level):
        before = mbocp.solve(_problem_with(system, scheme, steps), warm_start=before, check=True)
        found.append((before, steps // system.steps))
    (coarse, skip), (fine, skip_fine) = found
    nodes = zip(coarse.qs[::skip], fine.qs[::skip_fine], strict=True)
    qs = [pin.integrate(robot.model, b, pin.difference(robot.model, a, b) / _NEXT) for a, b in nodes]
    adjoints = [_adjoints(robot, s)[::every] for s, every in found]
    known = json.loads(_DATA.read_text(encoding="utf-8"))
    cost = (
        known[system.name]["cost"] if system.name in known else fine.cost + (fine.cost - coarse.cost) / _NEXT
    )
    return _Truth(cost, np.array(qs), adjoints[1] + (adjoints[1] - adjoints[0]) / _NEXT)


def sweep(system: System, scheme: str, truth: _Truth, levels: int = _LEVELS) -> list[Point]:
    """Points of a scheme, from the fewest steps on; of those that do not converge there is none."""
    points, robot = [], system.problem.robot
    for steps in (system.steps * 2**k for k in range(levels)):
        problem = _problem_with(system, scheme, steps)
        solutions = [mbocp.solve(problem) for _ in range(1 + _FEW)]
        if not solutions[0].converged:
            continue
        seconds = min(sum(phase.wall_time_s for phase in s.phases) for s in solutions)
        last = solutions[-1]
        errors = truth.errors(robot, last.cost, last.qs, _adjoints(robot, last))
        points.append(Point(steps, seconds, last.iterations, *errors))
    return points


def rival(system: System, name: str, truth: _Truth, levels: int = _RIVAL_LEVELS) -> list[Point]:
    """Points of CasADi with IPOPT, from mbocp's first guess."""
    _, scheme, *more = name.split("/")
    points = []
    for steps in (system.steps * 2**k for k in range(levels)):
        problem = _problem_with(system, "lobatto2" if system.problem.robot.nc else "midpoint", steps)
        formulation = formulate(problem)
        guess, _ = make_guess(guess_candidates(problem)[0], formulation)
        begin = formulation.motion_of(guess)
        solver = Collocation(problem, PAIRS[scheme].num_stages, at_stages=bool(more))
        found = min((solver.solve(begin) for _ in range(_FEW)), key=lambda f: f.seconds)
        if found.converged:
            errors = truth.errors(problem.robot, found.cost, found.qs, None)
            points.append(Point(steps, found.seconds, found.iterations, *errors))
    return points


def reached(points: Sequence[Point], asked: float) -> tuple[float, float, str]:
    """Steps and seconds to an error of the cost, interpolated on logarithms, and "~", "<" or ""."""
    if not points:
        return np.nan, np.nan, ""
    if points[-1].cost > asked:
        if len(points) < 2 or points[-2].cost <= points[-1].cost:
            return np.nan, np.nan, ""
        steps, _ = _between(points[-2], points[-1], asked)
        return steps, points[-1].seconds * steps / points[-1].steps, "~"
    for coarse, fine in reversed(list(pairwise(points))):
        if coarse.cost > asked:
            return *_between(coarse, fine, asked), ""
    return points[0].steps, points[0].seconds, "<"


def _between(coarse: Point, fine: Point, asked: float) -> tuple[float, float]:
    """Where the line through two points on logarithms meets an error."""
    a, b = (np.log([p.steps, p.seconds, max(p.cost, _ROUND_OFF)]) for p in (coarse, fine))
    share = (np.log(asked) - a[2]) / (b[2] - a[2])
    steps, seconds = np.exp(a[:2] + share * (b[:2] - a[:2]))
    return float(steps), float(seconds)


def _order(points: Sequence[Point], name: str) -> str:
    """Of the last errors that are above what round-off or the truth are wrong by."""
    values = [(p.steps, getattr(p, name)) for p in points if getattr(p, name) > 10 * _ROUND_OFF]
    if len(values) < 2:
        return ""
    (n, a), (m, b) = values[-2:]
    return f"{np.log(a / b) / np.log(m / n):.1f}" if np.isfinite(a * b) else ""


def table_of(system: System, results: dict[str, list[Point]]) -> Table:
    """One row for each scheme."""
    rows, best = [], np.inf
    found = {name: [reached(points, asked) for asked in _ASKED] for name, points in results.items()}
    for name, points in results.items():
        if name == "se1" and points:
            best = found[name][-1][1]
    for name, points in results.items():
        cells = [name, f"{points[-1].iterations}" if points else "none converges"]
        for steps, seconds, mark in found[name]:
            is_known = np.isfinite(steps)
            cells += [f"{mark}{steps:.0f}", f"{mark}{_ms(seconds)}"] if is_known else ["", ""]
        ratio = best / found[name][-1][1]
        cells.append(f"{ratio:.2g}" if np.isfinite(ratio) else "")
        cells += [_order(points, what) for what in ("cost", "motion", "adjoint")]
        rows.append(tuple(cells))
    columns = [f"{what} to {asked:.0e}" for asked in _ASKED for what in ("steps", "ms")]
    orders = ("order of cost", "of motion", "of adjoint")
    return Table(system.name, ("scheme", "iterations", *columns, "se1 / it", *orders), rows)


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g}" if seconds < 1.0 else f"{1e3 * seconds:.0f}"


def measure(system: System, schemes: Sequence[str], levels: int) -> dict[str, list[Point]]:
    """All points of a system; schemes that do not go with it are left out."""
    truth, results = _truth(system, levels), dict[str, list[Point]]()
    for name in schemes:
        if name.startswith("ipopt/"):
            results[name] = rival(system, name, truth, min(levels, _RIVAL_LEVELS))
            continue
        try:
            _problem_with(system, name, system.steps)
        except ProblemError as error:
            print(f"{system.name}: without {name}: {error}", flush=True)
        else:
            results[name] = sweep(system, name, truth, levels)
    return results


def draw(system: System, results: dict[str, list[Point]], folder: Path) -> Path:
    """Errors over time on logarithms, a line for each scheme."""
    from matplotlib.ticker import LogLocator, NullFormatter

    from mbocp.view.figures.style import finish_axes, house_style, line_style, new_figure, save_figure

    with house_style():
        figure = new_figure(10.0, 4.2)
        panels = figure.subplots(1, 3)
        titles = (
            "error of the cost, relative",
            "error of the motion [rad, m]",
            "error of the adjoint, relative",
        )
        for panel, name, title in zip(panels, ("cost", "motion", "adjoint"), titles, strict=True):
            for i, (scheme, points) in enumerate(results.items()):
                shown = [p for p in points if np.isfinite(getattr(p, name))]
                if shown:
                    xs, ys = [1e3 * p.seconds for p in shown], [getattr(p, name) for p in shown]
                    panel.loglog(xs, ys, marker=".", label=scheme, **line_style(i)._asdict())
            finish_axes(panel, title=title, ylabel="", xlabel="time of the solver [ms]")
            panel.xaxis.set_major_locator(LogLocator())
            panel.xaxis.set_minor_formatter(NullFormatter())
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=7)
        figure.suptitle(system.name)
        return save_figure(figure, folder / f"{system.name}.png")


def _chosen(names: Sequence[str]) -> Iterator[System]:
    known = {system.name: system for system in SYSTEMS}
    for name in names or known:
        if name not in known:
            raise SystemExit(f"--systems: got {name!r}; there are {', '.join(known)}")
        yield known[name]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table for each system, and draw its diagrams."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.work_precision", description=__doc__.split("\n")[0]
    )
    parser.add_argument("--systems", nargs="*", default=(), help="names; all, if there are none")
    parser.add_argument("--schemes", nargs="*", help="as se1, gauss2/stages, ipopt/gauss2/stages")
    parser.add_argument("--levels", type=int, default=_LEVELS, help="how often steps are doubled, and one")
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--plot", type=Path, help="a folder for the diagrams")
    options = parser.parse_args(arguments)
    one_core()
    show(header(), markdown=options.markdown)
    for system in _chosen(options.systems):
        results = measure(system, options.schemes or (*SCHEMES, *_RIVALS), options.levels)
        show(table_of(system, results), markdown=options.markdown)
        if options.plot:
            options.plot.mkdir(parents=True, exist_ok=True)
            print(draw(system, results, options.plot))


if __name__ == "__main__":
    main()
