"""Accelerations of closed loops, against Pinocchio's own constrained dynamics."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from mbocp.mechanics.forward import ForwardMechanics
from mbocp.mechanics.joint_mechanics import JointMechanics
from mbocp.robot import Robot, load_robot
from tests.robot.loops import builders as loops

SPATIAL = (  # an arm of six hinges whose hand slides on a table, and a second arm that it holds
    '<robot name="spatial"><link name="base"/>'
    + "".join(loops.link(f"l{i}", 0.3) for i in range(1, 10))
    + loops.joint("j1", "base", "l1", axis="0 0 1")
    + "".join(
        loops.joint(f"j{i}", f"l{i - 1}", f"l{i}", "0.3 0 0.1", axis=axis)
        for i, axis in ((2, "0 1 0"), (3, "1 0 0"), (4, "0 1 1"), (5, "1 0 1"), (6, "0 1 0"))
    )
    + loops.joint("k1", "base", "l7", "0.5 0.2 0", axis="0 1 0")
    + loops.joint("k2", "l7", "l8", "0.3 0 0", axis="0 0 1")
    + loops.joint("k3", "l8", "l9", "0.3 0.1 0", axis="1 0 0")
    + loops.tip("end", "l6", 0.2)
    + loops.tip("other", "l9", 0.25)
    + "</robot>"
)
LOOP = '[[constraint]]\ntype = "{}"\nname = "loop"\nframes = ["{}", "{}"]\n'
START = "[initial]\nq = { j1 = 0.1, k1 = 0.2 }\n"
PLANAR = loops.MOTOR + loops.OPEN_POSE

CASES = {
    "four-bar, a 3-D contact": (loops.four_bar(), PLANAR + loops.POINT, "point"),
    "four-bar, a 6-D contact": (loops.four_bar(wrist=True), PLANAR + loops.WELD, "weld"),
    "turned four-bar": (loops.four_bar(tilt="0.3 0.4 0.5"), PLANAR + loops.POINT, "point"),
    "spatial, 3-D": (SPATIAL, START + LOOP.format("point", "end", "other"), "point"),
    "spatial, 6-D": (SPATIAL, START + LOOP.format("weld", "other", "end"), "weld"),
}


def contact(robot: Robot, kind: str) -> pin.RigidConstraintModel:
    (constraint,) = robot.constraints
    a, b = (robot.model.frames[f] for f in (constraint.frame_a, constraint.frame_b))
    dimension = pin.ContactType.CONTACT_3D if kind == "point" else pin.ContactType.CONTACT_6D
    return pin.RigidConstraintModel(
        dimension, robot.model, a.parentJoint, a.placement, b.parentJoint, b.placement
    )


@pytest.mark.parametrize("name", CASES)
def test_accelerations_are_those_of_pinocchio(tmp_path: Path, name: str) -> None:
    urdf, toml, kind = CASES[name]
    robot = loops.load(tmp_path, urdf, toml)
    rng = np.random.default_rng(3)
    mechanics = ForwardMechanics(robot)
    q, v, u = ca.SX.sym("q", robot.nq), ca.SX.sym("v", robot.nv), ca.SX.sym("u", robot.nu)
    rate = ca.Function("rate", [q, v, u], [mechanics.speed_rate(q, v, u, ca.SX(0))])
    model, constraints = robot.model, pin.StdVec_RigidConstraintModel()
    constraints.append(contact(robot, kind))
    for _ in range(3):
        at = robot.assemble(robot.integrate(robot.q0, 0.1 * rng.standard_normal(robot.nv)))
        along = robot.assemble_velocity(at, rng.standard_normal(robot.nv))
        control = rng.standard_normal(robot.nu)
        data, memory = model.createData(), pin.StdVec_RigidConstraintData()
        for constraint in constraints:
            memory.append(constraint.createData())
        pin.initConstraintDynamics(model, data, constraints, memory)
        tau = robot.actuation_matrix(at) @ control
        settings = pin.ProximalSettings(1e-13, 1e-9, 200)
        expected = pin.constraintDynamics(model, data, at, along, tau, constraints, memory, settings)
        got = rate(at, along, control).full().ravel()
        scale = max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-10 * scale)


@pytest.mark.parametrize("name", CASES)
def test_symbols_and_numbers_agree(tmp_path: Path, name: str) -> None:
    urdf, toml, _ = CASES[name]
    robot = loops.load(tmp_path, urdf, toml)
    mechanics = JointMechanics(robot)
    q = ca.SX.sym("q", robot.nq)
    both = ca.Function("both", [q], [mechanics.constraints(q), mechanics.constraint_jacobian(q)])
    at = robot.integrate(robot.q0, np.random.default_rng(4).standard_normal(robot.nv))
    phi, jacobian = (np.array(value) for value in both(at))
    assert phi.shape == (robot.nc, 1)
    np.testing.assert_allclose(phi.ravel(), robot.constraint_residual(at), atol=1e-14)
    np.testing.assert_allclose(jacobian, robot.constraint_jacobian(at), atol=1e-13)


@pytest.mark.parametrize("rotations", ["quaternion", "dcm"])
def test_equations_of_a_loop_have_its_own_joints_alone(rotations: str) -> None:
    """Of a five-bar on a floating base: the base is in neither Phi nor its derivative, wherever it is."""
    robot = load_robot("five_bar", free_flyer=True)
    mechanics = JointMechanics(robot, rotations)
    z = ca.SX.sym("z", mechanics.nq)
    both = ca.Function("both", [z], [mechanics.constraints(z), mechanics.constraint_jacobian(z)])
    assert both.sparsity_out(1).nnz() == robot.nc * 4
    q = robot.integrate(robot.q0, np.random.default_rng(5).standard_normal(robot.nv))
    phi, jacobian = (np.array(value) for value in both(mechanics.space.coordinates(q[np.newaxis])[0]))
    np.testing.assert_allclose(phi.ravel(), robot.constraint_residual(q), atol=1e-14)
    np.testing.assert_allclose(jacobian, robot.constraint_jacobian(q), atol=1e-14)


def test_energy_changes_by_the_work_of_the_motor(tmp_path: Path) -> None:
    """The constraint forces do no work: dE/dt = u * crank speed at any closed state."""
    robot = loops.load(tmp_path, loops.four_bar(), loops.MOTOR + loops.OPEN_POSE + loops.HINGE)
    mechanics = ForwardMechanics(robot)
    q, v, u = ca.SX.sym("q", 3), ca.SX.sym("v", 3), ca.SX.sym("u", 1)
    a = mechanics.speed_rate(q, v, u, ca.SX(0))
    energy = mechanics.potential_energy(q) + v.T @ mechanics.mass_matrix(q) @ v / 2
    power = ca.jacobian(energy, q) @ v + ca.jacobian(energy, v) @ a
    work = ca.Function("work", [q, v, u], [power - u * v[robot.velocity_indices("crank").start]])
    along = robot.assemble_velocity(robot.q0, [1.0, 0.0, 0.0], fixed=("crank",))
    assert along[robot.velocity_indices("crank")][0] == 1.0
    assert abs(float(work(robot.q0, along, 0.7))) < 1e-12
