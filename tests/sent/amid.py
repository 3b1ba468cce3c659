"""Stops and replans from an instant of a motion as it is sent: `python -m tests.sent.amid --replan`."""

from __future__ import annotations

import argparse
import sys
import tempfile
import warnings
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

import mbocp
from mbocp.exceptions import MbocpError
from mbocp.problem import Problem
from mbocp.solution.curves import Curves
from mbocp.solution.sent import compute_motion_sent
from tests.sent.cases import JERK, PROFILES, RATES, ROBOTS, problem_of
from tests.sent.reader import limits_of, samples_of, violation_of_points, violation_of_samples
from tests.sent.rows import add_options, rows_of

_KEPT = 1e-6  # of a limit


def row_of(name: str, seed: int, folder: Path, *, is_stop: bool) -> dict[str, Any]:
    """A stop, or the rest of a motion solved again, from an instant of it as it is sent: written, read."""
    limits, rng = limits_of(PROFILES / f"{name}.toml"), np.random.default_rng(seed)
    if name == "ur5e":
        limits |= {
            kind: np.array([[-x] * 6, [x] * 6]) for kind, x in (("acceleration", 15.0), ("jerk", JERK))
        }
    problem, sent = _plan(name, seed)
    at = rng.uniform(0.15, 0.85) * float(sent.nodes[-1])
    q, v, a = (x[0] for x in sent.at(np.array([at]))[:3])
    bounds = problem.limits
    v, a = np.clip(v, bounds.v_lower, bounds.v_upper), np.clip(a, bounds.a_lower, bounds.a_upper)
    if is_stop:
        found = mbocp.stop(problem, q=q, v=v, a=a)
    else:
        duration = {"min": 0.05, "max": 5.0, "guess": float(sent.nodes[-1]) - at}
        found = mbocp.solve(problem.with_(start={"q": q, "v": v, "a": a}, duration=duration))
    row = {"robot": name, "seed": seed, "status": str(found.status), "iterations": found.iterations}
    worst: dict[str, float] = {}
    for rate in RATES:
        file = found.export(folder / f"{rate}.csv", rate=float(rate))
        before = sent.at(np.maximum(at - np.arange(3, 0, -1) / rate, 0.0))[0]
        left = violation_of_samples(file, float(rate), limits, before)
        worst |= {f"{kind} {rate}": value for kind, value in left.items()}
    file = found.export(folder / "points.yaml")
    worst |= {f"{kind} points": value for kind, value in violation_of_points(file, limits).items()}
    t, samples = samples_of(folder / "1000.csv")
    ends = [samples[0] - q, *([] if is_stop else [samples[-1] - problem.goal.q])]
    longer = float(t[-1]) / found.duration - 1.0
    return row | {"violations": worst, "away": float(np.abs(ends).max()), "longer": longer}


@lru_cache(maxsize=1)
def _plan(name: str, seed: int) -> tuple[Problem, Curves]:
    """A problem, and its motion as it is sent."""
    problem = problem_of(name, seed, with_torques=False)
    if name == "ur5e":
        problem = problem.with_(limits={**ROBOTS[name][1], "effort": False, "jerk": JERK})
    plan = mbocp.solve(problem, check=True)
    return problem, compute_motion_sent(plan, 1000.0, fit=True).curves


def _row(name: str, seed: int, *, is_stop: bool) -> dict[str, Any]:
    """The same, or why there is none."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return row_of(name, seed, Path(folder), is_stop=is_stop)
        except MbocpError as error:
            return {"robot": name, "seed": seed, "status": "refused", "why": str(error)}


def main() -> int:
    """Run or go on; 1 if one is refused or does not converge, or leaves a limit as it is sent."""
    parser = argparse.ArgumentParser(prog="python -m tests.sent.amid", description=__doc__)
    add_options(parser, 100, "build/amid.jsonl")
    parser.add_argument("--replan", action="store_true", help="replans in place of stops")
    options = parser.parse_args()
    is_good = True
    for row in rows_of(options, partial(_row, is_stop=not options.replan)):
        worst = max(row.get("violations", {"": np.inf}).values())
        is_good &= row["status"] == "converged" and worst <= _KEPT
        longer = 100.0 * row.get("longer", np.nan)
        print(f"{row['robot']} {row['seed']}: {row['status']}, longer by {longer:.2f} %, left by {worst:.0e}")
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
