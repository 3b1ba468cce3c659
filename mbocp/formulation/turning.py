"""How far a change of a state's coordinates turns something: what a solver needs to keep its steps small."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.formulation.layout import StateLayout
from mbocp.lie import ConfigurationSpace

__all__ = ["turning_factors"]


def turning_factors(model: pin.Model, space: ConfigurationSpace, layout: StateLayout) -> Array:
    """Angle [rad] by unit of each entry of a state's tangent, shape (ndx,); 0: not an angle.

    The joints' own angles only. Attitudes of free-flyers and ball joints have none.
    """
    factors = np.zeros(layout.ndx)
    turns = _turns(model)
    for part in space.parts:
        at = part.at_z if layout.is_flat else part.at_v
        if part.group.is_vector:
            factors[at] = turns[part.at_v]
        elif part.group.nv == 1:
            factors[at] = 1.0  # cosine and sine, or the angle
    return factors


def _turns(model: pin.Model) -> Array:
    """Angle by unit of each joint velocity, shape (nv,)."""
    data, found = model.createData(), np.zeros(model.nv)
    pin.computeJointJacobians(model, data, pin.neutral(model))
    for index, joint in list(enumerate(model.joints))[1:]:
        if joint.nv and joint.shortname() != "JointModelMimic":
            at = slice(joint.idx_v, joint.idx_v + joint.nv)
            jacobian = pin.getJointJacobian(model, data, index, pin.ReferenceFrame.LOCAL)
            found[at] = np.linalg.norm(jacobian.reshape(6, model.nv)[3:, at], axis=0)  # (6,) where nv is 1
    return found
