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
- The rival is CasADi with IPOPT by Gauss collocation (`benchmarks.collocation`), from the same guess. Its
  functions are interpreted: a C compiler takes minutes for those of a Panda or a drone, for each number of
  steps. What it takes without its functions is told, too, and is less than any compiled ones would take.

Times are those of solvers alone, with functions from the cache, the least of a few. Each point is a line of
JSON as soon as it is known; what is there already is not measured again. A scheme of a system that has taken
longer than the limit is left where it is, and that is told.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

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

__all__ = ["SYSTEMS", "Log", "Point", "System", "main", "measure", "reached", "sweep"]

_DATA = Path(__file__).parent.parent / "tests" / "data" / "reference_costs.json"
_OUT = Path("build/work_precision.jsonl")
_ASKED = (1e-4, 1e-6)
_LEVELS = 6
_FEW = 3  # solves, of which the fastest counts
_ROUND_OFF = 1e-11  # of a cost: below it there is nothing to see
_FALLS = 1.2  # ratio of errors with twice the steps, below which they do not fall
_NEXT = 2.0**4 - 1.0  # of Richardson's extrapolation at order four
_LIMIT = 20.0  # [s] of a scheme and a system, compiling aside
_GROWTH = 2.0  # of times from one number of steps to the next, at least
_LONG = 3.0  # [s]: solves that are not repeated
_RIVALS = ("ipopt/gauss2", "ipopt/gauss2/stages")
FEW_SCHEMES = ("se1", "midpoint", "gauss2", "gauss2/stages", "lobatto3", "lobatto3/stages", "rk4", *_RIVALS)
SCHEMES = (
    *TAU,
    *PAIRS,
    *(f"{name}/stages" for name, pair in PAIRS.items() if pair.num_stages > 1),
    "gauss2/linear",
    "lobatto3/linear",
    *(name for name in TABLEAUX if name != "euler"),
    *_RIVALS,
    "ipopt/gauss3/stages",
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
    """A solve: its time [s], and errors of the cost (a part of it), the motion [rad, m] and the adjoints.

    Of one that does not converge all but the number of steps is NaN. `functions` is the part of the time that
    a rival's functions take [s], and `spent` what the measurement took [s].
    """

    steps: int
    seconds: float
    iterations: int
    cost: float
    motion: float
    adjoint: float
    functions: float = 0.0
    spent: float = 0.0

    @classmethod
    def failed(cls, steps: int, spent: float) -> Point:
        """One that did not converge."""
        return cls(steps, math.nan, 0, math.nan, math.nan, math.nan, spent=spent)


class Log:
    """Points that are known, one line of JSON for each.

    Parameters
    ----------
    path : Path, optional
        None: they are kept in memory alone.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path, self._known = path, dict[tuple[str, str, int], Point]()
        for line in path.read_text(encoding="utf-8").splitlines() if path and path.exists() else ():
            row = json.loads(line)
            if "scheme" in row:
                point = Point(**row["point"])
                self._known[row["system"], row["scheme"], point.steps] = point

    def get(self, system: str, scheme: str, steps: int) -> Point | None:
        """The point, if it is known."""
        return self._known.get((system, scheme, steps))

    def add(self, system: str, scheme: str, point: Point) -> None:
        """Keep a point."""
        self._known[system, scheme, point.steps] = point
        self.write({"system": system, "scheme": scheme, "point": asdict(point)})

    def write(self, row: Mapping[str, Any]) -> None:
        """Append a line."""
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")


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


def sweep(
    system: System,
    scheme: str,
    truth: Callable[[], _Truth],
    log: Log,
    *,
    levels: int = _LEVELS,
    limit: float = _LIMIT,
) -> list[Point]:
    """Points of a scheme or a rival, from the fewest steps on; of those that do not converge there is none.

    Parameters
    ----------
    truth : callable
        Asked where a point is not known yet.
    limit : float
        Of what all points may take [s].
    """
    one = _rival if scheme.startswith("ipopt/") else _own
    points, spent, last = [], 0.0, 0.0
    for steps in (system.steps * 2**k for k in range(levels)):
        point = log.get(system.name, scheme, steps)
        if point is None and spent + _GROWTH * last > limit:
            words = f"{steps} steps and more would take over {limit:g} s"
            print(f"{system.name}: {scheme}: {words}; --limit", flush=True)
            log.write({"system": system.name, "left out": f"{scheme}: {words}"})
            break
        if point is None:
            point = one(system, scheme, steps, truth(), limit)
            log.add(system.name, scheme, point)
        last, spent = point.spent, spent + point.spent
        points += [point] if np.isfinite(point.cost) else []
    return points


def _own(system: System, scheme: str, steps: int, truth: _Truth, limit: float) -> Point:
    """A solve by mbocp; the first takes functions from the cache or compiles them, and is not timed."""
    problem = _problem_with(system, scheme, steps)
    first = mbocp.solve(problem)
    if not first.converged:
        return Point.failed(steps, _seconds(first))
    last = mbocp.solve(problem)
    times = [_seconds(last)]
    times += [_seconds(mbocp.solve(problem)) for _ in range(_FEW - 1 if times[0] < _LONG else 0)]
    errors = truth.errors(problem.robot, last.cost, last.qs, _adjoints(problem.robot, last))
    return Point(steps, min(times), last.iterations, *errors, spent=sum(times))


def _seconds(solution: mbocp.Solution) -> float:
    return float(sum(phase.wall_time_s for phase in solution.phases))


def _rival(system: System, name: str, steps: int, truth: _Truth, limit: float) -> Point:
    """A solve by CasADi with IPOPT, from mbocp's first guess."""
    begun = time.perf_counter()
    _, scheme, *more = name.split("/")
    problem = _problem_with(system, "lobatto2" if system.problem.robot.nc else "midpoint", steps)
    formulation = formulate(problem)
    guess, _ = make_guess(guess_candidates(problem)[0], formulation)
    begin = formulation.motion_of(guess)
    num_stages = PAIRS[scheme].num_stages
    solver = Collocation(problem, num_stages, at_stages=bool(more), is_compiled=False, limit=limit)
    found = solver.solve(begin)
    for _ in range(_FEW - 1 if found.seconds < _LONG else 0):
        found = min(found, solver.solve(begin), key=lambda f: f.seconds)
    spent = time.perf_counter() - begun
    if not found.converged:
        return Point.failed(steps, spent)
    errors = truth.errors(problem.robot, found.cost, found.qs, None)
    return Point(steps, found.seconds, found.iterations, *errors, functions=found.functions, spent=spent)


def reached(points: Sequence[Point], asked: float) -> tuple[float, float, str]:
    """Steps and seconds to an error of the cost, interpolated on logarithms, and "~", "<" or ""."""
    if not points:
        return np.nan, np.nan, ""
    if points[-1].cost > asked:
        if len(points) < 2 or points[-2].cost <= _FALLS * points[-1].cost:
            return np.nan, np.nan, ""  # another minimum: no more steps lead there
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
        seconds = found[name][-1][1]
        ratio, share = best / seconds, _share_of_functions(points)
        cells.append(f"{ratio:.2g}" if np.isfinite(ratio) and np.isfinite(seconds) else "")
        cells.append(_ms((1.0 - share) * seconds) if share and np.isfinite(seconds) else "")
        cells += [_order(points, what) for what in ("cost", "motion", "adjoint")]
        rows.append(tuple(cells))
    columns = [f"{what} to {asked:.0e}" for asked in _ASKED for what in ("steps", "ms")]
    orders = ("order of cost", "of motion", "of adjoint")
    return Table(
        system.name, ("scheme", "iterations", *columns, "se1 / it", "ms without functions", *orders), rows
    )


def _share_of_functions(points: Sequence[Point]) -> float:
    """Part of a rival's time that its functions take, of its finest steps; 0 where they are compiled."""
    return points[-1].functions / points[-1].seconds if points else 0.0


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g}" if seconds < 1.0 else f"{1e3 * seconds:.0f}"


