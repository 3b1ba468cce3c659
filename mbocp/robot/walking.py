"""Which bodies walk."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from mbocp._arrays import BoolArray
from mbocp.robot.robot import Robot

_KEPT = 16  # robots


@lru_cache(maxsize=_KEPT)
def find_walking_bodies(robot: Robot) -> BoolArray:
    """Return which velocity components are those of bodies that stand on legs, shape (nv,).

    No motor moves them in the world, and motors move what they carry.
    """
    model, has_motor = robot.model, np.abs(robot.actuation.selection).sum(axis=1) > 0.0
    found = np.zeros(robot.nv, dtype=np.bool_)
    for joint in range(1, model.njoints):
        own, *carried = (robot.velocity_indices(model.names[k]) for k in model.subtrees[joint])
        if not model.parents[joint] and not has_motor[own].any():
            found[own] = any(has_motor[at].any() for at in carried)
    found.setflags(write=False)
    return found
