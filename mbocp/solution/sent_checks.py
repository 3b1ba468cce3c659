"""What a robot and its surroundings say of a motion as it is sent: torques, path constraints, obstacles.

What follows a motion exactly has to apply these torques.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.problem import Problem
from mbocp.solution.sent import Excess, Sent, find_excesses
from mbocp.solution.sent_path import path_excesses
from mbocp.solution.sent_states import states_of

if TYPE_CHECKING:
    from mbocp.robot import Robot

_PARTS = 4  # of a step at whose ends they are looked at
_TOLERANCE = 0.01  # relative, of a limit: polynomials between nodes are no closer to the dynamics
_MOST_CONDITION = 1e8  # of the matrix from controls to forces of joints


def check_sent(sent: Sent, problem: Problem) -> tuple[tuple[Excess, ...], tuple[str, ...]]:
    """Look at the torques that a motion takes as it is sent, and at path constraints and obstacles.

    Parameters
    ----------
    sent : Sent
    problem : Problem
        What the motion is a solution of; terms of one's own may be missing.

    Returns
    -------
    excesses : tuple of Excess
        Of torques, the worst first, and of path constraints.
    unknown : tuple of str
        What was not looked at: efforts, and path constraints by name.
    """
    excesses, unseen = path_excesses(sent, problem)
    rows = {label.name for constraint in problem.path for label in constraint.labels}
    unknown = [*unseen, *(row.name for row in sent.solution.facts.path if row.name not in rows)]
    if np.isfinite(sent.solution.limits_u).any():
        if has_torques(sent, problem.robot):
            excesses = (*torque_excesses(sent, problem.robot), *excesses)
        else:
            unknown.insert(0, "efforts")
    return excesses, tuple(unknown)


def has_torques(sent: Sent, robot: Robot) -> bool:
    """Whether positions, velocities and accelerations say all controls.

    They do for robots without loops and drives, whose joints have one velocity and a motor each; not across
    impacts.
    """
    if robot.nc or robot.drives or not len(sent.joints) == robot.nv == robot.nu:
        return False
    has_forces = all(column.unit in ("N", "N m") for column in sent.solution.labels.u)
    if not has_forces or sent.curves.has_impacts or not robot.actuation.is_constant:
        return False
    return bool(np.linalg.cond(robot.actuation_matrix(robot.q0)) < _MOST_CONDITION)


def torques_along(sent: Sent, robot: Robot) -> tuple[Array, Array]:
    """Times [s], and controls by inverse dynamics, shape (n, nu) [N, N m], of a motion that `has_torques`."""
    model, data = robot.model, robot.model.createData()
    times, (positions, velocities, accelerations, _) = sent.curves.places(_PARTS)
    (qs, vs), (_, rates) = (states_of(sent, positions, x) for x in (velocities, accelerations))
    forces = np.array(
        [
            pin.rnea(model, data, q, v, a) - robot.force_elements(q, v)
            for q, v, a in zip(qs, vs, rates, strict=True)
        ]
    )
    return times, np.linalg.solve(robot.actuation_matrix(robot.q0), forces.T).T


def torque_excesses(sent: Sent, robot: Robot) -> tuple[Excess, ...]:
    """Controls beyond their limits by more than a hundredth as a motion is sent, the worst first."""
    times, controls = torques_along(sent, robot)
    limits = sent.solution.limits_u
    found = (
        excess
        for k, column in enumerate(sent.solution.labels.u)
        for excess in find_excesses(
            "effort", column.name, controls[:, k], limits[:, k], times, column.unit, _TOLERANCE
        )
    )
    return tuple(sorted(found, key=lambda excess: -excess.ratio))
