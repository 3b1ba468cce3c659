"""Limits and path constraints hold at nodes; between them h^2 / 8 max |g''| bounds what leaves them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import mbocp
from mbocp._arrays import Array
from mbocp.problem import Problem
from mbocp.solution import Solution

EXAMPLES = Path(__file__).parents[1] / "examples"
_PLACES = 20  # in a step
_LOCAL = 1e-6  # [rad, m, and per second] what the scheme is wrong by in a step, and what limits are met to

_TILT = 0.0873  # [rad] of the cup in its problem file

Measure = Callable[[Problem, Array, Array], Array]


@dataclass(frozen=True)
class Case:
    """A problem, and what must not be positive of its configurations and velocities, shape (k,)."""

    file: str
    steps: tuple[int, int]
    measure: Measure


def rail(problem: Problem, qs: Array, vs: Array) -> Array:
    found: Array = qs[:, 0] - 1.0 / 9.0
    return found


def tilt(problem: Problem, qs: Array, vs: Array) -> Array:
    """Angle of the cup's axis to the vertical less what is tolerated [rad]."""
    robot = problem.robot
    data, frame = robot.model.createData(), robot.frame_id("cup")
    angles = []
    for q in qs:
        pin.framesForwardKinematics(robot.model, data, q)
        angles.append(np.arccos(np.clip(data.oMf[frame].rotation[2, 2], -1.0, 1.0)))
    return np.array(angles) - _TILT


CASES = [
    pytest.param(Case("optima/bryson_denham", (20, 80), rail), id="position of a cart"),
    pytest.param(Case("arms/cup", (20, 80), tilt), id="tilt of a cup"),
]


def values_within(problem: Problem, solution: Solution, measure: Measure) -> Array:
    """In each step, on the true motion from its first node under its control, shape (N, _PLACES + 1)."""
    robot = problem.robot
    model, data, nv = robot.model, robot.model.createData(), robot.nv
    found = []
    for n, u in enumerate(solution.us):

        def rate(_: float, x: Array, u: Array = u) -> Array:
            q, v = x[:nv], x[nv:]
            force = robot.actuation_matrix(q) @ u + robot.force_elements(q, v)
            return np.append(v, pin.aba(model, data, q, v, force))

        h = solution.t[n + 1] - solution.t[n]
        times, start = np.linspace(0.0, h, _PLACES + 1), np.append(solution.qs[n], solution.vs[n])
        out = solve_ivp(rate, (0.0, h), start, method="DOP853", t_eval=times, rtol=1e-12, atol=1e-12)
        found.append(measure(problem, out.y[:nv].T, out.y[nv:].T))
    return np.array(found)


@pytest.mark.parametrize("case", CASES)
def test_limits_are_left_between_nodes_by_second_order_at_most(case: Case) -> None:
    excesses = []
    for steps in case.steps:
        problem = mbocp.load_problem(EXAMPLES / f"{case.file}.toml", [f"horizon.steps={steps}"])
        solution = mbocp.solve(problem, check=True, accuracy=False)
        values, h = values_within(problem, solution, case.measure), problem.dt
        bounds = h**2 / 8.0 * np.abs(np.diff(values, 2, axis=1)).max(axis=1) / (h / _PLACES) ** 2
        assert values[:, 0].max() < _LOCAL
        assert (values.max(axis=1) < bounds + _LOCAL).all()
        excesses.append(float(values.max()))
    assert excesses[0] > 10.0 * _LOCAL  # it does leave them
    assert excesses[1] < excesses[0] / 8.0
