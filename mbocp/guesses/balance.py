"""Controls and multipliers that balance the inverse dynamics of a motion."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TypeVar

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.mechanisms.closed_path import constraint_jacobians
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.programme.compiler import check_deadline
from mbocp.robot import Robot
from mbocp.robot.large import working_data

_T = TypeVar("_T")


def required_force(robot: Robot, q: Array, v: Array, a: Array) -> Array:
    """Generalised force that actuators and constraints have to supply for a motion, shape (nv,)."""
    force: Array = pin.rnea(robot.model, working_data(robot.model), q, v, a)
    return force - robot.force_elements(q, v) if robot.has_forces else force


def balances(
    robot: Robot,
    qs: Array,
    vs: Array,
    accelerations: Array,
    table: SwitchTable | None = None,
    deadline: float = math.inf,
) -> tuple[Array, Array]:
    """Controls and multipliers that balance the inverse dynamics best along a motion.

    With a table the multipliers of what is held follow those of the robot; those of impacts are zero.

    Raises
    ------
    CompilationTimeout
        If the deadline, a time of `time.perf_counter`, passes.
    """
    motion: Iterable[tuple[Array, Array, Array]] = zip(qs, vs, accelerations, strict=True)
    if deadline < math.inf:
        motion = _in_time(motion, deadline)
    if table is not None or robot.nc or robot.has_forces or robot.actuation.frame_actuators:
        rows = constraint_jacobians(robot, qs)
        if table is not None:
            rows = table.along(qs, rows) * ~table.is_impact[:, None, None]
        forces = np.array([required_force(robot, *at) for at in motion])
        if robot.actuation.is_constant:
            columns = np.broadcast_to(robot.actuation_matrix(qs[0]), (len(qs), robot.nv, robot.nu))
        else:
            columns = np.array([robot.actuation_matrix(q) for q in qs])
        columns = np.concatenate([columns, -rows.transpose(0, 2, 1)], axis=2)
        inverses = np.linalg.pinv(columns, rcond=np.finfo(float).eps * max(columns.shape[1:]))
        found: Array = np.einsum("nij,nj->ni", inverses, forces)
        return found[:, : robot.nu], found[:, robot.nu :]
    data, columns = working_data(robot.model), robot.actuation_matrix(qs[0])  # the same everywhere
    forces = np.array([pin.rnea(robot.model, data, *at).copy() for at in motion])
    us: Array = np.linalg.lstsq(columns, forces.T, rcond=None)[0].T
    return np.ascontiguousarray(us), np.zeros((len(qs), 0))


def _in_time(values: Iterable[_T], deadline: float) -> Iterator[_T]:
    """Values one by one, while there is time: long horizons have many."""
    for value in values:
        check_deadline(deadline, "the guess was made")
        yield value


def balance(robot: Robot, q: Array, v: Array, a: Array, dPhi_dq: Array) -> tuple[Array, Array]:
    """Controls and multipliers that balance the inverse dynamics best, in the least-squares sense."""
    columns = np.hstack([robot.actuation_matrix(q), -dPhi_dq.T])
    found = np.linalg.lstsq(columns, required_force(robot, q, v, a), rcond=None)[0]
    return found[: robot.nu], found[robot.nu :]
