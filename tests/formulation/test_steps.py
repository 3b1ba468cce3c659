"""Steps of a new kind are one class: nothing of the package has to know it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.formulation.features.accelerations import mean_acceleration
from mbocp.formulation.schemes import implicit
from mbocp.formulation.steps import StepDerivatives, StepSymbols
from mbocp.integrators import State
from mbocp.mechanics import JointMechanics, Mechanics
from mbocp.problem import Problem
from mbocp.robot import Robot, load_robot


@dataclass(frozen=True)
class TrapezoidalSteps:
    """Velocities and forces are the means of those at both ends; for robots without constraints."""

    scheme: str

    rows_are_gaps = False
    takes_numbers = False
    tau = 0.5
    remedy = "Lock joints"

    @property
    def state_key(self) -> Mapping[str, str]:
        return {"coordinates": "joint", "rotations": "quaternion"}

    @property
    def stage_key(self) -> Mapping[str, str | int]:
        return {"scheme": "trapezoidal", "lie": "", "substeps": 1}

    @property
    def end_key(self) -> Mapping[str, str]:
        return {"scheme": "implicit"}

    @property
    def parameters(self) -> Mapping[str, int]:
        return {}

    def operations(self, nv: int) -> float:
        return 1000.0 * nv**2

    def mechanics(self, robot: Robot) -> Mechanics:
        return JointMechanics(robot)

    def num_algebraic(self, mechanics: Mechanics, num_held: int) -> int:
        return 0

    def impulses_of(self, unknowns: ca.SX, num_rows: int) -> ca.SX:
        return unknowns

    def derivatives(self, at: StepSymbols) -> StepDerivatives:
        mechanics, layout, dt, force = at.mechanics, at.space.layout, at.given["dt"], at.given["force"]
        before, after = (State(x[layout.z], x[layout.s]) for x in (at.at0, at.at1))
        acceleration = (after.v - before.v) / dt
        reached = mechanics.integrate(before.q, dt * (before.v + after.v) / 2)
        missing = [
            mechanics.force(*end, at.controls) - mechanics.inverse_dynamics(*end, acceleration)
            for end in (before, after)
        ]
        kinematic = at.space.configuration_difference(after.q, reached)
        c = ca.densify(ca.vertcat(kinematic, dt / 2 * (missing[0] + missing[1]) / force))
        mean = (before.v + after.v) / 2
        cost = at.running_cost(before.q, mean, lambda: mean_acceleration(mechanics, before, after, dt))
        z = ca.vertcat(at.d1, at.y, at.d0, at.u)
        hessian, _ = ca.hessian(cost + ca.dot(at.m, c), z)
        found = [c, cost, ca.jacobian(c, z), ca.jacobian(cost, z), ca.triu(hessian)]
        others = [at.y, at.u, at.m, at.theta, at.rho]
        c, cost, dc_dz, dl_dz, hessian = at.space.at_zero_tangents(
            [at.x0, at.x1], found, others, [at.d0, at.d1]
        )
        return StepDerivatives(c, cost, dc_dz, dl_dz, hessian)


def largest_imbalance(solution: mbocp.Solution, robot: Robot) -> float:
    """Of the trapezoidal rule, by Pinocchio [N m]."""
    data, dt = robot.model.createData(), solution.duration / solution.num_steps
    found = []
    for n, u in enumerate(solution.us):
        a = (solution.vs[n + 1] - solution.vs[n]) / dt
        torques = [pin.rnea(robot.model, data, solution.qs[k], solution.vs[k], a) for k in (n, n + 1)]
        found.append(np.abs(sum(torques) / 2 - robot.actuation.selection @ u).max())
    return float(max(found))


def test_a_new_kind_of_steps_is_one_class(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = load_robot("chain_2")
    problem = Problem.create(
        robot, 1.0, 40, goal={"q": (robot.q0 + 0.3).tolist()}, integrator={"scheme": "midpoint"}
    )
    midpoint = mbocp.solve(problem, check=True)
    monkeypatch.setattr(implicit, "ImplicitSteps", TrapezoidalSteps)
    trapezoidal = mbocp.solve(problem, check=True)
    assert largest_imbalance(midpoint, robot) > 1e-5
    assert largest_imbalance(trapezoidal, robot) < 1e-8
    kinematic = (trapezoidal.vs[:-1] + trapezoidal.vs[1:]) / 2 * problem.dt
    np.testing.assert_allclose(np.diff(trapezoidal.qs, axis=0), kinematic, atol=1e-10)
