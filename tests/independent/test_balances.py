"""Motions against scipy's DOP853 on equations of their own, and the balances that mechanics demands."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import mbocp
from mbocp._arrays import Array
from tests.checker import System, read_system

ORDERS = {"se1": 1, "midpoint": 2, "rk4": 4}
STEPS = (20, 40, 80)
ACCURATE = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}


# A free rigid body


def tumbling(scheme: str, steps: int) -> mbocp.Solution:
    """The drone without gravity and without a goal: nothing to do but to tumble."""
    robot = mbocp.load_robot("hector", actuated=["root_joint"], gravity=[0, 0, 0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that the problem asks for nothing
        problem = mbocp.Problem.create(
            robot,
            1.0,
            steps,
            start={"v": [0.4, -0.3, 0.2, 1.5, -2.0, 1.0]},
            goal={"enforce": "none"},
            scheme=scheme,
            cost={},
        )
    solution = mbocp.solve(problem, check=True)
    assert np.abs(solution.us).max() < 1e-9
    return solution


def euler_equations() -> tuple[Array, Array]:
    """Spin and attitude at the end, by Euler's equations about the centre of mass."""
    robot = mbocp.load_robot("hector", actuated=["root_joint"])
    model = read_system(str(robot.source), free_flyer=True, motors=[]).model
    inertia = np.array(model.inertias[1].inertia)

    def rates(_: float, x: Array) -> Array:
        w, R = x[:3], x[3:].reshape(3, 3)
        return np.concatenate([np.linalg.solve(inertia, np.cross(inertia @ w, w)), (R @ pin.skew(w)).ravel()])

    x = np.concatenate([[1.5, -2.0, 1.0], np.eye(3).ravel()])
    end = solve_ivp(rates, (0.0, 1.0), x, **ACCURATE).y[:, -1]
    return end[:3], end[3:].reshape(3, 3)


@pytest.mark.parametrize("scheme", ORDERS)
def test_a_body_tumbles_as_euler_says(scheme: str) -> None:
    spin, attitude = euler_equations()
    errors = []
    for steps in STEPS:
        s = tumbling(scheme, steps)
        R = pin.Quaternion(np.array(s.q_final[3:])).matrix()
        errors.append(max(np.abs(s.vs[-1, 3:] - spin).max(), np.abs(R - attitude).max()))
    assert np.log2(errors[0] / errors[-1]) / 2 == pytest.approx(ORDERS[scheme], abs=0.3)


@pytest.mark.parametrize("scheme", ORDERS)
def test_momenta_of_a_free_body_stay(scheme: str) -> None:
    """Linear momentum and spin in the world: to the order of the scheme, energy likewise."""
    model = read_system(str(mbocp.load_robot("hector").source), free_flyer=True, motors=[]).model
    model.gravity.linear = np.zeros(3)
    defects = []
    for steps in STEPS:
        s, data = tumbling(scheme, steps), model.createData()
        found = []
        for q, v in zip(s.qs, s.vs, strict=True):
            momentum = np.array(pin.computeCentroidalMomentum(model, data, np.array(q), np.array(v)))
            found.append(np.append(momentum, pin.computeKineticEnergy(model, data, np.array(q), np.array(v))))
        defects.append(np.ptp(found, axis=0).max())
    assert np.log2(defects[0] / defects[-1]) / 2 > ORDERS[scheme] - 0.3


# A loop with a motor


def four_bar() -> tuple[Any, System]:
    robot = mbocp.load_robot("four_bar")
    system = read_system(str(robot.source), toml=robot.source.parent / "robot.toml")
    system.choose_rows(np.array(robot.q0))
    return robot, system


def swung(robot: Any, scheme: str, steps: int) -> mbocp.Solution:
    problem = mbocp.Problem.create(
        robot,
        0.6,
        steps,
        goal={"q": {"crank": 1.5}, "v": [0, 0, 0]},
        scheme=scheme,
        cost={},
    )
    return mbocp.solve(problem, check=True)


def simulated(system: System, s: mbocp.Solution) -> tuple[Array, float]:
    """State at the end of an accurate simulation with the controls of a solution, and the work they do."""

    def rates(_: float, x: Array, u: Array) -> Array:
        q, v = x[:3], x[3:6]
        J = system.Phi_q(q)
        h = 1e-6
        bias = (system.Phi_q(q + h * v) - system.Phi_q(q - h * v)) @ v / (2 * h)
        forces = system.applied(q, v, u) - pin.nonLinearEffects(system.model, system.data, q, v)
        matrix = np.block([[system.mass(q), J.T], [J, np.zeros((2, 2))]])
        a = np.linalg.solve(matrix, np.concatenate([forces, -bias]))[:3]
        return np.concatenate([v, a, [(system.actuation(q) @ u) @ v]])

    x = np.concatenate([s.qs[0], s.vs[0], [0.0]])
    dt = s.t[1] - s.t[0]
    for u in s.us:
        x = solve_ivp(rates, (0.0, dt), x, args=(np.array(u),), method="DOP853", rtol=1e-9, atol=1e-10).y[
            :, -1
        ]
    return x[:6], float(x[6])


def energy(system: System, q: Array, v: Array) -> float:
    return 0.5 * v @ system.mass(q) @ v + system.potential(q)


@pytest.mark.parametrize("scheme", ORDERS)
def test_a_four_bar_moves_as_an_accurate_simulation_says(scheme: str) -> None:
    """End state; and the energy at the end less the energy at the start is the motor's work."""
    robot, system = four_bar()
    misses, defects = [], []
    for steps in (20, 40):
        s = swung(robot, scheme, steps)
        end, work = simulated(system, s)
        misses.append(np.abs(end - np.concatenate([s.qs[-1], s.vs[-1]])).max())
        gained = energy(system, np.array(s.qs[-1]), np.array(s.vs[-1])) - energy(
            system, np.array(s.qs[0]), np.array(s.vs[0])
        )
        defects.append(abs(gained - work))
        assert energy(system, end[:3], end[3:]) - energy(
            system, np.array(s.qs[0]), np.array(s.vs[0])
        ) == pytest.approx(work, abs=1e-6)
    assert np.log2(misses[0] / misses[1]) > ORDERS[scheme] - 0.5
    assert np.log2(defects[0] / defects[1]) > ORDERS[scheme] - 0.5
