"""Problems whose optimum is known, beside what mbocp finds: `python -m benchmarks.optima`."""

from __future__ import annotations

import argparse
import runpy
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mbocp
from benchmarks.machine import header
from benchmarks.tables import Table, present

__all__ = ["CASES", "Optimum", "optima_table"]

_EXAMPLES = Path(__file__).parent.parent / "examples" / "optima"
_DOCS = Path(__file__).parent / "measured" / "optima.md"
_BEGIN = "<!-- tables: python -m benchmarks.optima --docs -->"


@dataclass(frozen=True)
class Optimum:
    """A problem file, or a script with a function `problem`, and the value of its optimum.

    Attributes
    ----------
    name : str
        Of the file in examples/optima.
    value : float
        Known cost of the optimum.
    tolerance : float
        Relative difference that is allowed, of the finest solution or of what it is extrapolated to.
    steps : tuple of int
        Numbers of steps, coarse to fine.
    order : int
        Order in which the cost converges, where its optimum is smooth enough for an extrapolation; else 0.
    """

    name: str
    value: float
    tolerance: float
    steps: tuple[int, ...]
    order: int = 0

    def solve(self, steps: int) -> mbocp.Solution:
        """Solve it with a number of steps."""
        script = _EXAMPLES / f"{self.name}.py"
        if script.exists():  # where a term is a function of its own
            return mbocp.solve(runpy.run_path(str(script))["problem"](steps))
        return mbocp.solve(mbocp.load_problem(_EXAMPLES / f"{self.name}.toml", {"horizon.steps": steps}))

    def extrapolated(self, costs: Sequence[float]) -> float:
        """Cost for steps of length zero, from the last two, each with half the steps of the one before."""
        factor = 2**self.order
        return (factor * costs[-1] - costs[-2]) / (factor - 1) if self.order else costs[-1]


CASES = (
    Optimum("bryson_denham", 4.0, 1e-6, (180, 360), order=2),
    Optimum("cart_pole", 58.80767, 1e-6, (100, 200), order=2),
    Optimum("free_flyer", 7.910, 1e-4, (240, 480)),
    Optimum("two_carts", 20.0, 1e-8, (50, 100)),
    Optimum("brachistochrone", 0.824759143157, 1e-6, (100, 200), order=2),
    Optimum("reorientation", 28.6304, 1e-4, (240, 480)),
)


def optima_table() -> Table:
    """Cost of each, its extrapolation, and how far that is from the known value."""
    rows = []
    for case in CASES:
        found = [case.solve(steps) for steps in case.steps]
        last = case.extrapolated([s.cost for s in found])
        rows.append(
            (
                case.name,
                f"{case.value:.9g}",
                " / ".join(map(str, case.steps)),
                " / ".join(str(s.iterations) for s in found),
                f"{found[-1].cost:.9g}",
                f"{last:.9g}" if case.order else "",
                f"{last / case.value - 1:.1e}",
            )
        )
    columns = ("problem", "known", "steps", "iterations", "finest", "extrapolated", "relative difference")
    return Table("Known optima", columns, rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, or put it into the documentation."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.optima", description=__doc__)
    parser.add_argument("--docs", action="store_true", help=f"rewrite the tables of {_DOCS.name}")
    options = parser.parse_args(arguments)
    tables = [header(), optima_table()]
    present(tables, _DOCS, _BEGIN, into_page=options.docs)


if __name__ == "__main__":
    main()
