"""Whether the robot's masses are well posed at its initial pose."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array
from mbocp._linear import null_space
from mbocp.exceptions import UnsupportedRobot
from mbocp.robot import kinematics
from mbocp.robot.drives import free_dofs

if TYPE_CHECKING:
    from mbocp.robot.robot import Robot

__all__ = ["SingularMassMatrix", "check_mechanics"]

_RANK = 1e-9  # relative singular value below which rows count as dependent
_SHARE = 1e-3  # share of the null vector from which a joint is named


class SingularMassMatrix(UnsupportedRobot):
    """Joints that move nothing with mass or inertia; `joints` has their names."""

    def __init__(self, robot: str, joints: list[str], eigenvalue: float) -> None:
        self.robot, self.joints, self.eigenvalue = robot, tuple(joints), eigenvalue
        named, them = (", ".join(map(repr, joints)), "them") if len(joints) > 1 else (repr(joints[0]), "it")
        super().__init__(
            f"robot {robot!r}: the mass matrix is singular (scaled eigenvalue {eigenvalue:.1e}), because "
            f"nothing with mass or inertia moves with {named}. Give the links beyond a mass and an inertia, "
            f"or lock {them}: lock = {json.dumps(joints)}"
        )


def check_mechanics(robot: Robot) -> None:
    """Check the mass matrix at the initial pose.

    Raises
    ------
    SingularMassMatrix
        Naming the joints, unless constraints make up for it.
    """
    jacobian = robot.constraint_jacobian(robot.q0)
    free = free_dofs(robot)  # what drives move needs no mass
    mass = robot.mass_matrix(robot.q0)[np.ix_(free, free)]
    if not kinematics.is_singular(mass):
        return
    basis = null_space(jacobian[:, free], _RANK)
    if kinematics.is_singular(basis.T @ mass @ basis):
        raise _singular(robot, mass, free)


def _singular(robot: Robot, mass: Array, free: list[int]) -> SingularMassMatrix:
    values, vectors = kinematics.scaled_spectrum(mass)
    null = vectors[:, values < 10 * max(abs(values[0]), 1e-13)]
    weight = np.zeros(robot.nv)
    weight[free] = np.linalg.norm(null, axis=1)
    guilty = [n for n in robot.joint_names if weight[robot.velocity_indices(n)].max(initial=0.0) > _SHARE]
    return SingularMassMatrix(robot.name, guilty, float(values[0]))
