"""The second paper's benchmark as a URDF: its equations of motion, eqs. (4), (5), (27) of [Manara2017]_."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mbocp._arrays import Array
from mbocp.robot import Robot, load_robot, robot_from_spec
from mbocp.symbolic import model_functions

# Table 1, and what follows from it for the joint in B.
MASS, LENGTH, GRAVITY = 1.0, 0.25, 9.81  # [kg, m, m/s^2]
INERTIA_G = np.diag([2.08e-2, 2.08e-2, 2.08e-3])  # [kg m^2]
INERTIA_B = INERTIA_G + MASS * LENGTH**2 * np.diag([1.0, 1.0, 0.0])  # [kg m^2]
BG = np.array([0.0, 0.0, LENGTH])  # [m]

UNIT = st.floats(-1.0, 1.0)
NUMBERS = arrays(np.float64, 13, elements=UNIT)


@pytest.fixture(scope="module")
def unicycle() -> Robot:
    return load_robot("unicycle_pendulum")


def state(numbers: Array) -> tuple[Array, Array, Array, float]:
    """Configuration, speeds (omega, v), controls (u_theta, u_v), yaw acceleration from numbers in [-1, 1]."""
    quaternion = pin.Quaternion(pin.exp3(3.0 * numbers[:3])).coeffs()
    q = np.concatenate([2.0 * numbers[3:5], quaternion, 6.0 * numbers[5:6]])
    s = np.concatenate([8.0 * numbers[6:9], 3.0 * numbers[9:10]])
    return q, s, 6.0 * numbers[10:12], 50.0 * float(numbers[12])


def driven_acceleration(s: Array, u: Array, theta: float, yaw_acceleration: float) -> Array:
    """Acceleration of x_B, y_B and theta, shape (3,): d/dt of v (cos, sin), and what is given."""
    forward, left = np.array([np.cos(theta), np.sin(theta)]), np.array([-np.sin(theta), np.cos(theta)])
    a_B: Array = u[1] * forward + s[3] * u[0] * left
    return np.array([*a_B, yaw_acceleration])


def free_acceleration(robot: Robot, q: Array, v: Array, driven: Array) -> Array:
    """Undriven accelerations: the rows of the inverse dynamics without drives vanish."""
    free = [dof for dof in range(robot.nv) if dof not in robot.driven]
    a = np.zeros(robot.nv)
    a[list(robot.driven)] = driven
    residual = pin.rnea(robot.model, robot.model.createData(), q, v, a)[free]
    found: Array = -np.linalg.solve(robot.mass_matrix(q)[np.ix_(free, free)], residual)
    return found


def closed_form(q: Array, s: Array, a_B: Array) -> Array:
    """Fourth row of eq. (27) with eq. (5): angular acceleration in the pendulum's axes."""
    R, omega = pin.Quaternion(*q[[5, 2, 3, 4]]).matrix(), s[:3]
    F_B = -MASS * R.T @ np.array([a_B[0], a_B[1], GRAVITY])
    return np.linalg.solve(INERTIA_B, np.cross(BG, F_B) - np.cross(omega, INERTIA_B @ omega))


def test_what_it_is(unicycle: Robot) -> None:
    assert [str(label) for label in unicycle.u_labels] == ["yaw_rate [rad/s]", "forward [m/s^2]"]
    assert [str(label) for label in unicycle.speed_labels] == [
        "pendulum.wx [rad/s]", "pendulum.wy [rad/s]", "pendulum.wz [rad/s]", "forward [m/s]",
    ]  # fmt: skip
    assert [label.name for label in unicycle.v_labels] == [
        "base_x", "base_y", "pendulum.wx", "pendulum.wy", "pendulum.wz", "yaw",
    ]  # fmt: skip
    assert unicycle.driven == (0, 1, 5)
    np.testing.assert_array_equal(unicycle.limits.effort, [2 * np.pi, 6.0])
    assert not np.isfinite(unicycle.limits.position_upper).any()
    assert unicycle.trace_frames == ("joint_B", "pendulum_tip")
    assert robot_from_spec(unicycle.spec).fingerprint == unicycle.fingerprint


