"""The tau family by forward simulation: orders, constraints, groups, conditioning, what the start takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import mbocp
from mbocp._arrays import Array
from mbocp.exceptions import InconsistentStart
from mbocp.formulation import formulate, transcribe
from mbocp.formulation.schemes.implicit_steps import ImplicitSteps
from mbocp.formulation.signature import FunctionSignature
from mbocp.formulation.stage import build_functions
from mbocp.guesses import make_guess
from mbocp.integrators import EULER_SCHEMES, VELOCITY_TAU
from mbocp.mechanics import JointMechanics
from mbocp.problem import Problem
from mbocp.robot import Robot, load_robot
from mbocp.robot.joints import unit_groups
from mbocp.terms.kinds import ExactGoal
from tests.mechanics.models import chain
from tests.mechanics.models import robot as robot_of

EXAMPLES = Path(__file__).parents[2] / "examples"
ORDER = {"se1": 1, "se2": 1, "midpoint": 2, "semi_implicit_euler": 1}


def load(path: str, scheme: str, *settings: str) -> Problem:
    return mbocp.load_problem(EXAMPLES / path, [f'integrator.scheme="{scheme}"', *settings])


def simulate(problem: Problem) -> tuple[Array, Array]:
    """States and constraint multipliers under constant control, by the kernel."""
    iterate, _ = make_guess("control", formulate(problem))
    return iterate.xs, iterate.ys / problem.dt


def rate_of_quaternion(quaternion: Array, omega: Array) -> Array:
    """q' = q (omega, 0) / 2 with body-fixed omega, components xyzw."""
    (x, y, z, w), (a, b, c) = quaternion, omega
    rate: Array = (pin.Quaternion(w, x, y, z) * pin.Quaternion(0.0, a, b, c)).coeffs() / 2
    return rate


def rate_of_configuration(robot: Robot, q: Array, v: Array) -> Array:
    """dq/dt in coordinates, joint by joint."""
    rate = np.zeros(robot.nq)
    for joint in list(robot.model.joints)[1:]:
        iq, iv, kind = joint.idx_q, joint.idx_v, joint.shortname()
        if kind == "JointModelFreeFlyer":
            x, y, z, w = q[iq + 3 : iq + 7]
            attitude = pin.Quaternion(w, x, y, z).toRotationMatrix()
            rate[iq : iq + 3] = attitude @ v[iv : iv + 3]
            rate[iq + 3 : iq + 7] = rate_of_quaternion(q[iq + 3 : iq + 7], v[iv + 3 : iv + 6])
        elif kind == "JointModelSpherical":
            rate[iq : iq + 4] = rate_of_quaternion(q[iq : iq + 4], v[iv : iv + 3])
        elif joint.nq == 2 and joint.nv == 1:
            rate[iq : iq + 2] = v[iv] * np.array([-q[iq + 1], q[iq]])
        else:
            rate[iq : iq + joint.nq] = v[iv : iv + joint.nv]
    return rate


def unit(robot: Robot, q: Array) -> Array:
    """Quaternions and circles back on the group: intermediate stages of the reference leave it a little."""
    q = q.copy()
    for _, group in unit_groups(robot.model):
        q[group] /= np.linalg.norm(q[group])
    return q


def spring_force(q: Array) -> Array:
    """Section 6.1: V = k/(8 l^2) (|q|^2 - l^2)^2 with k = 0.6 N/m, l = 5 m."""
    return -0.6 / (2 * 5.0**2) * (q @ q - 5.0**2) * q


def reference(problem: Problem) -> Array:
    """State at the end by an adaptive Runge-Kutta method on the articulated-body algorithm."""
    robot, u = problem.robot, problem.guess.u
    assert u is not None
    model, data, nq = robot.model, robot.model.createData(), robot.nq

    def rhs(_: float, x: Array) -> Array:
        q, v = unit(robot, x[:nq]), x[nq:]
        force = robot.actuation_matrix(q) @ u
        if robot.name == "elastic_pendulum":
            force = force + spring_force(q)
        if robot.name == "rigid_pendulum":  # on the sphere: q . a + v . v = 0
            free = force + np.asarray(model.gravity.linear)
            return np.concatenate([v, free - q * (q @ free + v @ v) / (q @ q)])
        return np.concatenate([rate_of_configuration(robot, q, v), pin.aba(model, data, q, v, force)])

    start = np.concatenate([problem.q_start, problem.v_start])
    out = solve_ivp(rhs, (0.0, problem.duration), start, method="DOP853", rtol=1e-11, atol=1e-11)
    return np.concatenate([unit(robot, out.y[:nq, -1]), out.y[nq:, -1]])