def measure(
    system: System, schemes: Sequence[str], levels: int, log: Log, limit: float = _LIMIT
) -> dict[str, list[Point]]:
    """All points of a system; schemes that do not go with it are left out."""
    truth, results = cache(lambda: _truth(system, levels)), dict[str, list[Point]]()
    for name in schemes:
        try:
            if not name.startswith("ipopt/"):
                _problem_with(system, name, system.steps)
        except ProblemError as error:
            print(f"{system.name}: without {name}: {error}", flush=True)
        else:
            results[name] = sweep(system, name, truth, log, levels=levels, limit=limit)
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
    parser.add_argument("--schemes", nargs="*", help="as se1, gauss2/stages, ipopt/gauss2/stages; else a few")
    parser.add_argument("--all", action="store_true", help="all schemes: an hour in place of a quarter")
    parser.add_argument("--levels", type=int, default=_LEVELS, help="how often steps are doubled, and one")
    parser.add_argument("--limit", type=float, default=_LIMIT, help="[s] of a scheme and a system")
    parser.add_argument("--out", type=Path, default=_OUT, help="lines of JSON, from which it goes on")
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--plot", type=Path, help="a folder for the diagrams")
    options = parser.parse_args(arguments)
    one_core()
    machine, log = header(), Log(options.out)
    show(machine, markdown=options.markdown)
    log.write({"machine": dict(machine.rows)})
    schemes = options.schemes or (SCHEMES if options.all else FEW_SCHEMES)
    for system in _chosen(options.systems):
        results = measure(system, schemes, options.levels, log, options.limit)
        show(table_of(system, results), markdown=options.markdown)
        if options.plot:
            options.plot.mkdir(parents=True, exist_ok=True)
            print(draw(system, results, options.plot))


if __name__ == "__main__":
    main()
