"""The symbolic equations of motion against the robot's own numbers."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.mechanics import JointMechanics
from mbocp.robot import Robot, load_robot

NAMES = (
    "ur5", "kinova", "hector", "double_pendulum", "rigid_pendulum", "elastic_pendulum", "cart_pendulum_rigid",
    "cart_pendulum_elastic",
)  # fmt: skip

SPRUNG = """<robot name="sprung"><link name="base"/>
<link name="arm"><inertial><origin xyz="0 0 -0.5"/><mass value="2"/>
<inertia ixx="0.2" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.01"/></inertial></link>
<link name="tip"/><link name="wall"/>
<joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="10" velocity="10"/></joint>
<joint name="end" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0 0 -1"/></joint>
<joint name="mount" type="fixed"><parent link="base"/><child link="wall"/><origin xyz="1 0 0"/></joint>
</robot>"""
ELEMENTS = """urdf = "sprung.urdf"
[[spring_damper]]
name = "strut"
frames = ["tip", "wall"]
stiffness = 7.0
damping = 0.4
length = {length}
[[spring]]
name = "hard"
frames = ["tip", "wall"]
coefficient = 3.0
length = 0.5
"""


@pytest.fixture(params=[*NAMES, "sprung", "sprung-zero"])
def robot(request: pytest.FixtureRequest, tmp_path) -> Robot:
    if not request.param.startswith("sprung"):
        return load_robot(request.param)
    (tmp_path / "sprung.urdf").write_text(SPRUNG)
    (tmp_path / "robot.toml").write_text(ELEMENTS.format(length=0.0 if "zero" in request.param else 0.8))
    return load_robot(tmp_path / "robot.toml")


def numbers(expression: ca.SX, symbols: list[ca.SX], values: list[np.ndarray]) -> np.ndarray:
    return np.asarray(ca.DM(ca.Function("f", symbols, [ca.densify(expression)])(*values)))


def test_equations_of_motion(robot: Robot) -> None:
    mechanics = JointMechanics(robot)
    q, v, a, u = (
        ca.SX.sym(n, k) for n, k in (("q", robot.nq), ("v", robot.nv), ("a", robot.nv), ("u", robot.nu))
    )
    data = robot.model.createData()
    rng = np.random.default_rng(0)
    for _ in range(3):
        at = robot.integrate(robot.q0, 0.5 * rng.standard_normal(robot.nv))
        rate, acceleration = rng.standard_normal(robot.nv), rng.standard_normal(robot.nv)
        control = rng.standard_normal(robot.nu)
        torque = numbers(mechanics.inverse_dynamics(q, v, a), [q, v, a], [at, rate, acceleration]).ravel()
        assert np.allclose(
            torque, pin.rnea(robot.model, data, at, rate, acceleration), rtol=1e-11, atol=1e-11
        )
        force = numbers(mechanics.force(q, v, u), [q, v, u], [at, rate, control]).ravel()
        expected = robot.actuation_matrix(at) @ control + robot.force_elements(at, rate)
        assert np.allclose(force, expected, rtol=1e-11, atol=1e-11)
        momentum = numbers(mechanics.momentum(q, v), [q, v], [at, rate]).ravel()
        assert np.allclose(momentum, robot.momentum(at, rate), rtol=1e-11, atol=1e-12)
        phi = numbers(mechanics.constraints(q), [q], [at]).reshape(robot.nc)
        assert np.allclose(phi, robot.constraint_residual(at), rtol=1e-11, atol=1e-12)


def test_force_elements_are_conservative_but_for_the_damper(robot: Robot) -> None:
    """The force is minus the slope of the potential energy, gravity taken out, along any direction."""
    rng = np.random.default_rng(1)
    at, direction, h = (
        robot.integrate(robot.q0, 0.2 * rng.standard_normal(robot.nv)),
        rng.standard_normal(robot.nv),
        1e-6,
    )

    def potential(q: np.ndarray) -> float:
        data = robot.model.createData()
        return robot.potential_energy(q) - pin.computePotentialEnergy(robot.model, data, q)

    slope = (
        potential(robot.integrate(at, h * direction)) - potential(robot.integrate(at, -h * direction))
    ) / (2 * h)
    assert robot.force_elements(at, np.zeros(robot.nv)) @ direction == pytest.approx(-slope, abs=1e-6)


def test_one_joint_is_enough_for_a_whole_solve(tmp_path) -> None:
    """Pinocchio hands out single columns as vectors; nothing on the way may stumble over that."""
    (tmp_path / "sprung.urdf").write_text(SPRUNG)
    (tmp_path / "robot.toml").write_text(ELEMENTS.format(length=0.8))
    problem = mbocp.Problem.create(
        tmp_path / "robot.toml",
        1.0,
        40,
        start={"q": [0.3]},
        goal={"q": [1.2], "v": [0.0]},
        cost={},
        scheme="se1",
    )
    solution = mbocp.solve(problem)
    assert solution.converged, solution.advice
    assert solution.q_final == pytest.approx([1.2], abs=1e-10)
