"""Time of an iteration with parameters and without, over the steps: `python -m benchmarks.parameters`.

Both are linear in the number of steps; a parameter is one more entry of states and controls.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import mbocp

EXAMPLE = Path(__file__).parents[1] / "examples" / "design" / "counterweight.toml"


def seconds_an_iteration(problem: mbocp.Problem, repeats: int) -> float:
    """Return the least time of an iteration of the solver [s]."""
    found = []
    for _ in range(repeats):
        solution = mbocp.solve(problem)
        spent = sum(p.wall_time_s for p in solution.phases if p.iterations)
        found.append(spent / solution.iterations)
    return min(found)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, nargs="+", default=[50, 100, 200, 400, 800])
    parser.add_argument("--repeats", type=int, default=5)
    asked = parser.parse_args()
    begun = time.perf_counter()
    print("| steps | ms an iteration | without parameters |\n|---|---|---|")
    for steps in asked.steps:
        problem = mbocp.load_problem(EXAMPLE, {"horizon.steps": steps})
        plain = problem.with_(parameter=[])
        times = [1e3 * seconds_an_iteration(p, asked.repeats) for p in (problem, plain)]
        print(f"| {steps} | {times[0]:.2f} | {times[1]:.2f} |", flush=True)
    print(f"in {time.perf_counter() - begun:.0f} s")
