"""The first paper's systems, against its formulas (sections 6.1 to 6.3)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mbocp._arrays import Array
from mbocp.robot import Robot, load_robot

SYSTEMS = ["elastic_pendulum", "rigid_pendulum", "cart_pendulum_rigid", "cart_pendulum_elastic"]
K, L_O, M_BOB, A = 0.6, 5.0, 1.0, 9.81  # 6.1 and 6.2
M_1, M_2, A_CART, LAMBDA, L_SQUARE = 2.0, 0.2, 1.0, 10.0, 1.25  # 6.3


def samples(robot: Robot, count: int = 5) -> list[Array]:
    generator = np.random.default_rng(20)
    return [robot.q0 + generator.normal(size=robot.nq) for _ in range(count)]


def gradient(function: Callable[[Array], Array | float], q: Array, h: float = 1e-5) -> Array:
    columns = [
        (np.asarray(function(q + h * e)) - np.asarray(function(q - h * e))) / (2 * h) for e in np.eye(q.size)
    ]
    return np.array(columns).T


def elastic_potential(q: Array) -> float:
    return K / (8 * L_O**2) * (q @ q - L_O**2) ** 2 + M_BOB * A * q[2]


def cart_distance_square(q: Array) -> float:
    return float((q[1] - q[0]) ** 2 + q[2] ** 2)


@pytest.mark.parametrize("name", SYSTEMS)
def test_coordinates_are_the_papers(name: str) -> None:
    robot = load_robot(name)
    assert robot.nq == robot.nv == 3
    assert robot.is_vector_space
    assert not robot.has_limits
    masses = [M_BOB] * 3 if "cart" not in name else [M_1, M_2, M_2]
    for q in samples(robot):
        np.testing.assert_array_equal(robot.mass_matrix(q), np.diag(masses))
        np.testing.assert_allclose(robot.momentum(q, [1, 2, 3]), masses * np.array([1, 2, 3]))
        np.testing.assert_allclose(robot.velocity_from_momentum(q, masses), np.ones(3))
        np.testing.assert_array_equal(robot.integrate(q, np.arange(3.0)), q + np.arange(3.0))


@pytest.mark.parametrize("name", SYSTEMS)
def test_forces_are_the_gradient_of_the_potential(name: str) -> None:
    robot = load_robot(name, gravity=(0, 0, 0))
    for q in samples(robot):
        force = robot.force_elements(q, np.zeros(3))
        np.testing.assert_allclose(force, -gradient(robot.potential_energy, q), rtol=1e-8, atol=1e-8)


def test_elastic_pendulum() -> None:
    robot = load_robot("elastic_pendulum")
    assert (robot.nu, robot.nc) == (3, 0)
    for q in samples(robot):
        assert robot.potential_energy(q) == pytest.approx(elastic_potential(q), rel=1e-13)
        np.testing.assert_array_equal(robot.actuation_matrix(q), np.eye(3))
    np.testing.assert_array_equal(robot.q0, [-2, -5, -5])
    assert load_robot("elastic_pendulum", gravity=(0, 0, -9.8)).potential_energy([0, 0, 5]) == pytest.approx(
        49.0
    )


def test_rigid_pendulum() -> None:
    robot = load_robot("rigid_pendulum")
    assert (robot.nu, robot.nc) == (3, 1)
    np.testing.assert_array_equal(robot.constraint_residual(robot.q0), [0.0])
    for q in samples(robot):
        np.testing.assert_allclose(robot.constraint_residual(q), [0.5 * (q @ q - L_O**2)], rtol=1e-14)
        np.testing.assert_allclose(robot.constraint_jacobian(q), [q], rtol=1e-14)
        assert robot.potential_energy(q) == pytest.approx(M_BOB * A * q[2], rel=1e-14)


@pytest.mark.parametrize("name", SYSTEMS[2:])
def test_carts(name: str) -> None:
    robot = load_robot(name)
    assert [label.name for label in robot.q_labels] == ["cart_x", "pendulum_x", "pendulum_z"]
    np.testing.assert_array_equal(robot.q0, [0, 0.5, 1])
    for q in samples(robot):
        np.testing.assert_array_equal(robot.actuation_matrix(q), [[1], [0], [0]])
        gap = cart_distance_square(q) - L_SQUARE
        elastic = LAMBDA / 4 * gap**2 if robot.forces else 0.0
        assert robot.potential_energy(q) == pytest.approx(M_2 * A_CART * q[2] + elastic, rel=1e-13)
        if robot.nc:
            np.testing.assert_allclose(robot.constraint_residual(q), [0.5 * gap], rtol=1e-13)
            expected = [-(q[1] - q[0]), q[1] - q[0], q[2]]
            np.testing.assert_allclose(robot.constraint_jacobian(q), [expected], rtol=1e-13)
            np.testing.assert_allclose(
                robot.constraint_jacobian(q), gradient(robot.constraint_residual, q), rtol=1e-8
            )


@pytest.mark.parametrize("name", SYSTEMS)
def test_something_is_drawn_between_the_bodies(name: str) -> None:
    robot = load_robot(name)
    (connector,) = robot.connectors
    assert connector.kind == ("rod" if robot.nc else "spring")
    assert {connector.frame_a, connector.frame_b} == {
        frame for pair in (*robot.constraints, *robot.forces) for frame in (pair.frame_a, pair.frame_b)
    }
    assert "bob" in robot.trace_frames
    assert len(robot.visual_model.geometryObjects) >= 3
