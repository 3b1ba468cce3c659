"""Gauss, Lobatto and Radau methods: order, symplecticity, momenta, energy, constraints, stiff losses."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pinocchio as pin
import pytest

from mbocp._arrays import Array
from mbocp.formulation import formulate
from mbocp.guesses import make_guess
from mbocp.integrators import PAIRS, Pair
from mbocp.problem import Problem
from mbocp.robot import Robot, load_robot
from mbocp.robot.resistance import JointResistance
from tests.integrators.partitioned import Stepper
from tests.integrators.test_schemes import CASES, by_hand, load, reference
from tests.integrators.test_symplecticity import null_space
from tests.mechanics.models import BODY, ORIGIN, chain
from tests.mechanics.models import robot as robot_of

STEPS = {
    "gauss1": (20, 40, 80),
    "gauss2": (5, 10, 20),
    "gauss3": (3, 5, 8),
    "lobatto2": (20, 40, 80),
    "lobatto3": (5, 10, 20),
    "radau2": (10, 20, 40),
    "radau3": (4, 6, 10),
}
SYMPLECTIC = [name for name, pair in PAIRS.items() if pair.is_symplectic]
ON_CONSTRAINTS = [name for name, pair in PAIRS.items() if pair.holds_constraints]
TO_ROUND_OFF = 1e-13


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
def test_coefficients(pair: Pair) -> None:
    """Symplectic or L-stable, consistent, and of the order that the quadrature of the stages has."""
    a, hat, b, c = (np.array(x) for x in (pair.a, pair.a_hat, pair.b, pair.c))
    if pair.is_symplectic:
        assert np.abs(b[:, None] * hat + (b[:, None] * a).T - np.outer(b, b)).max() < 1e-16
    else:
        assert 1 - b @ np.linalg.solve(a, np.ones(len(b))) == pytest.approx(0.0, abs=1e-14)
    for k in range(pair.order):
        assert b @ c**k == pytest.approx(float(Fraction(1, k + 1)), abs=1e-15)
    if pair.holds_constraints:
        assert not any(pair.a[0])
        assert pair.a[-1] == pair.b
        assert not any(row[-1] for row in pair.a_hat)


def end_of(problem: Problem) -> Array:
    state: Array = make_guess("control", formulate(problem))[0].xs[-1]
    return state


def slope_of_errors(made: dict[int, Problem]) -> float:
    problem = next(iter(made.values()))
    exact, nq, robot = reference(problem), problem.robot.nq, problem.robot
    errors = []
    for one in made.values():
        x = end_of(one)
        errors.append(np.linalg.norm(np.r_[robot.difference(exact[:nq], x[:nq]), x[nq:] - exact[nq:]]))
    return float(-np.polyfit(np.log(list(made)), np.log(errors), 1)[0])


@pytest.mark.parametrize("scheme", PAIRS)
def test_order_of_an_arm(scheme: str) -> None:
    path, settings, _ = CASES["ur5"]
    made = {n: load(path, scheme, *settings, f"horizon.steps={n}") for n in STEPS[scheme]}
    assert slope_of_errors(made) == pytest.approx(PAIRS[scheme].order, abs=0.2)


@pytest.mark.parametrize(
    ("name", "scheme"),
    [
        *(("continuous joint", scheme) for scheme in PAIRS),
        *(
            pytest.param("ball joint", scheme, marks=[pytest.mark.slow] if pair.num_stages > 2 else [])
            for scheme, pair in PAIRS.items()
        ),
    ],
)
def test_order_on_a_group(name: str, scheme: str) -> None:
    made = {n: by_hand(name, scheme, n) for n in STEPS[scheme]}
    assert slope_of_errors(made) == pytest.approx(PAIRS[scheme].order, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["gauss2", "lobatto3"])
def test_order_of_a_free_flyer(scheme: str) -> None:
    path, settings, _ = CASES["drone"]
    made = {n: load(path, scheme, *settings, f"horizon.steps={n}") for n in STEPS[scheme]}
    assert slope_of_errors(made) == pytest.approx(PAIRS[scheme].order, abs=0.2)


@pytest.mark.parametrize("scheme", ON_CONSTRAINTS)
def test_order_on_a_constraint(scheme: str) -> None:
    path, settings, _ = CASES["rigid_pendulum"]
    made = {n: load(path, scheme, *settings, f"horizon.steps={n}") for n in (20, 40, 80)}
    assert slope_of_errors(made) == pytest.approx(PAIRS[scheme].order, abs=0.2)


def by_name(name: str) -> Robot:
    """A chain of joints, or a robot without losses."""
    if " " in name or name == "FreeFlyer":
        return robot_of(chain(name)[0])
    return replace(load_robot(name), resistances=())


def beginning(robot: Robot, *, rate: float = 1.0) -> Array:
    rng = np.random.default_rng(5)
    q = robot.q0 if robot.nc else robot.integrate(robot.q0, 0.3 * rng.standard_normal(robot.nv))
    v = rate * rng.standard_normal(robot.nv)
    if robot.nc:
        v = null_space(robot.constraint_jacobian(q)) @ rng.standard_normal(robot.nv - robot.nc)
    return np.r_[q, v]


@pytest.mark.parametrize("scheme", SYMPLECTIC)
@pytest.mark.parametrize("name", ["double_pendulum", "Spherical PX", "Planar RX"])
def test_steps_keep_the_canonical_form(name: str, scheme: str) -> None:
    robot = by_name(name)
    stepper, x = Stepper(robot, scheme, 0.05), beginning(robot)
    x1, _, slope = stepper.step(x, np.zeros(stepper.ny))
    F = stepper.to_momenta(x1) @ slope @ np.linalg.inv(stepper.to_momenta(x))
    before, after = stepper.two_form(x), stepper.two_form(x1)
    assert np.abs(F.T @ after @ F - before).max() < 1e-9 * (1 + np.abs(before).max())
    assert np.abs(F - np.eye(len(F))).max() > 1e-3


@pytest.mark.parametrize("scheme", ON_CONSTRAINTS)
@pytest.mark.parametrize("name", ["rigid_pendulum", "four_bar"])
def test_steps_on_constraints_keep_the_canonical_form(name: str, scheme: str) -> None:
    """On tangents of the states that agree with the constraints, in positions and velocities."""
    robot = by_name(name)
    stepper, x = Stepper(robot, scheme, 0.02), beginning(robot)
    x1, _, slope = stepper.step(x, np.zeros(stepper.ny))
    tangents, h = np.eye(2 * robot.nv), 1e-5

    def rates(d: Array) -> Array:
        q = robot.integrate(x[: robot.nq], d[: robot.nv])
        rate = robot.constraint_jacobian(q) @ (x[robot.nq :] + d[robot.nv :])
        return np.r_[robot.constraint_residual(q), rate]

    rows = np.array([(rates(h * t) - rates(-h * t)) / (2 * h) for t in tangents]).T
    basis = null_space(rows)
    start, end = stepper.to_momenta(x) @ basis, stepper.to_momenta(x1) @ slope @ basis
    before, after = start.T @ stepper.two_form(x) @ start, end.T @ stepper.two_form(x1) @ end
    assert np.abs(after - before).max() < 1e-8 * (1 + np.abs(before).max())  # the basis is by differences
    assert np.abs(before).max() > 1e-3


@pytest.mark.parametrize("scheme", ["lobatto2", pytest.param("gauss2", marks=pytest.mark.slow)])
def test_momenta_of_a_free_body_in_gravity(scheme: str) -> None:
    """Horizontal momentum and the angular one about the vertical, with a pendulum on the body."""
    stepper = Stepper(robot_of(carrying()), scheme, 0.02)
    xs = stepper.run(beginning(stepper.robot), 20)
    kept = np.array([momenta_in_the_world(stepper, x) for x in xs])[:, [0, 1, 5]]
    assert np.abs(kept - kept[0]).max() < TO_ROUND_OFF * np.abs(kept).max() * 10
    assert np.abs(np.linalg.norm(xs[:, 3:7], axis=1) - 1).max() < TO_ROUND_OFF


def carrying() -> pin.Model:
    model, _ = chain("FreeFlyer RX")
    model.appendBodyToJoint(1, BODY, ORIGIN)
    return model


def momenta_in_the_world(stepper: Stepper, x: Array) -> Array:
    """Linear and angular momentum about the origin, world axes, of all that a free-flyer carries."""
    p, q = stepper.momentum(x), x[:7]
    R = pin.Quaternion(q[6], q[3], q[4], q[5]).toRotationMatrix()
    linear = R @ p[:3]
    return np.r_[linear, R @ p[3:6] + np.cross(q[:3], linear)]


@pytest.mark.parametrize("scheme", SYMPLECTIC)
def test_energy_stays_within_bounds(scheme: str) -> None:
    stepper = Stepper(by_name("RX RY"), scheme, 0.05)
    xs = stepper.run(beginning(stepper.robot), 100)
    energies = np.array([stepper.energy(x) for x in xs])
    error = np.abs(energies - energies[0])
    most = {"gauss1": 0.05, "lobatto2": 0.05, "lobatto3": 1e-3, "gauss2": 1e-3, "gauss3": 1e-4}
    assert error.max() < most[scheme]
    assert error[50:].max() < 2 * error[:50].max()


@pytest.mark.parametrize("scheme", ["radau2", "radau3"])
def test_stiff_losses_settle_within_a_step(scheme: str) -> None:
    """Gauss methods keep such a rate, and turn its sign."""
    robot = by_name("RX RY")
    losses = tuple(JointResistance(name, i, damping=1e7) for i, name in enumerate(robot.model.names[1:]))
    damped = replace(robot, resistances=losses)
    rates = {}
    for name in (scheme, "gauss2"):
        x = Stepper(damped, name, 0.05).run(np.r_[robot.q0, 1.0, 1.0], 1)[-1]
        rates[name] = np.abs(x[2:]).max()
    assert rates[scheme] < 1e-3 < 0.5 < rates["gauss2"]


@pytest.mark.parametrize("scheme", ON_CONSTRAINTS)
@pytest.mark.parametrize("name", ["rigid_pendulum", "four_bar"])
def test_constraints_hold_for_positions_and_velocities(name: str, scheme: str) -> None:
    robot = by_name(name)
    xs = Stepper(robot, scheme, 0.01).run(beginning(robot), 20)
    for x in xs:
        q, v = x[: robot.nq], x[robot.nq :]
        assert np.abs(robot.constraint_residual(q)).max() < 1e-12
        assert np.abs(robot.constraint_jacobian(q) @ v).max() < 1e-12