CASES: dict[str, tuple[str, list[str], tuple[int, ...]]] = {
    "elastic_pendulum": (
        "paper/elastic_pendulum.toml",
        ["horizon.duration=1", "guess.u=[1, 0.5, 2]"],
        (20, 40, 80),
    ),
    "rigid_pendulum": ("paper/rigid_pendulum.toml", ["guess.u=[1, 0.5, 2]"], (100, 200, 400)),
    "ur5": (
        "arms/ur5_reach.toml",
        ["horizon.duration=0.3", "guess.u=[1, 2, -1, 0.1, 0.1, 0.1]"],
        (100, 200, 400),
    ),
    "drone": (
        "free_flyer/drone_flip.toml",
        ["horizon.duration=0.4", "guess.u=[0.2, 0, 14, 0.01, 0.02, -0.01]", "start.v=[1, 0, 0, 0.5, 1, 2]"],
        (50, 100, 200),
    ),
}
BY_HAND = {"continuous joint": "RUBZ RY", "ball joint": "Spherical PX"}


def by_hand(name: str, scheme: str, steps: int) -> Problem:
    """A body on two joints, turning, under constant torques."""
    subject = robot_of(chain(BY_HAND[name])[0])
    nv = subject.nv
    return Problem.create(
        subject,
        0.5,
        steps,
        start={"v": np.linspace(1.0, -1.5, nv)},
        goal={"v": np.zeros(nv)},
        guess={"u": np.linspace(0.5, -1.0, nv)},
        scheme=scheme,
        cost={},
    )


def check_orders(made: Callable[[str, int], Problem], steps: tuple[int, ...]) -> None:
    exact = reference(made("se1", steps[0]))
    for scheme in EULER_SCHEMES:
        errors = []
        for n in steps:
            problem = made(scheme, n)
            x, nq = simulate(problem)[0][-1], problem.robot.nq
            position = problem.robot.difference(exact[:nq], x[:nq])
            errors.append(np.linalg.norm(np.concatenate([position, x[nq:] - exact[nq:]])))
        slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
        assert slope == pytest.approx(ORDER[scheme], abs=0.2), (scheme, errors)


@pytest.mark.parametrize("name", CASES)
def test_order(name: str) -> None:
    path, settings, steps = CASES[name]
    check_orders(lambda scheme, n: load(path, scheme, *settings, f"horizon.steps={n}"), steps)


@pytest.mark.parametrize("name", BY_HAND)
def test_order_on_a_group(name: str) -> None:
    check_orders(lambda scheme, n: by_hand(name, scheme, n), (50, 100, 200))


@pytest.mark.parametrize("scheme", EULER_SCHEMES)
def test_rod_keeps_its_length_over_many_steps(scheme: str) -> None:
    settings = ["horizon.duration=20", "horizon.steps=4000", "guess.u=[1, 0.5, 2]"]
    xs, lams = simulate(load("paper/rigid_pendulum.toml", scheme, *settings))
    assert np.abs(np.linalg.norm(xs[:, :3], axis=1) - 5).max() < 1e-12
    # The velocity leaves the tangent plane by O(dt), the midpoint rule's by O(dt^2) and from side to side.
    normal = np.abs(np.einsum("ni,ni->n", xs[:, :3], xs[:, 3:])).max()
    assert normal < {"midpoint": 2e-2}.get(scheme, 3.0)
    assert np.isfinite(lams).all()


@pytest.mark.parametrize("scheme", EULER_SCHEMES)
def test_free_rotation_stays_on_the_group_over_many_steps(scheme: str) -> None:
    settings = ["horizon.duration=4", "horizon.steps=4000", "guess.u=[0, 0, 14, 0, 0, 0]"]
    xs, _ = simulate(load("free_flyer/drone_flip.toml", scheme, *settings, "start.v=[0, 0, 0, 3, 2, 1]"))
    assert np.abs(np.linalg.norm(xs[:, 3:7], axis=1) - 1).max() < 1e-12


