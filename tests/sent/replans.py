"""Replans of random motions within limits of jerks, warm and cold: `python -m tests.sent.replans`."""

from __future__ import annotations

import argparse
import sys
import time
import warnings

import numpy as np

import mbocp
from mbocp.problem import Problem
from mbocp.solution.sent import compute_motion_sent
from tests.sent.cases import JERK, PROFILES, ROBOTS, problem_of
from tests.sent.reader import limits_of

_ROOM = 0.99  # of the limits of jerk: the plan's
_A_PLAN = 7  # replans
_LONGER = 1.3  # than the least time: motions of least effort
_BESIDE = 1e-4, 1e-3  # standard deviations [rad, rad/s]
_WHERE = "nodes", "between", "beside", "row"
_AFTER = 0.01  # [s] on the motion before, as it is sent, that each of a row begins


def plan_of(name: str, seed: int, *, has_given_time: bool) -> tuple[mbocp.Solution, Problem]:
    """A plan within a part of its limits of jerk, and the problem with all of them."""
    problem = problem_of(name, seed, with_torques=False)
    jerk = np.full(problem.robot.nv, JERK)
    if name == "fr3":
        jerk = limits_of(PROFILES / "fr3.toml")["jerk"][1]
    own = {**ROBOTS[name][1], "effort": False, **({"effort_rate": False} if name == "fr3" else {})}
    problem = problem.with_(limits={**own, "jerk": jerk.tolist()})
    tight = problem.with_(limits={**own, "jerk": (_ROOM * jerk).tolist()})
    if has_given_time:
        change = {"duration": _LONGER * mbocp.solve(tight).duration, "cost": {"effort": 1e-3}}
        problem, tight = problem.with_(**change), tight.with_(**change)
    return mbocp.solve(tight, check=True), problem


def later(plan: mbocp.Solution, problem: Problem, where: str, rng: np.random.Generator) -> Problem:
    """The rest of a plan from a random place on it, or a little beside it."""
    n, s = int(rng.integers(3, plan.num_steps - 4)), 0.0 if where == "nodes" else rng.uniform(0.1, 0.9)
    values = [plan.qs[n : n + 2], plan.vs[n : n + 2], [plan.acceleration_at(k) for k in (n, n + 1)]]
    q, v, a = ((1.0 - s) * x[0] + s * x[1] for x in values)
    if where == "beside":
        q, v = (x + size * rng.normal(size=x.shape) for x, size in zip((q, v), _BESIDE, strict=True))
        v = np.clip(v, problem.limits.v_lower, problem.limits.v_upper)
    rest = plan.duration - float((1.0 - s) * plan.t[n] + s * plan.t[n + 1])
    start = {"q": q, "v": v, "a": a}
    return problem.with_(start=start, duration=_duration(problem, rest), steps=plan.num_steps - n)


def _duration(problem: Problem, rest: float) -> float | dict[str, float]:
    """What is left of it [s], or about that where it is free."""
    return rest if problem.duration_range is None else {"min": 0.01, "max": 5.0, "guess": rest}


def next_of(last: mbocp.Solution, problem: Problem) -> Problem:
    """The rest of a motion a little later, from where it is as it is sent."""
    curves, bounds = compute_motion_sent(last, 1000.0, fit=True).curves, problem.limits
    q, v, a = (x[0] for x in curves.at(np.array([_AFTER]))[:3])
    start = {
        "q": q,
        "v": np.clip(v, bounds.v_lower, bounds.v_upper),
        "a": np.clip(a, bounds.a_lower, bounds.a_upper),
    }
    return problem.with_(start=start, duration=_duration(problem, float(curves.nodes[-1]) - _AFTER))


def main() -> int:
    """Print a row; 1 if the median of warm iterations is above half of that of cold ones."""
    parser = argparse.ArgumentParser(prog="python -m tests.sent.replans", description=__doc__)
    parser.add_argument("--robot", choices=ROBOTS, default="ur5e")
    parser.add_argument("--effort", action="store_true", help="least effort in a given time")
    parser.add_argument("--where", choices=_WHERE, default=_WHERE[0])
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--a-plan", type=int, default=_A_PLAN, help="replans of each plan")
    options = parser.parse_args()
    rows = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for k in range(options.count):
            if k % options.a_plan == 0:
                seed = 1000 + k // options.a_plan
                plan, problem = plan_of(options.robot, seed, has_given_time=options.effort)
                rng = np.random.default_rng(seed)
            is_row = options.where == "row"
            rest, row = next_of(plan, problem) if is_row else later(plan, problem, options.where, rng), []
            both = []
            for start in (plan, None):
                begun = time.process_time()
                both.append(mbocp.solve(rest, warm_start=start))
                row += [both[-1].iterations, time.process_time() - begun, both[-1].converged]
            plan = both[0] if is_row else plan
            rows.append(row)
    table = np.array(rows)
    warm, warm_s, _, cold, cold_s, _ = np.median(table, axis=0)
    converged = table[:, [2, 5]].sum(axis=0).astype(int)
    most = np.quantile(table[:, [0, 3]], 0.9, axis=0)
    print(
        f"| {options.robot} | {'effort' if options.effort else 'time'} | {options.where} | {len(rows)} "
        f"| {converged[0]}, {converged[1]} | {warm:.0f}, {most[0]:.0f} | {cold:.0f}, {most[1]:.0f} "
        f"| {warm_s:.2f}, {cold_s:.2f} |"
    )
    return int(2.0 * warm > cold)


if __name__ == "__main__":
    sys.exit(main())
