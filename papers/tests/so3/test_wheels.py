"""The second paper's numbers hold together with the robot; forces at its wheels against Pinocchio's."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from mbocp_papers.so3 import (
    CHOICES,
    FORMULATIONS,
    UNICYCLE,
    Unicycle,
    lattice,
    wheel_efforts,
    wheel_efforts_of_joints,
)
from mbocp_papers.so3.data import HANGING, formulation
from mbocp_papers.so3.wheels import centre_acceleration, pendulum_acceleration, yaw_accelerations

from mbocp._arrays import Array
from mbocp.exceptions import DimensionMismatch, InvalidValue
from mbocp.integrators import LIE_METHODS
from mbocp.robot import Robot, load_robot

DT = 0.03  # [s]
STEPS = 40


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("unicycle_pendulum")


@pytest.fixture
def motion(robot: Robot) -> tuple[Array, Array, Array]:
    """Any qs, vs, us that the drives allow: inverse dynamics does not ask where they come from."""
    rng = np.random.default_rng(11)
    qs, vs, us = [], [], rng.uniform(-6.0, 6.0, (STEPS, 2))
    for n in range(STEPS + 1):
        q = np.array(pin.integrate(robot.model, robot.neutral(), rng.uniform(-3.0, 3.0, robot.nv)))
        u = us[min(n, STEPS - 1)]
        s = rng.uniform(-5.0, 5.0, robot.num_speeds)
        qs.append(q)
        vs.append(robot.speed_map(q) @ s + robot.control_velocity_map(q) @ u)
    return np.array(qs), np.array(vs), us


def accelerations(robot: Robot, q: Array, v: Array, u: Array, yaw: float) -> Array:
    """All accelerations: the given ones, and those with which the undriven rows of the dynamics vanish."""
    cos, sin = np.cos(q[6]), np.sin(q[6])
    speed = v[0] * cos + v[1] * sin
    a = np.zeros(robot.nv)
    a[[0, 1, 5]] = u[1] * cos - speed * u[0] * sin, u[1] * sin + speed * u[0] * cos, yaw
    free = slice(2, 5)
    rest = pin.rnea(robot.model, robot.model.createData(), q, v, a)[free]
    a[free] = -np.linalg.solve(robot.mass_matrix(q)[free, free], rest)
    return a


def test_table_1_is_what_the_robot_has(robot: Robot) -> None:
    mass = robot.mass_matrix(robot.q0)
    assert mass[0, 0] == UNICYCLE.m_a + 2 * UNICYCLE.m_w + UNICYCLE.m_p
    assert mass[5, 5] == pytest.approx(UNICYCLE.J_yaw, rel=1e-14)
    np.testing.assert_allclose(np.diag(mass)[2:5], UNICYCLE.J_pB, rtol=1e-14)
    assert robot.model.gravity.linear[2] == -UNICYCLE.g
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.neutral())
    positions = {name: data.oMf[robot.frame_id(name)].translation for name in robot.frame_names[1:]}
    np.testing.assert_allclose(positions["wheel_left"], [0, UNICYCLE.a, UNICYCLE.r])
    np.testing.assert_allclose(positions["wheel_right"], [0, -UNICYCLE.a, UNICYCLE.r])
    np.testing.assert_allclose(positions["pendulum_com"], [UNICYCLE.d, 0, UNICYCLE.r + UNICYCLE.l])
    np.testing.assert_allclose(positions["pendulum_tip"], [UNICYCLE.d, 0, UNICYCLE.r + 2 * UNICYCLE.l])
    np.testing.assert_array_equal(robot.q0[2:6], HANGING)
    np.testing.assert_array_equal(robot.limits.effort, [CHOICES.yaw_rate, CHOICES.acceleration])


def test_the_lattice() -> None:
    tasks = lattice()
    assert len(tasks) == len(set(tasks)) == 2028
    assert sorted({task.x for task in tasks}) == sorted({task.y for task in tasks})
    np.testing.assert_allclose(np.diff(sorted({task.x for task in tasks})), 1 / 6)
    assert {(t.x, t.y) for t in tasks} >= {(-1.0, -1.0), (1.0, 1.0), (0.0, 0.0)}
    np.testing.assert_allclose(sorted({task.yaw for task in tasks}), np.pi / 6 * np.arange(12))
    assert [(t.x, t.y, t.yaw) for t in lattice(1, 2)] == [(0.0, 0.0, 0.0), (0.0, 0.0, np.pi)]


def test_the_formulations() -> None:
    assert {(f.rotations, f.lie) for f in FORMULATIONS} == {
        (rotations, lie) for rotations in ("quaternion", "dcm") for lie in LIE_METHODS
    }
    assert formulation("DCM RK+BG").lie == "baumgarte"


def test_forces_are_those_of_the_drives(robot: Robot, motion: tuple[Array, Array, Array]) -> None:
    """F_r + F_l of eq. (23) is what the drive "forward" supplies, (F_r - F_l) a of eq. (24) "yaw_rate"."""
    qs, vs, us = motion
    efforts = wheel_efforts_of_joints(qs, vs, us, DT)
    yaws = yaw_accelerations(us[:, 0], DT)
    for n in range(STEPS):
        a = accelerations(robot, qs[n], vs[n], us[n], yaws[n])
        turn, forward = robot.drive_forces(qs[n], vs[n], a)
        right, left = efforts.force_right[n], efforts.force_left[n]
        assert right + left == pytest.approx(forward, rel=1e-11, abs=1e-11)
        assert (right - left) * UNICYCLE.a == pytest.approx(turn, rel=1e-11, abs=1e-13)


def test_torques_turn_the_wheels(motion: tuple[Array, Array, Array]) -> None:
    """Eq. (26) with the wheels' accelerations from eqs. (1), (2)."""
    qs, vs, us = motion
    efforts = wheel_efforts_of_joints(qs, vs, us, DT)
    right_dd = (efforts.torque_right - efforts.force_right * UNICYCLE.r) / UNICYCLE.J_w
    left_dd = (efforts.torque_left - efforts.force_left * UNICYCLE.r) / UNICYCLE.J_w
    turning = UNICYCLE.r / (2 * UNICYCLE.a) * (right_dd - left_dd)
    np.testing.assert_allclose(turning, yaw_accelerations(us[:, 0], DT), rtol=1e-9)
    np.testing.assert_allclose(UNICYCLE.r / 2 * (right_dd + left_dd), us[:, 1], rtol=1e-9)


