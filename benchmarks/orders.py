r"""Orders that schemes have on systems: `python -m benchmarks.orders`.

Each system is integrated under given constant controls, and solved for its optimum, with N, 2 N and 4 N equal
steps. An order is :math:`\log_2` of the quotient of both differences:

- of the states at the nodes of the coarsest steps, the largest difference [m, rad, and per second];
- of the multipliers of holonomic constraints, their means over the coarsest steps;
- of the cost;
- of the adjoint of the start, the derivative of the cost in states that agree with the constraints.

Under given controls cost and adjoint are those of a running cost and one of the end. Explicit schemes take
running costs at the begin of each step, which is of first order; so theirs is one of the end alone.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import block_diag, null_space

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.newton import EXAMPLES
from benchmarks.tables import Table, present
from mbocp._arrays import Array
from mbocp.formulation import formulate
from mbocp.guesses.make import guess_by_simulation
from mbocp.integrators import SCHEMES, TABLEAUX
from mbocp.problem import Problem
from mbocp.programme import Iterate
from mbocp.programme.kernel import kernel_programme
from mbocp.robot import Robot

__all__ = [
    "SYSTEMS",
    "Found",
    "OrderCase",
    "Orders",
    "Row",
    "by_scheme",
    "order_table",
    "orders_of",
    "rows_of",
]

_PAGE = Path(__file__).parent / "measured" / "orders.md"
_BEGIN = "<!-- tables: python -m benchmarks.orders --docs -->"
_ALL = Path(__file__).with_suffix(".csv")
_TO_ROUND_OFF = 1e-15  # residual of a step in its unit of force
GIVEN = "given"  # controls that are not optimised


@dataclass(frozen=True)
class Found:
    """What converges.

    Attributes
    ----------
    states : ndarray, shape (N + 1, nq + nv)
    multipliers : ndarray, shape (N, nc)
    cost : float
    adjoint : ndarray
        Derivative of the cost in the start, along what the constraints allow.
    """

    states: Array
    multipliers: Array
    cost: float
    adjoint: Array


@dataclass(frozen=True)
class Orders:
    """Measured orders; that of multipliers is NaN where there are none."""

    states: float
    multipliers: float
    cost: float
    adjoint: float


@dataclass(frozen=True)
class OrderCase:
    """A system with its motion under given controls and its optimum.

    Attributes
    ----------
    name : str
    robot : callable
    optimum : callable
        The problem.
    duration : float
        Of the motion under given controls [s].
    u : tuple of float
        These [N, N m]; one number for all.
    v : tuple of float
        Velocity that it begins with; at rest, where it is empty.
    weights : dict
        Its cost.
    rows : tuple of Row
    """

    name: str
    robot: Callable[[], Robot]
    optimum: Callable[[], Problem]
    duration: float
    u: tuple[float, ...]
    v: tuple[float, ...] = ()
    weights: dict[str, float] = field(
        default_factory=lambda: {"effort": 1.0, "velocity": 1.0, "terminal": 1.0}
    )
    rows: tuple[Row, ...] = ()


@dataclass(frozen=True)
class Row:
    """A scheme, how controls vary, the coarsest number of steps, and the order that is expected."""

    scheme: str
    controls: str
    steps: int
    expected: int


def _rows(**steps: tuple[int, ...]) -> tuple[Row, ...]:
    """The coarsest steps of schemes: under given controls, with constant ones, with those at stages."""
    found = []
    for scheme, counts in steps.items():
        own = SCHEMES[scheme].order
        constant = 1 if scheme in TABLEAUX else min(own, 2)
        orders = ((GIVEN, own), ("constant", constant), ("stages", own))
        found += [Row(scheme, kind, n, order) for (kind, order), n in zip(orders, counts, strict=False) if n]
    return tuple(found)


def _example(file: str, *settings: str) -> Callable[[], Problem]:
    return lambda: mbocp.load_problem(EXAMPLES / f"{file}.toml", settings)


def _satellite() -> Robot:
    return mbocp.load_robot(EXAMPLES / "optima/robots/satellite")


def _reorientation() -> Problem:
    robot = _satellite()
    goal = robot.integrate(robot.q0, np.array([0.5, -0.9, 0.4]))
    return Problem.create(robot, 40.0, 10, goal={"q": goal, "v": 0}, cost={"effort": 1.0})


def _swing() -> Problem:
    start, goal = {"q": [0.3, -0.2], "v": [0.1, 0.4]}, {"q": [0.9, 0.4], "v": 0}
    return Problem.create("double_pendulum", 0.6, 10, start=start, goal=goal, cost={"effort": 1.0})


def _hector() -> Robot:
    return mbocp.load_robot("hector", actuated=["root_joint"])


_UNLIMITED = "limits.effort=[1000, 1000]"
SYSTEMS = (
    OrderCase(
        "SO(3): satellite", _satellite, _reorientation, 10.0, (30.0, -40.0, 50.0), (0.1, 0.2, -0.15),
        {"effort": 1.0, "velocity": 1e5, "terminal": 1e5},
        _rows(
            gauss1=(20, 20), gauss2=(5, 20, 5), gauss3=(8, 20, 4), lobatto2=(20, 20, 20),
            lobatto3=(10, 20, 10), midpoint=(20, 20), radau2=(40, 40, 40), radau3=(10, 20, 20),
        ),
    ),
    OrderCase(
        "SE(3): drone", _hector, _example("free_flyer/drone_flip"), 0.4,
        (0.2, 0.0, 14.0, 0.01, 0.02, -0.01), (1.0, 0.0, 0.0, 0.5, 1.0, 2.0),
        rows=_rows(gauss1=(20, 160), gauss2=(60, 160, 480), lobatto2=(20, 160, 480), midpoint=(20, 160)),
    ),
    OrderCase(
        "elastic pendulum", lambda: mbocp.load_robot("elastic_pendulum"), _example("paper/elastic_pendulum"),
        2.0, (1.0, 0.5, 2.0), (0.5, -1.0, 0.3),
        rows=_rows(
            gauss1=(40, 80), gauss2=(5, 40, 40), gauss3=(10, 40, 20), lobatto2=(20, 40, 80),
            lobatto3=(10, 40, 40), midpoint=(40, 80), radau2=(40, 80, 80), radau3=(60, 40, 20),
        ),
    ),
    OrderCase(
        "double pendulum", lambda: mbocp.load_robot("double_pendulum"), _swing, 0.5, (0.5, -0.2), (1.0, -1.0),
        rows=_rows(
            gauss1=(200, 160), gauss2=(100, 160, 160), gauss3=(0, 160, 120), lobatto2=(200, 160, 160),
            lobatto3=(100, 160, 80), midpoint=(200, 160),
        ),
    ),
    OrderCase(
        "UR5", lambda: mbocp.load_robot("ur5"), _example("arms/ur5_reach"), 0.2,
        (1.0, 2.0, -1.0, 0.1, 0.1, 0.1), (0.5, -0.4, 0.3, 0.6, -0.5, 0.4),
        rows=_rows(gauss1=(20, 3200), gauss2=(5, 3200, 800), midpoint=(20, 3200)),
    ),
    OrderCase(
        "four-bar linkage", lambda: mbocp.load_robot("four_bar"), _example("loops/four_bar"), 0.2, (0.5,),
        rows=_rows(lobatto2=(20, 80, 80), lobatto3=(20, 80, 160), midpoint=(20,)),
    ),
    OrderCase(
        "Stewart platform", lambda: mbocp.load_robot("stewart"), _example("loops/stewart"), 0.2,
        (40.0, 60.0, 50.0, 45.0, 55.0, 65.0),
        rows=_rows(lobatto2=(10, 100), midpoint=(10,)),
    ),
    OrderCase(
        "unicycle", lambda: mbocp.load_robot("unicycle_pendulum"),
        _example("so3/unicycle_pendulum", _UNLIMITED), 1.0, (1.5, 0.8), (0.0, 0.0, 1.0, -2.0, 0.5, 0.0),
        {"terminal": 1.0},
        _rows(heun=(80, 800), rk4=(40, 100), rkf5=(30, 100)),
    ),
)  # fmt: skip


def rows_of(names: Sequence[str] = ()) -> Iterator[tuple[OrderCase, Row]]:
    """All rows of systems whose names have one of these words."""
    for case in SYSTEMS:
        if not names or any(word in case.name for word in names):
            yield from ((case, row) for row in case.rows)


def orders_of(case: OrderCase, row: Row) -> Orders:
    """Measured orders of a row."""
    found, before = [], None
    for count in (row.steps, 2 * row.steps, 4 * row.steps):
        if row.controls == GIVEN:
            found.append(_driven(case, row.scheme, count))
            continue
        problem = case.optimum().with_(scheme=row.scheme, controls=row.controls, num_steps=count)
        before = mbocp.solve(problem, warm_start=before, check=True, accuracy=False)
        found.append(_of_solution(problem, before))
    states = [one.states[:: 2**k] for k, one in enumerate(found)]
    multipliers = [one.multipliers.reshape(row.steps, 2**k, -1).mean(axis=1) for k, one in enumerate(found)]
    return Orders(
        _order(states),
        _order(multipliers) if multipliers[0].size else np.nan,
        _order([np.array(one.cost) for one in found]),
        _order([one.adjoint for one in found]),
    )


def _order(values: Sequence[Array]) -> float:
    first, second = (float(np.abs(b - a).max()) for a, b in pairwise(values))
    return float(np.log2(first / second)) if second > 0.0 else np.inf


def _driven(case: OrderCase, scheme: str, count: int) -> Found:
    """The motion under given controls: cost and adjoint by the kernel's adjoint sweep."""
    robot, words = case.robot(), dict[str, Any]()
    if case.v:
        words["start"] = {"v": np.array(case.v)}
    problem = Problem.create(
        robot,
        case.duration,
        count,
        goal={"v": np.zeros(robot.nv), "enforce": "penalty"},
        cost=case.weights,
        scheme=scheme,
        **words,
    )
    formulation = formulate(problem)
    programme = formulation.programme
    iterate = guess_by_simulation(formulation, np.resize(case.u, robot.nu), tolerance=_TO_ROUND_OFF)
    native = kernel_programme(programme, sweeps=True)
    iterate.load_into(native)
    cost = native.gradient().cost
    iterate = Iterate.read_from(native, programme)
    motion = formulation.motion_of(iterate)
    lams = formulation.duals_of(iterate, motion).lams
    size = 2 * robot.nv if not robot.drives else formulation.layout.nw + len(robot.speed_labels)
    adjoint = _first_adjoint(formulation.programme, iterate)[:size]
    return Found(
        np.hstack([motion.qs, motion.vs]),
        lams,
        cost,
        _allowed(robot, motion.qs[0], np.eye(robot.nv)).T @ adjoint if robot.nc else adjoint,
    )