def test_where_its_frames_are(unicycle: Robot) -> None:
    data = unicycle.model.createData()
    pin.framesForwardKinematics(unicycle.model, data, unicycle.q0)
    for frame, height in (("axle", 0.05), ("joint_B", 0.05), ("pendulum_com", -0.2), ("pendulum_tip", -0.45)):
        np.testing.assert_allclose(data.oMf[unicycle.frame_id(frame)].translation, [0, 0, height], atol=1e-15)
    assert unicycle.potential_energy(unicycle.q0) == pytest.approx(9.81 * (1.0 * 0.05 - 0.2))


def test_its_inertias_are_those_of_table_1(unicycle: Robot) -> None:
    mass = unicycle.mass_matrix(unicycle.q0)
    np.testing.assert_allclose(mass[:2, :2], np.eye(2) * (0.5 + 2 * 0.25 + 1.0), rtol=1e-14)
    np.testing.assert_allclose(mass[2:5, 2:5], INERTIA_B, rtol=1e-14, atol=1e-17)
    assert mass[5, 5] == pytest.approx(1.66e-3 + 2 * 1.625e-4 + 2 * 0.25 * 0.1**2, rel=1e-14)  # eq. (24)
    np.testing.assert_allclose(mass[5, :5], 0.0, atol=1e-17)


@given(NUMBERS)
def test_speeds_are_those_of_the_paper(unicycle: Robot, numbers: Array) -> None:
    """x' = v cos(theta), y' = v sin(theta), theta' = u_theta: rows 1 to 3 of eq. (27), corrected."""
    q, s, u, _ = state(numbers)
    v = unicycle.speed_map(q) @ s + unicycle.control_velocity_map(q) @ u
    wanted = [s[3] * np.cos(q[6]), s[3] * np.sin(q[6]), *s[:3], u[0]]
    np.testing.assert_allclose(v, wanted, atol=1e-14)


@given(NUMBERS)
def test_the_pendulum_accelerates_as_in_the_paper(unicycle: Robot, numbers: Array) -> None:
    q, s, u, jump = state(numbers)
    v = unicycle.speed_map(q) @ s + unicycle.control_velocity_map(q) @ u
    for yaw_acceleration in (0.0, jump):  # the control may jump: nothing feels it
        driven = driven_acceleration(s, u, q[6], yaw_acceleration)
        found = free_acceleration(unicycle, q, v, driven)
        np.testing.assert_allclose(
            found, closed_form(q, s, driven), rtol=1e-12, atol=1e-12 * GRAVITY / LENGTH
        )


@given(NUMBERS)
def test_accelerations_of_the_joint_are_the_derivative_of_its_velocity(
    unicycle: Robot, numbers: Array
) -> None:
    """Rows 1 and 2 of eq. (27) as printed, and eq. (3): d/dt of S(q) v with theta' = u_theta, v' = u_v."""
    q, s, u, _ = state(numbers)
    step = 1e-5
    motion = unicycle.speed_map(q) @ s + unicycle.control_velocity_map(q) @ u
    ahead, behind = (
        unicycle.speed_map(unicycle.integrate(q, h * motion))[:2, 3] * (s[3] + h * u[1])
        for h in (step, -step)
    )
    wanted = driven_acceleration(s, u, q[6], 0.0)[:2]
    np.testing.assert_allclose((ahead - behind) / (2 * step), wanted, atol=1e-7)


def test_the_symbolic_functions_agree(unicycle: Robot) -> None:
    rng = np.random.default_rng(5)
    functions = model_functions(unicycle.model)
    q, v, a = np.array(unicycle.q0), *rng.standard_normal((2, unicycle.nv))
    wanted = pin.rnea(unicycle.model, unicycle.model.createData(), q, v, a)
    np.testing.assert_allclose(np.array(functions.rnea(q, v, a)).ravel(), wanted, atol=1e-13)
