"""Forces of constraints: as generalised forces they are minus the Jacobian's transpose by the multipliers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from mbocp.exceptions import UnsupportedRobot
from mbocp.robot import Coupling, Rod, load_robot
from tests.robot.urdfs import chain, write

KINDS = {
    "rod": 'type = "rod"\nlength = 0.6',
    "point": 'type = "point"',
    "weld": 'type = "weld"',
    "plane": 'type = "plane"\nnormal = [0.3, -0.2, 1]',
    "line": 'type = "line"\naxis = [0.3, -0.2, 1]',
}


@pytest.mark.parametrize("kind", KINDS)
def test_force_and_torque_do_the_work_of_the_constraint(kind: str, tmp_path: Path) -> None:
    """Force and torque on frame a at its origin, and the opposite on frame b at the same point."""
    joined = f'[[constraint]]\nname = "joint"\nframes = ["l3", "l1"]\n{KINDS[kind]}\n'
    robot = load_robot(write(tmp_path, chain("revolute", "revolute", "floating"), joined))
    (constraint,) = robot.constraints
    rng = np.random.default_rng(4)
    moved = robot.integrate(robot.q0, 0.2 * rng.standard_normal(robot.nv))
    q = robot.assemble(moved)
    assert np.abs(robot.constraint_residual(q)).max() < 1e-9
    lam = rng.standard_normal(robot.nc)
    model, data = robot.model, robot.model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    a, b = (data.oMf[i] for i in (constraint.frame_a, constraint.frame_b))
    force, torque = np.split(constraint.wrench_map @ lam, 2)
    away = a.translation - b.translation
    force = away / np.linalg.norm(away) * force[0] if isinstance(constraint, Rod) else b.rotation @ force
    torque = b.rotation @ torque
    J_a, J_b = (
        pin.getFrameJacobian(model, data, i, pin.LOCAL_WORLD_ALIGNED)
        for i in (constraint.frame_a, constraint.frame_b)
    )
    on_b = np.concatenate([-force, -torque - np.cross(away, force)])
    generalised = J_a.T @ np.concatenate([force, torque]) + J_b.T @ on_b
    assert np.allclose(generalised, -robot.constraint_jacobian(q).T @ lam, rtol=0, atol=1e-9)


def test_a_coupling_has_no_force_at_a_point() -> None:
    with pytest.raises(UnsupportedRobot, match="name a constraint between frames"):
        _ = Coupling("gear", 1, 2, ratio=2.0, offset=0.0).wrench_map