def _first_adjoint(programme: Any, iterate: Iterate) -> Array:
    """Derivative of the cost in the first state, whose motion follows: that of the Lagrangian."""
    first = (iterate.xs[0], iterate.xs[1], iterate.ys[0], iterate.us[0])
    rho = programme.rho.reshape(programme.num_steps, -1)[0]
    function = programme.functions.with_name("jacobian").function("jacobian")
    _, _, by_rows, by_cost = (np.asarray(out.full()) for out in function(*first, programme.theta, rho))
    kind = programme.kind
    at = slice(kind.ndx + kind.ny, 2 * kind.ndx + kind.ny)
    found: Array = by_cost.ravel()[at] + by_rows[:, at].T @ iterate.ms[0]
    return found


def _of_solution(problem: Problem, solution: mbocp.Solution) -> Found:
    robot, adjoint = problem.robot, solution.mus[0]
    if robot.nc:
        adjoint = _allowed(robot, problem.q_start, robot.mass_matrix(problem.q_start)).T @ adjoint
    return Found(np.hstack([solution.qs, solution.vs]), solution.lams, solution.cost, adjoint)


def _allowed(robot: Robot, q: Array, mass: Array) -> Array:
    """Tangents of states at rest that agree with the constraints; second parts times `mass`."""
    along = null_space(robot.constraint_jacobian(q))
    found: Array = block_diag(along, mass @ along)
    return found


