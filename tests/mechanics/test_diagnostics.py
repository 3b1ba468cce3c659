"""What a trajectory says about itself, on robots that people know."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from mbocp._arrays import Array
from mbocp.exceptions import DimensionMismatch
from mbocp.mechanics.diagnostics import constraint_violation, control_momenta, manifold_drift
from mbocp.robot import Robot, load_robot
from tests.mechanics.models import spherical_pendulum

FLYING = ["translation along x", "translation along y", "translation along z", "rotation about z"]


def trajectory(robot: Robot, nodes: int = 5) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(11)
    steps = 0.1 * rng.normal(size=(nodes, robot.nv))
    qs = [robot.q0]
    for step in steps[1:]:
        qs.append(pin.integrate(robot.model, qs[-1], step))
    return np.array(qs), rng.normal(size=(nodes, robot.nv)), rng.normal(size=(nodes, 2 * robot.nv))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("ur5", ["rotation about z"]),
        ("panda", ["rotation about z"]),
        ("kinova", ["rotation about z"]),
        ("double_pendulum", []),  # both axes are horizontal
        ("hector", FLYING),
        ("iris", FLYING),
        ("solo12", FLYING),
    ],
)
def test_control_momenta_of_known_robots(name: str, expected: list[str]) -> None:
    robot = load_robot(name)
    qs, vs, costates = trajectory(robot)
    momenta, names = control_momenta(robot, qs, vs, costates)
    assert list(names) == expected
    assert momenta.shape == (5, len(expected))


def test_an_arms_momentum_is_the_first_joints_adjoint() -> None:
    robot = load_robot("ur5")
    qs, vs, costates = trajectory(robot)
    momenta, _ = control_momenta(robot, qs, vs, costates)
    np.testing.assert_allclose(momenta[:, 0], costates[:, 0], atol=1e-14)


def test_a_drones_momentum_is_the_spatial_covector() -> None:
    """Adjoint wrench about the origin of the world."""
    robot = load_robot("hector")
    qs, vs, costates = trajectory(robot)
    momenta, _ = control_momenta(robot, qs, vs, costates)
    for n in range(5):
        placement = pin.SE3(pin.Quaternion(qs[n, 3:]).toRotationMatrix(), qs[n, :3])
        wrench = placement.act(pin.Force(costates[n, :6])).vector
        np.testing.assert_allclose(momenta[n], wrench[[0, 1, 2, 5]], atol=1e-12)


def test_tracking_keeps_the_momenta_that_it_does_not_see() -> None:
    robot = load_robot("hector")
    qs, vs, costates = trajectory(robot)
    velocity_only = np.arange(12) >= 6
    assert list(control_momenta(robot, qs, vs, costates, tracked=velocity_only)[1]) == FLYING
    assert control_momenta(robot, qs, vs, costates, tracked=~velocity_only)[1] == ()


def test_momenta_of_shapes_that_do_not_fit() -> None:
    robot = load_robot("ur5")
    qs, vs, costates = trajectory(robot)
    with pytest.raises(DimensionMismatch, match="costates"):
        control_momenta(robot, qs, vs, costates[:, :6])
    with pytest.raises(DimensionMismatch, match="tracked"):
        control_momenta(robot, qs, vs, costates, tracked=np.zeros(6, dtype=bool))


def test_many_nodes_take_no_time() -> None:
    robot = load_robot("hector")
    qs = np.tile(robot.q0, (10_001, 1))
    momenta, _ = control_momenta(robot, qs, np.zeros((10_001, 6)), np.ones((10_001, 12)))
    assert momenta.shape == (10_001, 4)


def test_the_worst_constraint_has_a_name_and_a_time() -> None:
    pendulum = spherical_pendulum()
    angles = np.linspace(0.0, 1.0, 11)
    qs = 5.0 * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])  # [m]
    vs = np.column_stack([-qs[:, 1], qs[:, 0], 0 * angles])
    clean = constraint_violation(pendulum, qs, vs)
    assert clean.position < 1e-13
    assert clean.velocity < 1e-13
    qs[4] *= 1.01
    vs[7] += qs[7]
    worst = constraint_violation(pendulum, qs, vs)
    assert (worst.position_name, worst.position_node) == ("rod", 4)
    assert worst.position == pytest.approx(12.5 * (1.01**2 - 1))
    assert (worst.velocity_name, worst.velocity_node) == ("rod", 7)
    assert worst.velocity == pytest.approx(25.0)


def test_a_violation_that_is_not_a_number_is_not_hidden() -> None:
    qs = np.tile([5.0, 0.0, 0.0], (4, 1))
    with pytest.raises(Exception, match="finite"):
        constraint_violation(spherical_pendulum(), np.where(np.eye(4, 3) > 0, np.nan, qs), np.zeros((4, 3)))


def test_without_constraints_nothing_is_violated() -> None:
    robot = load_robot("ur5")
    qs, vs, _ = trajectory(robot)
    assert constraint_violation(robot, qs, vs).position == 0.0


def test_drift_from_the_manifold() -> None:
    drone, arm, kinova = (load_robot(name) for name in ("hector", "ur5", "kinova"))
    qs = np.tile(drone.q0, (3, 1))
    assert manifold_drift(drone, qs) < 1e-15
    qs[1, 3:] *= 1.0 + 1e-6
    assert manifold_drift(drone, qs) == pytest.approx(1e-6, rel=1e-6)
    assert manifold_drift(arm, np.ones((3, arm.nq))) == 0.0
    circle = np.tile(kinova.q0, (2, 1))
    circle[0, :2] = [0.6, 0.8 - 1e-5]
    assert manifold_drift(kinova, circle) == pytest.approx(0.8e-5, rel=1e-3)
