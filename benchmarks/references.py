r"""`python -m benchmarks.references`: optimal costs in continuous time, by two schemes that agree on them.

A problem is solved with N, 2 N, 4 N, ... equal steps. With controls that are constant in each step, and with
schemes that are symmetric in time, costs have an expansion in even powers of the step,

.. math:: J_h = J + a_1 h^2 + a_2 h^4 + \ldots,

where the optimum is smooth; so Romberg's table takes a power of h^2 away in each column. Schemes of no
symmetry take powers one by one from the second on, or from the first where explicit schemes integrate a cost
that differs between start and end, since they take it at the begin of each step. The last entries of its
diagonal tell how many digits it has; two schemes, which agree in nothing but the limit, tell whether to
believe it. A scheme may say how its controls vary in a step, as `gauss2/stages`.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.newton import EXAMPLES
from benchmarks.tables import Table, present, show
from benchmarks.work_precision import SYSTEMS
from mbocp.integrators import CONTROLS, PAIRS, cost_order
from mbocp.problem import Problem
from mbocp.problem.integration import AUTO_SCHEME

__all__ = [
    "CASES",
    "Reference",
    "ReferenceCase",
    "accuracy_table",
    "limit_of",
    "reference_of",
    "reference_table",
    "steps_table",
]

_ROOT = Path(__file__).parent.parent
_DOCS = _ROOT / "benchmarks" / "measured" / "references.md"
_BEGIN = "<!-- tables: python -m benchmarks.references --docs -->"
_FIRST, _MOST = 5, 12_000  # steps that are tried
_TO, _TO_EQUAL = 0.05, 0.003  # of their number
_TRIES = 12  # numbers of equal steps, each from the errors of those before
_SMALL = 3  # joints, beyond which functions of three stages take minutes to compile
_DATA = _ROOT / "tests" / "data" / "reference_costs.json"


@dataclass(frozen=True)
class ReferenceCase:
    """A problem file with changes, and how its limit is found.

    Attributes
    ----------
    name : str
        In the table, and in the data of the tests.
    file : str
    schemes : tuple of str
        Two, of which the first is believed.
    steps : int
        With which the tables begin.
    levels : int
        Rows of the tables.
    settings : tuple of str
    first : int
        Power of the step with which errors of schemes without symmetry begin.
    """

    name: str
    file: str
    schemes: tuple[str, str]
    steps: int
    levels: int = 5
    settings: tuple[str, ...] = ()
    first: int = 2


@dataclass(frozen=True)
class Reference:
    """Limits of two schemes, and what each believes to be wrong by."""

    costs: tuple[float, float]
    errors: tuple[float, float]

    @property
    def cost(self) -> float:
        """The limit of the scheme that is surer."""
        return self.costs[self.errors.index(min(self.errors))]

    @property
    def error(self) -> float:
        """Share of the cost by which they differ, or are unsure."""
        between = abs(self.costs[0] - self.costs[1])
        return max(between, min(self.errors)) / abs(self.cost)


_UNLIMITED = ("limits.effort=[1000, 1000]",)  # limits that act would leave nothing smooth
_GAUSS, _LOBATTO = ("gauss3", "gauss2"), ("lobatto3", "lobatto2")
CASES = (
    ReferenceCase("elastic_pendulum", "paper/elastic_pendulum", _GAUSS, 40),
    ReferenceCase("rigid_pendulum", "paper/rigid_pendulum", _LOBATTO, 20),
    ReferenceCase("cart_pendulum_rigid", "paper/cart_pendulum_rigid", _LOBATTO, 80),
    ReferenceCase("cart_pendulum_elastic", "paper/cart_pendulum_elastic", _GAUSS, 80),
    ReferenceCase("cart_pole", "optima/cart_pole", _GAUSS, 80),
    ReferenceCase("two_carts", "optima/two_carts", _GAUSS, 20),
    ReferenceCase("drone_flip", "free_flyer/drone_flip", ("midpoint", "rk4"), 80),
    ReferenceCase("ur5_reach", "arms/ur5_reach", ("gauss2", "midpoint"), 200, 4),
    ReferenceCase("panda_reach", "arms/panda_reach", ("gauss2", "midpoint"), 800, 4),
    ReferenceCase("payload", "arms/payload", ("gauss2", "midpoint"), 100, 4),
    ReferenceCase("kinova_reach", "arms/kinova_reach", ("midpoint", "gauss2/stages"), 400, 4),
    ReferenceCase("reach_pose", "arms/reach_pose", ("gauss2", "midpoint"), 100),
    ReferenceCase("via_points", "arms/via_points", ("gauss2", "midpoint"), 80),
    ReferenceCase("cup", "arms/cup", ("gauss2", "midpoint"), 80),
    ReferenceCase("two_arms", "worlds/two_arms", ("gauss2", "midpoint"), 80),
    ReferenceCase("round_trip", "free_flyer/round_trip", ("midpoint", "rk4"), 60),
    ReferenceCase("four_bar", "loops/four_bar", _LOBATTO, 100),
    ReferenceCase("five_bar", "loops/five_bar", _LOBATTO, 50),
    ReferenceCase("slider_crank", "loops/slider_crank", _LOBATTO, 100, 4),
    ReferenceCase("parallelogram_arm", "loops/parallelogram_arm", _LOBATTO, 50),
    ReferenceCase("stewart", "loops/stewart", ("midpoint", "lobatto2"), 25),
    ReferenceCase("delta", "loops/delta", ("midpoint", "lobatto2"), 50, 4),
    # Its limit of the position begins and ends to act at thirds of the time.
    ReferenceCase("bryson_denham", "optima/bryson_denham", ("gauss2", "midpoint"), 60),
    ReferenceCase("unicycle", "so3/unicycle_pendulum", ("rkf5", "heun"), 200, 5, _UNLIMITED, first=1),
)


def limit_of(costs: Sequence[float], *, is_symmetric: bool, first: int = 2) -> tuple[float, float]:
    """Limit of costs with N, 2 N, 4 N, ... steps, and what it may be wrong by.

    Parameters
    ----------
    costs : sequence of float
    is_symmetric : bool
        Whether errors have even powers of the step alone.
    first : int
        The power with which other errors begin.
    """
    diagonal, row = [costs[0]], [costs[0]]
    for k, cost in enumerate(costs[1:], start=1):
        new = [cost]
        for j in range(1, k + 1):
            factor = 2.0 ** (2 * j if is_symmetric else j + first - 1) - 1.0
            new.append(new[j - 1] + (new[j - 1] - row[j - 1]) / factor)
        row = new
        diagonal.append(row[-1])
    changes = [abs(b - a) for a, b in pairwise(diagonal)]
    best = min(range(len(changes)), key=changes.__getitem__)
    return diagonal[best + 1], changes[best]


def reference_of(case: ReferenceCase) -> Reference:
    """Limits by both schemes."""
    found = [
        limit_of(
            list(_costs(case, scheme)),
            is_symmetric=scheme == "midpoint" or scheme.partition("/")[0] in PAIRS,
            first=case.first,
        )
        for scheme in case.schemes
    ]
    return Reference((found[0][0], found[1][0]), (found[0][1], found[1][1]))


def _costs(case: ReferenceCase, scheme: str) -> Iterator[float]:
    before = None
    name, _, controls = scheme.partition("/")
    settings = (*case.settings, f"integrator.scheme={name}", f"horizon.controls={controls or 'constant'}")
    problem = mbocp.load_problem(EXAMPLES / f"{case.file}.toml", settings)
    for level in range(case.levels):
        before = mbocp.solve(problem.with_(num_steps=case.steps * 2**level), warm_start=before, check=True)
        yield before.cost


def reference_table(
    cases: Sequence[ReferenceCase] = CASES, *, told: bool = False
) -> tuple[Table, dict[str, dict[str, float]]]:
    """Table of all, and the numbers as data."""
    rows, data = [], {}
    for case in cases:
        found = reference_of(case)
        # Twelve digits are told.
        error = max(float(f"{found.error:.1e}"), 1e-12)
        data[case.name] = {"cost": float(f"{found.cost:.12g}"), "error": error}
        rows.append(
            (case.name, *case.schemes, *(f"{cost:.12g}" for cost in found.costs), f"{found.error:.1e}")
        )
        if told:
            print(*rows[-1], flush=True)
    columns = ("system", "scheme", "and", "limit of the costs", "of the other", "differ by")
    return Table("Optimal costs in continuous time", columns, rows), data


def accuracy_table(asked: float, names: Sequence[str] = ()) -> Table:
    """What `horizon.accuracy` comes to by the scheme that suits, and equal steps with the same error.

    Times are those of the processor: of the whole search, and of one solve with equal steps from the first
    guess, functions from the cache.
    """
    known, rows = json.loads(_DATA.read_text(encoding="utf-8")), []
    for system in SYSTEMS:
        for controls in ("constant", "stages"):
            if names and system.name not in names:
                continue
            problem = system.problem.with_(integrator={"scheme": AUTO_SCHEME}).with_(controls=controls)
            rows.append(
                (system.name, problem.scheme, controls, *_searched(problem, known[system.name], asked))
            )
            print(*rows[-1], flush=True)
    columns = (
        "system", "scheme", "controls", "steps", "rounds", "estimate", "true error", "local error",
        "time [s]", "equal steps", "their error", "time [s]",
    )  # fmt: skip
    return Table(f"horizon.accuracy = {asked:g}", columns, rows)


def _searched(problem: Problem, known: dict[str, float], asked: float) -> tuple[str, ...]:
    """Steps that are found and equal ones that come to the same, with their errors and times."""
    found, seconds = _timed(problem.with_(accuracy=asked))
    error = abs(found.cost / known["cost"] - 1.0)
    told = found.accuracy
    cells = (
        f"{found.num_steps}" if found.converged else f"{found.num_steps}, {found.status.value}",
        f"{told.rounds}",
        *(f"{value:.1e}" for value in (told.cost_error, error)),
        f"{told.local_error:.0e}",
        f"{seconds:.1f}",
    )
    wanted = max(error, told.cost_error)  # errors may happen to cancel
    count, of_equal = _fewest_equal(problem, known["cost"], wanted, found)
    _, taken = _timed(problem.with_(num_steps=count))
    return *cells, f"{count}" if of_equal <= wanted else f"> {count}", f"{of_equal:.1e}", f"{taken:.1f}"


def _fewest_equal(problem: Problem, limit: float, wanted: float, near: mbocp.Solution) -> tuple[int, float]:
    """Fewest equal steps whose cost is so accurate, to three in a thousand, and what it is wrong by."""
    order = cost_order(problem.controls, problem.scheme)
    count, low, high, found = near.num_steps, 0, _MOST + 1, dict[int, float]()
    for _ in range(_TRIES):
        if count in found or not low < count < high:
            count = round((max(low, 1) * high) ** 0.5)
        equal = mbocp.solve(problem.with_(num_steps=count), warm_start=near, accuracy=False)
        found[count] = abs(equal.cost / limit - 1.0) if equal.is_stationary else np.inf
        low, high = (low, count) if found[count] <= wanted else (count, high)
        if low == _MOST or high - low <= max(1, round(_TO_EQUAL * high)):
            break
        ratio = found[count] / wanted if np.isfinite(found[count]) else 2.0**order
        count = int(np.clip(round(count * ratio ** (1.0 / order)), low + 1, min(high - 1, _MOST)))
    return (high, found[high]) if high in found else (low, found[low])


def _timed(problem: Problem) -> tuple[mbocp.Solution, float]:
    """A solution, and the processor time that it took where its functions are known [s]."""
    mbocp.solve(problem.with_(accuracy=None, num_steps=problem.num_steps), accuracy=True)
    begun = time.process_time()
    return mbocp.solve(problem), time.process_time() - begun


def steps_table(asked: float, cases: Sequence[ReferenceCase] = CASES) -> Table:
    """How many equal steps have costs so accurate, with controls that vary within them or do not.

    Numbers of steps are found to five percent; an order is that between the last two doublings.
    """
    known, rows = json.loads(_DATA.read_text(encoding="utf-8")), []
    for case in cases:
        problem = mbocp.load_problem(EXAMPLES / f"{case.file}.toml", case.settings)
        if problem.duration_range is not None or problem.robot.drives:
            continue
        loops = bool(problem.robot.nc)
        schemes = ["lobatto3"] if loops else ["gauss2", *(["gauss3"] if problem.robot.nv <= _SMALL else [])]
        for scheme in schemes:
            found = [
                _fewest(
                    problem.with_(scheme=scheme, controls=kind), case.steps, known[case.name]["cost"], asked
                )
                for kind in CONTROLS
            ]
            rows.append((case.name, scheme, *(cell for count, order in found for cell in (count, order))))
    columns = ("system", "scheme", *(word for kind in CONTROLS for word in (kind, "order")))
    return Table(f"Equal steps to {asked:g} of the cost", columns, rows)


def _fewest(problem: Problem, steps: int, limit: float, asked: float) -> tuple[str, str]:
    """Steps with which the cost is so accurate, and the order there; dashes where the motion is another."""
    before = mbocp.solve(problem.with_(num_steps=steps), check=True, accuracy=False)
    count, errors = _FIRST, dict[int, float]()
    while count <= _MOST:
        found = mbocp.solve(problem.with_(num_steps=count), warm_start=before, accuracy=False)
        if found.is_stationary:
            errors[count] = abs(found.cost / limit - 1.0)
            if errors[count] <= asked:
                break
        count *= 2
    tried = sorted(errors)
    if not tried or errors[tried[-1]] > asked:
        return "-", "-"
    order = np.log2(errors[tried[-2]] / errors[tried[-1]]) if len(tried) > 1 else np.nan
    low, high = tried[-2] if len(tried) > 1 else 1, tried[-1]
    while high - low > max(1, round(_TO * high)):
        middle = round((low * high) ** 0.5) if high - low > 2 else low + 1
        found = mbocp.solve(problem.with_(num_steps=middle), warm_start=before, accuracy=False)
        is_enough = found.is_stationary and abs(found.cost / limit - 1.0) <= asked
        low, high = (low, middle) if is_enough else (middle, high)
    return str(high), f"{order:.1f}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, put it into the documentation, or write the data of the tests."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.references", description=__doc__.split("\n")[0]
    )
    parser.add_argument("--docs", action="store_true", help=f"write the table into measured/{_DOCS.name}")
    parser.add_argument("--data", action="store_true", help=f"write the numbers into tests/data/{_DATA.name}")
    parser.add_argument("--accuracy", type=float, help="how many steps it takes to have costs so accurate")
    parser.add_argument("--controls", type=float, help="the same by how controls vary within a step")
    parser.add_argument("names", nargs="*", help="of the systems; all, if there are none")
    options = parser.parse_args(arguments)
    one_core()
    cases = [case for case in CASES if not options.names or case.name in options.names]
    if options.accuracy is not None:
        show(accuracy_table(options.accuracy, options.names), markdown=True)
        return
    if options.controls is not None:
        show(steps_table(options.controls, cases), markdown=True)
        return
    table, data = reference_table(cases, told=True)
    present([header(), table], _DOCS, _BEGIN, into_page=options.docs)
    if options.data:
        kept = json.loads(_DATA.read_text(encoding="utf-8")) if options.names else {}
        _DATA.write_text(json.dumps(kept | data, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