def order_table(names: Sequence[str] = (), *, told: bool = False) -> Table:
    """One row for each system, scheme and kind of controls."""
    made = []
    for case, row in rows_of(names):
        found = orders_of(case, row)
        values = (found.states, found.multipliers, found.cost, found.adjoint)
        cells = (f"{value:.2f}" if np.isfinite(value) else "" for value in values)
        made.append((case.name, row.scheme, row.controls, f"{row.steps}", f"{row.expected}", *cells))
        if told:
            print(*made[-1], sep="  ", flush=True)
    columns = (
        "system",
        "scheme",
        "controls",
        "from steps",
        "expected",
        "states",
        "multipliers",
        "cost",
        "adjoint",
    )
    return Table("Orders measured", columns, made)


def by_scheme(rows: Sequence[tuple[str, ...]]) -> Table:
    """One row for each scheme and kind of controls: the least and the largest order on all systems."""
    orders: dict[tuple[str, str, str], list[float]] = {}
    for _, scheme, controls, _, expected, *found in rows:
        orders.setdefault((scheme, controls, expected), []).extend(float(cell) for cell in found if cell)
    made = [(*key, f"{min(some):.2f}", f"{max(some):.2f}") for key, some in sorted(orders.items())]
    return Table("Orders measured", ("scheme", "controls", "expected", "least", "largest"), made)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables, or put them into the measured ones and all rows into a file beside this one."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.orders", description=__doc__.split("\n")[0])
    written = f"write into measured/{_PAGE.name} and {_ALL.name}"
    parser.add_argument("--docs", action="store_true", help=written)
    parser.add_argument("names", nargs="*", help="words of the systems' names; all, if there are none")
    options = parser.parse_args(arguments)
    one_core()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # coarse steps are told to be coarse
        table = order_table(options.names, told=True)
    if options.docs:
        table.to_csv(_ALL)
    present([header(), by_scheme(table.rows)], _PAGE, _BEGIN, into_page=options.docs)


if __name__ == "__main__":
    main()
