"""`python -m benchmarks`: everything but the paper's tables, in less than three minutes."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

from benchmarks.machine import header, one_core
from benchmarks.newton import CASES, iteration_table, scaling_table
from benchmarks.rivals import rival_table
from benchmarks.stages import stage_table
from benchmarks.strategies import GROWTH, growth_table, robot_table
from benchmarks.tables import Table, show

_STEPS = (100, 300, 1000, 3000, 10_000)
_SCALED = ("ur5_reach", "elastic_pendulum")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--strategies", action="store_true", help="the strategies' tables alone")
    options = parser.parse_args(arguments)

    def print_table(table: Table) -> None:
        show(table, markdown=options.markdown)

    clock = time.perf_counter()
    one_core()
    print_table(header())
    if options.strategies:
        for case in GROWTH:
            print_table(growth_table(case)[0])
        print_table(robot_table())
        return
    print_table(iteration_table())
    for case in CASES:
        if case.label in _SCALED:
            print_table(scaling_table(case, _STEPS)[0])
    print_table(stage_table())
    print_table(rival_table())
    if not options.markdown:
        print(
            f"{time.perf_counter() - clock:.0f} s; the paper's tables: python -m benchmarks.paper; the "
            "strategies: python -m benchmarks --strategies"
        )


if __name__ == "__main__":
    main()
