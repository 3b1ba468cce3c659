"""Checks of drives: the directions in which they move, and the components on which they act."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._tolerances import DIRECTION_TOLERANCE
from mbocp.exceptions import UnsupportedRobot
from mbocp.robot import kinematics
from mbocp.robot.drives import drive_column, moved_joints
from mbocp.robot.parts import Drive
from mbocp.robot.robot import Robot

_NUM_SAMPLES = 5  # random configurations at which a drive is checked
_SEED = 20170


def check_drives(robot: Robot) -> None:
    """Check at random configurations that drives move their frames, and act on no other component.

    Raises
    ------
    UnsupportedRobot
        If the joints of a drive do not move its frame along orthonormal directions, if they cannot move it
        along its direction, or if the acceleration of a drive whose control is a velocity would act on
        components that are not driven: that acceleration is an impulse wherever the control jumps.
    """
    for q in _random_configurations(robot) if robot.drives else ():
        for drive in robot.drives:
            if drive.frame_id is not None:
                _check_frame(robot, drive, drive.frame_id, q)
            if not drive.has_state:
                _check_impulse(robot, drive, q)


def _check_frame(robot: Robot, drive: Drive, frame_id: int, q: Array) -> None:
    jacobian = kinematics.frame_jacobian(robot.model, q, frame_id, pin.LOCAL)[:3, list(drive.dofs)]
    frame = robot.frame_names[frame_id]
    where = f"robot {robot.name!r}: drive {drive.name!r}"
    gram = jacobian.T @ jacobian
    if np.abs(gram - np.eye(len(gram))).max() > DIRECTION_TOLERANCE:
        raise UnsupportedRobot(
            f"{where}: its joints must move frame {frame!r} along orthogonal directions, at unit speed each; "
            f"{_joints(robot, drive.dofs)} do not at every configuration. Name the joints that slide, in a "
            "row, before anything turns"
        )
    speed = float(np.linalg.norm(jacobian.T @ drive.direction))
    if abs(speed - 1.0) > DIRECTION_TOLERANCE:
        raise UnsupportedRobot(
            f"{where}: {_joints(robot, drive.dofs)} cannot always move frame {frame!r} along direction "
            f"{drive.direction.tolist()} (only {speed:.3g} of it): name all joints that it takes, or another "
            "direction"
        )


def _check_impulse(robot: Robot, drive: Drive, q: Array) -> None:
    column, free = drive_column(robot.model, drive, q), list(robot.undriven)
    mass = robot.mass_matrix(q)
    momentum = np.abs((mass @ column)[free])
    threshold = DIRECTION_TOLERANCE * float(np.abs(mass).max())
    remedy = 'Its control is a velocity, which may jump: an impulse. Use control = "acceleration"'
    if momentum.max(initial=0.0) > threshold:
        coupled = [free[i] for i in np.flatnonzero(momentum > threshold)]
        raise UnsupportedRobot(
            f"robot {robot.name!r}: the acceleration of drive {drive.name!r} acts on joint "
            f"{_joints(robot, coupled)}. {remedy}"
        )
    rates = robot.constraint_jacobian(q) @ column
    if np.abs(rates).max(initial=0.0) > DIRECTION_TOLERANCE:
        row = robot.constraint_labels[int(np.argmax(np.abs(rates)))]
        raise UnsupportedRobot(
            f"robot {robot.name!r}: the motion of drive {drive.name!r} pulls at constraint {row.name!r}. "
            f"{remedy}"
        )


def _random_configurations(robot: Robot) -> Iterator[Array]:
    rng = np.random.default_rng(_SEED)
    for _ in range(_NUM_SAMPLES):
        step = rng.uniform(-np.pi, np.pi, robot.nv)
        yield np.asarray(pin.integrate(robot.model, np.array(robot.q0), step), dtype=np.float64)


def _joints(robot: Robot, dofs: Sequence[int]) -> str:
    return ", ".join(map(repr, moved_joints(robot, dofs)))
