r"""Drives: how prescribed motions enter the velocities.

A robot with drives has :math:`v = V(q)\,s + U(q)\,u`. The speeds s are the velocity components that no drive
moves, in order, then the speed of each drive whose control is an acceleration; controls that are velocities
enter through U. Without drives V is the identity and s = v.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._text import quote_all
from mbocp._tolerances import DIRECTION_TOLERANCE
from mbocp.exceptions import InvalidValue
from mbocp.robot import kinematics
from mbocp.robot.model import RobotModel
from mbocp.robot.parts import Drive


def drive_column(model: pin.Model, drive: Drive, q: Array) -> Array:
    """S(q) among all velocity components: v for a speed of 1, shape (nv,)."""
    return _drive_columns(model, drive, q[None])[0]


def _drive_columns(model: pin.Model, drive: Drive, qs: Array) -> Array:
    """S(q) at many configurations, shape (nodes, nv)."""
    columns = np.zeros((len(qs), model.nv))
    dofs = list(drive.dofs)
    if drive.frame_id is None:
        columns[:, dofs] = 1.0
    else:  # J^T R d with J = R J_local: the rotation cancels
        jacobians = kinematics.frame_jacobians(model, qs, drive.frame_id, pin.LOCAL)[:, :3]
        columns[:, dofs] = np.einsum("nij,i->nj", jacobians[:, :, dofs], drive.direction)
    return columns


def name_moved_joints(robot: RobotModel, dofs: Sequence[int]) -> list[str]:
    """Names of the joints that velocity components belong to."""
    return robot.joints_with(np.isin(np.arange(robot.nv), dofs))


def name_joints(robot: RobotModel, dofs: Sequence[int]) -> str:
    """Name these joints for a message."""
    return quote_all(name_moved_joints(robot, dofs))


def speed_maps(robot: RobotModel, qs: Array) -> Array:
    """V(q) at many configurations, shape (nodes, nv, ns)."""
    identity = np.eye(robot.nv)[:, list(robot.undriven)]
    with_state = [drive for drive in robot.drives if drive.has_state]
    columns = [_drive_columns(robot.model, drive, qs)[:, :, None] for drive in with_state]
    return np.concatenate([np.broadcast_to(identity, (len(qs), *identity.shape)), *columns], axis=2)


def control_velocity_maps(robot: RobotModel, qs: Array) -> Array:
    """U(q) at many configurations, shape (nodes, nv, nu)."""
    out = np.zeros((len(qs), robot.nv, robot.nu))
    first = robot.nu - len(robot.drives)
    for column, drive in enumerate(robot.drives, start=first):
        if not drive.has_state:
            out[:, :, column] = _drive_columns(robot.model, drive, qs)
    return out


def reduce_velocity(robot: RobotModel, q: Array, v: Array) -> Array:
    """Speeds s of a velocity: v = V s + U u for some u.

    Raises
    ------
    InvalidValue
        If there is no such s and u: the drives do not allow this velocity.
    """
    # Columns of V and U are unit vectors on different components: their transpose is their inverse.
    V, U = speed_maps(robot, q[None])[0], control_velocity_maps(robot, q[None])[0]
    left = v - V @ (V.T @ v) - U @ (U.T @ v)
    if np.abs(left).max(initial=0.0) > DIRECTION_TOLERANCE * (1.0 + np.abs(v).max(initial=0.0)):
        (drive,) = [d for d in robot.drives if int(np.argmax(np.abs(left))) in d.dofs]
        moved = ", ".join(f"{robot.v_labels[dof].name} = {v[dof]:.6g}" for dof in drive.dofs)
        raise InvalidValue(
            f"robot {robot.name!r}: v of {name_joints(robot, drive.dofs)}",
            moved,
            f"a motion that drive {drive.name!r} allows, such as "
            + ", ".join(f"{v[dof] - left[dof]:.6g}" for dof in drive.dofs),
        )
    return np.asarray(V.T @ v, dtype=np.float64)
