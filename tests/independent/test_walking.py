"""A trot by Pinocchio's momentum of the whole robot: the ground alone changes it, beside the weight."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from benchmarks.gaits import judged
from mbocp import Problem, Solution
from mbocp._arrays import Array

FEET = {foot: f"{foot}_FOOT" for foot in ("FL", "FR", "HL", "HR")}
FRICTION, DT = 0.7, 0.2 / 12  # 1, [s]


@pytest.fixture(scope="module", params=["midpoint", "projected_midpoint"])
def trot(request: pytest.FixtureRequest) -> tuple[Problem, Solution]:
    robot = mbocp.load_robot("solo12")
    q = np.array(robot.q0)
    alternates = request.param == "midpoint"
    q[:2], q[3:7] = [0.08, 0.02], [0, 0, np.sin(0.1), np.cos(0.1)]
    problem = Problem.create(
        robot,
        gait={"swings": "trot", "cycles": 1, "duration": 0.2, "steps": 12},
        ground={"feet": FEET, "friction": FRICTION, "lift": 0.03},
        goal={"q": q, "v": 0},
        cost={"effort": 1.0, "velocity": 0.01} | ({"acceleration": 0.01 * DT**2 / 4} if alternates else {}),
        limits={"effort": 2.7, "position": True},
        scheme=request.param,
    )
    return problem, mbocp.solve(problem, check=True)


def forces(problem: Problem, solution: Solution) -> Array:
    """Of the ground on all feet, in the world [N]; in steps of no duration impulses [N s]."""
    found = np.array([contact.wrenches(solution.lams)[:, [1, 2, 0]] for contact in problem.contacts])
    return np.asarray(found.sum(axis=0))


def test_weight_and_ground_change_the_momentum(trot: tuple[Problem, Solution]) -> None:
    problem, solution = trot
    model, dts = problem.robot.model, np.diff(solution.t)
    data, is_impact = model.createData(), np.diff(solution.t) < 1e-12
    momenta = [
        np.array(pin.computeCentroidalMomentum(model, data, np.array(q), np.array(v)).linear)
        for q, v in zip(solution.qs, solution.vs, strict=True)
    ]
    weight = pin.computeTotalMass(model) * model.gravity.linear
    lengths = np.where(is_impact, 1.0, dts)[:, None]
    expected = lengths * forces(problem, solution) + weight * dts[:, None]
    changes = np.diff(momenta, axis=0)
    assert np.abs(changes[is_impact]).max() > 0.01  # N s: it lands
    np.testing.assert_allclose(changes[is_impact], expected[is_impact], atol=1e-9)
    np.testing.assert_allclose(changes[~is_impact], expected[~is_impact], atol=1e-4)  # of the order dt^3


def test_feet_that_stand_stay_and_forces_are_in_their_cones(trot: tuple[Problem, Solution]) -> None:
    problem, solution = trot
    found = judged(problem, solution)
    assert max(found["dynamics"], found["impact"]) < 1e-9
    assert max(found["slip"], found["stands"], found["below"]) < 1e-9
    assert found["cone"] < 1e-7
    assert 1e-6 < found["stands between"] < 1e-3  # straight in the joints, from node to node
    assert found["impulse"] < 0.03
