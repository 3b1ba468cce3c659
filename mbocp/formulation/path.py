"""Path constraints as functions of the state."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from mbocp.formulation.shape import PathShape
from mbocp.mechanics import Mechanics

__all__ = ["path_values"]


def path_values(mechanics: Mechanics, path: Sequence[PathShape], points: ca.SX, q: ca.SX, v: ca.SX) -> ca.SX:
    """Values h of all path constraints; distances and speeds squared, so that they are smooth at zero.

    Parameters
    ----------
    points : casadi.SX
        Three numbers for each constraint: where distances are measured from [m].
    """
    rows = []
    for k, constraint in enumerate(path):
        position = mechanics.frame_position(constraint.frame, q)
        if constraint.kind == "position":
            rows.append(position[list(constraint.axes)])
        elif constraint.kind == "distance":
            other = constraint.other
            away = points[3 * k : 3 * k + 3] if other is None else mechanics.frame_position(other, q)
            rows.append(ca.sumsqr(position - away))
        else:
            rows.append(ca.sumsqr(mechanics.frame_translation_jacobian(constraint.frame, q) @ v))
    return ca.vertcat(*rows)
