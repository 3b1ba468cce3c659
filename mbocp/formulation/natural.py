"""Problems in natural coordinates: what people say of joints, in terms of bodies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.goal import EndRows
from mbocp.mechanics import NaturalMechanics, natural_mechanics
from mbocp.problem import Problem

__all__ = ["EndTarget", "natural_coordinates", "natural_end"]


class EndTarget(NamedTuple):
    """Projections and values of an exact end condition in the programme's coordinates."""

    D_q: Array  # (ng_q, nv)
    D_rate: Array  # (ng_rate, nv)
    rate: Array  # (nv,) momentum or velocity


def natural_coordinates(problem: Problem) -> NaturalMechanics | None:
    """Mechanics of a problem in natural coordinates; None where these are the joints' own.

    Robots whose bodies only slide have the same equations in both.
    """
    if problem.coordinates != "natural":
        return None
    mechanics = natural_mechanics(problem.robot)
    return mechanics if mechanics.tree.turning else None


def natural_end(problem: Problem, mechanics: NaturalMechanics, rows: EndRows) -> EndTarget:
    """End condition of bodies that is that of joints, to first order about the goal.

    With J the derivative of the coordinates z in the joints' motions at the goal, joints move by
    :math:`J^+ (z - z_d)` and have momenta :math:`J^T p`: the rows D of the joints become :math:`D J^+` and
    :math:`D J^T`. All of them together are the null-space projection of eq. (14).
    """
    robot, goal = problem.robot, problem.goal
    J = mechanics.tree.jacobian(goal.q)
    inverse = np.linalg.pinv(J)
    if goal.rate == "v":
        return EndTarget(rows.D_q @ inverse, rows.D_rate @ inverse, J @ goal.value)
    rate = J @ robot.velocity_from_momentum(goal.q, goal.value)
    momentum = mechanics.mass_at(mechanics.tree.coordinates(goal.q[None])[0]) @ rate
    return EndTarget(rows.D_q @ inverse, rows.D_rate @ J.T, momentum)