def test_the_centre_of_mass_accelerates_as_corrected(
    robot: Robot, motion: tuple[Array, Array, Array]
) -> None:
    """Eq. (25) needs the angular acceleration in its first term."""
    qs, vs, us = motion
    frame = robot.frame_id("pendulum_com")
    for q, v, u in zip(qs, vs, us, strict=False):
        a = accelerations(robot, q, v, u, 0.0)
        data = robot.model.createData()
        pin.forwardKinematics(robot.model, data, q, v, a)
        pin.updateFramePlacements(robot.model, data)
        found = pin.getFrameClassicalAcceleration(robot.model, data, frame, pin.LOCAL_WORLD_ALIGNED).linear
        R, omega, a_B = data.oMf[frame].rotation[None], v[None, 2:5], np.array([[a[0], a[1], 0.0]])
        omega_dot = pendulum_acceleration(R, omega, a_B)
        np.testing.assert_allclose(omega_dot[0], a[2:5], rtol=1e-11, atol=1e-11)
        (wanted,) = centre_acceleration(R, omega, omega_dot, a_B)
        np.testing.assert_allclose(found, wanted, rtol=1e-11, atol=1e-11)
        (printed,) = centre_acceleration(R, omega, omega, a_B)
        assert np.abs(found - printed).max() > 0.1


def test_standing_upright_needs_nothing() -> None:
    upright = np.tile(np.eye(3), (4, 1, 1))
    efforts = wheel_efforts(np.zeros(4), np.zeros(4), upright, np.zeros((4, 3)), np.zeros((3, 2)), DT)
    for values in (efforts.force_right, efforts.force_left, efforts.torque_right, efforts.torque_left):
        np.testing.assert_array_equal(values, np.zeros(3))


def test_turning_on_the_spot() -> None:
    """A yaw rate that grows by 0.3 rad/s a step is an acceleration of 10 rad/s^2 everywhere."""
    us = np.stack([0.3 * np.arange(5), np.zeros(5)], axis=1)
    upright = np.tile(np.eye(3), (6, 1, 1))
    efforts = wheel_efforts(np.zeros(6), np.zeros(6), upright, np.zeros((6, 3)), us, DT)
    np.testing.assert_allclose(efforts.force_right, UNICYCLE.J_yaw * 10.0 / (2 * UNICYCLE.a))
    np.testing.assert_allclose(efforts.force_left, -efforts.force_right)
    np.testing.assert_array_equal(yaw_accelerations(np.ones(1), DT), [0.0])


def test_a_heavier_pendulum() -> None:
    us = np.tile([0.0, 2.0], (3, 1))
    arguments = (
        np.zeros(4),
        np.zeros(4),
        np.tile(np.diag([1.0, -1.0, -1.0]), (4, 1, 1)),
        np.zeros((4, 3)),
        us,
    )
    light, heavy = (wheel_efforts(*arguments, DT, Unicycle(m_p=m)) for m in (1e-9, 2.0))
    np.testing.assert_allclose(light.force_right, 1.0)  # (m_a + 2 m_w) u_v / 2
    assert (heavy.force_right > light.force_right).all()


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        (
            lambda a: a | {"speeds": np.zeros(3)},
            DimensionMismatch,
            r"speeds: got shape \(3,\), expected \(4,\)",
        ),
        (lambda a: a | {"omegas": np.zeros((4, 2))}, DimensionMismatch, r"omegas: .* expected \(4, 3\)"),
        (lambda a: a | {"controls": np.zeros(3)}, DimensionMismatch, r"controls: .* expected \(any, 2\)"),
        (lambda a: a | {"dt": 0.0}, InvalidValue, r"dt: got 0.0, expected a positive number \[s\]"),
    ],
)
def test_shapes(
    change: Callable[[dict[str, object]], dict[str, object]], error: type[Exception], match: str
) -> None:
    arguments: dict[str, object] = {
        "yaws": np.zeros(4),
        "speeds": np.zeros(4),
        "rotations": np.tile(np.eye(3), (4, 1, 1)),
        "omegas": np.zeros((4, 3)),
        "controls": np.zeros((3, 2)),
        "dt": DT,
    }
    with pytest.raises(error, match=match):
        wheel_efforts(**change(arguments))  # type: ignore[arg-type]