@pytest.mark.parametrize("scheme", EULER_SCHEMES)
def test_conditioning_of_a_step_does_not_depend_on_its_length(scheme: str) -> None:
    """With positions measured in steps (q / dt), the only scaling that pivoting does not need to know."""
    signature = FunctionSignature("", ImplicitSteps(scheme), ExactGoal("p", 0, 0))
    jacobian = build_functions(JointMechanics(load_robot("rigid_pendulum")), signature)["jacobian"]
    conditions = []
    for dt in (1e-2, 1e-4, 1e-6):
        q0, v0 = np.array([5.0, 0.0, 0.0]), np.array([0.0, 3.0, 2.0])
        q1, v1 = q0 + dt * v0, v0 + dt * np.array([-2.0, 0.3, -9.0])
        theta = np.concatenate([[dt, 1.0], np.ones(3)])
        out = jacobian(np.r_[q0, v0], np.r_[q1, v1], 0.3 * dt, np.ones(3), theta, np.zeros(0))
        block = np.asarray(ca.DM(out[2]))[:, :7].copy()
        block[:, :3] *= dt
        block[:3] /= dt
        conditions.append(np.linalg.cond(block))
    assert max(conditions) < 200.0
    assert max(conditions) < 1.1 * min(conditions)


def start(*settings: str, scheme: str = "se2") -> tuple[Problem, Array]:
    problem = load("paper/rigid_pendulum.toml", scheme, *settings)
    return problem, transcribe(problem).x_start


def test_se2_starts_with_a_velocity_that_ends_on_the_constraint() -> None:
    corrections = []
    for steps in (50, 100, 200):
        problem, x = start(f"horizon.steps={steps}")
        robot = problem.robot
        assert np.abs(robot.constraint_residual(x[:3] + problem.dt * x[3:])).max() < 1e-13
        change = x[3:] - problem.v_start
        assert np.abs(np.cross(change, x[:3])).max() < 1e-13 * np.abs(x).max()  # normal to the sphere
        corrections.append(np.linalg.norm(change))
    assert np.log2(corrections[0] / corrections[2]) / 2 == pytest.approx(1.0, abs=0.02)


def test_the_other_starts_are_taken_as_they_are() -> None:
    for problem, x in (start(scheme="se1"), start(scheme="midpoint"), start("start.p=[0, 0, 0]")):
        assert np.array_equal(x, np.concatenate([problem.q_start, problem.v_start]))
    arm = load("arms/ur5_reach.toml", "se2", "start.v=[1, 0, 0, 0, 0, 0]")
    assert np.array_equal(transcribe(arm).x_start, np.concatenate([arm.q_start, arm.v_start]))


def test_se2_refuses_a_start_that_one_step_takes_off_the_sphere() -> None:
    with pytest.raises(InconsistentStart, match=r"(?s)start\.v.*step of scheme se2, 1 s.*'rod'.*more steps"):
        start("horizon.duration=2", "horizon.steps=2")


def residuals(problem: Problem, kind: str) -> Any:
    from mbocp.programme.kernel import kernel_programme

    formulation = formulate(problem)
    programme = formulation.programme
    iterate, _ = make_guess(kind, formulation)
    native = kernel_programme(programme)
    iterate.load_into(native)
    return native.evaluate()


@pytest.mark.parametrize("scheme", EULER_SCHEMES)
def test_line_and_rest_satisfy_the_scheme(scheme: str) -> None:
    """A fully actuated arm moves along the line with the controls of the guess."""
    line = residuals(load("arms/ur5_reach.toml", scheme), "line")
    # That of SE1 and semi-implicit Euler is of the last step, not zero: the end condition sees it.
    assert line.primal < (1e-2 if VELOCITY_TAU[scheme] == 1.0 else 1e-10)
    arm = load("arms/ur5_reach.toml", scheme)
    rest = residuals(arm.with_(goal=replace(arm.goal, q=arm.q_start)), "hold")
    assert rest.primal < 1e-10
