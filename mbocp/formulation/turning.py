"""How far a change of a state's coordinates turns something: what a solver needs to keep its steps small."""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.layout import StateLayout
from mbocp.lie import ConfigurationSpace

__all__ = ["turning_factors"]


def turning_factors(turns: Array, space: ConfigurationSpace, layout: StateLayout) -> Array:
    """Angle [rad] by unit of each entry of a state's tangent, shape (ndx,); 0: not an angle.

    The joints' own angles only. Attitudes of free-flyers and ball joints have none. `turns` are those of the
    robot, see `RobotModel.turns`.
    """
    factors = np.zeros(layout.ndx)
    for part in space.parts:
        at = part.at_z if layout.is_flat else part.at_v
        if part.group.is_vector:
            factors[at] = turns[part.at_v]
        elif part.group.nv == 1:
            factors[at] = 1.0  # cosine and sine, or the angle
    return factors
