r"""What a constraint exerts: from its multipliers to a force and a torque.

The equations of motion are :math:`M a = f - \Phi_q^T \lambda`. So the force that frame b, or what carries it,
exerts on frame a at its origin is :math:`-R_b\,\partial\Phi/\partial p\;\lambda`, with p the position of
a's origin in the axes of b, where the rows of :math:`\Phi` are written.
"""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import UnsupportedRobot
from mbocp.robot.loops.constraints import Constraint, PointOnLine, PointOnPlane, Rod, Weld, perpendiculars
from mbocp.robot.loops.coupling import Coupling

__all__ = ["wrench_map"]


def wrench_map(constraint: Constraint) -> Array:
    """From the multipliers of all rows to force and torque on frame a, shape (6, rows) [N, N m].

    Both are in the axes of frame b, the torque about the origin of frame a; exact where the constraint holds.
    A rod has no axes of b: its force stands in the first component, along the rod, positive where it pushes.
    Torques are those of a weld; the tilts of a hinge are left out.

    Raises
    ------
    UnsupportedRobot
        If it joins joints, which has no force at a point.
    """
    if isinstance(constraint, Coupling):
        raise UnsupportedRobot(
            f"coupling {constraint.name!r} joins two joints and exerts no force at a point; name a "
            "constraint between frames"
        )
    found = np.zeros((6, len(constraint.rows)))
    if isinstance(constraint, Rod):
        found[0, 0] = -constraint.length
    elif isinstance(constraint, PointOnPlane):
        found[:3, 0] = -np.array(constraint.normal)
    elif isinstance(constraint, PointOnLine):
        found[:3] = -np.array(perpendiculars(constraint.axis)).T
    else:
        found[:3, :3] = -np.eye(3)
    if isinstance(constraint, Weld):
        found[3:, 3:] = -np.eye(3)
    return found
