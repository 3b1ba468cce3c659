"""A horizon that moves on, in closed loop: python -m benchmarks.receding_horizon.

Wall time of each call of `RecedingHorizon.step`, and of the kernel in it, over a thousand steps with noise
and a moving goal; it is far at the start, so that torques are at their limits. What others do on the machine
is in the largest times.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.machine import one_core
from benchmarks.tables import Table, show
from mbocp.problem import Problem

__all__ = ["loop_times"]

_PERIOD, _SUBSTEPS = 4e-3, 4  # [s]; of the simulation
_NOISE = (1e-4, 2e-3)  # [rad], [rad/s]
_FOLLOW = "examples/receding/ur5_follow.toml"


def loop_times(problem: Problem, steps: int, iterations: int) -> tuple[np.ndarray, Counter[str], float]:
    """Times of steps, with Python and in the kernel, shape (steps, 2) [s]; states; distance from the goal."""
    horizon = mbocp.RecedingHorizon(problem, iterations=iterations)
    robot, rng = problem.robot, np.random.default_rng(0)
    model, data = robot.model, robot.model.createData()
    q, v = np.array(problem.q_start), np.array(problem.v_start)
    times, states = np.zeros((steps, 2)), Counter[str]()
    for k in range(steps):
        goal = np.asarray(problem.goal.q) + 0.2 * np.sin(k * _PERIOD)
        measured = (q + _NOISE[0] * rng.standard_normal(q.size), v + _NOISE[1] * rng.standard_normal(v.size))
        begun = time.perf_counter()
        found = horizon.step(*measured, goal=goal, target=goal, dt=_PERIOD)
        times[k] = time.perf_counter() - begun, found.status.seconds
        states[found.status.state] += 1
        for _ in range(_SUBSTEPS):
            v = v + _PERIOD / _SUBSTEPS * pin.aba(model, data, q, v, found.u)
            q = robot.integrate(q, _PERIOD / _SUBSTEPS * v)
    return times, states, float(np.abs(q - goal).max())


def _cases() -> dict[str, Problem]:
    ur5 = mbocp.load_problem(_FOLLOW)
    panda = mbocp.load_problem(
        "examples/arms/panda_reach.toml",
        {
            "horizon.steps": 30,
            "horizon.duration": 0.6,
            "goal.enforce": "penalty",
            "cost.terminal": 1.0,
            "integrator.scheme": "se1",
        },
    )
    nv = panda.robot.nv
    weights = np.concatenate([np.full(nv, 1000.0), np.zeros(nv)])
    ends = np.concatenate([np.full(nv, 300.0), np.full(nv, 3.0)])
    cost = {
        "effort": 1e-3,
        "velocity": 1.0,
        "tracking": 1.0,
        "tracking_weights": weights,
        "terminal": 1.0,
        "terminal_weights": ends,
    }
    return {"UR5, N = 30": ur5, "Panda, N = 30": panda.with_(cost=cost, limits={"effort": True})}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--iterations", type=int, nargs="+", default=[1, 2])
    asked = parser.parse_args()
    rows = []
    one_core()
    for name, problem in _cases().items():
        for iterations in asked.iterations:
            times, states, off = loop_times(problem, asked.steps, iterations)
            for place, column in zip(("with Python", "kernel"), times[1:].T, strict=True):
                median, high, worst = (1e3 * np.percentile(column, p) for p in (50, 99, 100))
                told = ", ".join(f"{count} {state}" for state, count in states.items())
                cells = (f"{median:.3f}", f"{high:.3f}", f"{worst:.3f}", f"{off:.3f}", told)
                rows.append((name, str(iterations), place, *cells))
    heads = ("problem", "Newton steps", "", "median [ms]", "99 % [ms]", "worst [ms]", "off [rad]", "states")
    show(Table("A step of the receding horizon", heads, tuple(rows)))


if __name__ == "__main__":
    main()
