"""What a control momentum is in terms of the adjoints of a solution, in words."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.mechanics.symmetries.fields import LieBlock, Symmetry
from mbocp.robot import Robot

_COEFFICIENT_TOLERANCE = 1e-9  # coefficients are of order one, to round-off
_COMPONENTS = {  # of a twist, that sigma has
    "JointModelFreeFlyer": [0, 1, 2, 3, 4, 5],
    "JointModelSpherical": [3, 4, 5],
    "JointModelPlanar": [0, 1, 5],
}


def momentum_name(symmetry: Symmetry, robot: Robot) -> str:
    r"""Say what the control momentum of a symmetry is, eq. (15).

    With the field :math:`X(q) = c + A\,q + \mathrm{Ad}_q^{-1}\sigma` it is :math:`c \cdot \mu^q` where only
    constants take part: one adjoint if the coordinate is cyclic, or a combination of several. sigma takes a
    component of a joint's spatial adjoint, and A that of the cross products of eq. (15) itself.

    Returns
    -------
    words : str
        "adjoint mu_q of shoulder_pan_joint, a cyclic coordinate"; empty where it takes more than a line.
    """
    if symmetry.linear.any():
        is_particle = robot.nv == 3 and not symmetry.constant.any()
        return f"q x mu_q + p x mu_p along {_axis(symmetry.twist[3:])}, eq. (15)" if is_particle else ""
    parts = [_of_coordinates(symmetry.constant, robot)] if symmetry.constant.any() else []
    parts += [_of_joint(block, robot) for block in symmetry.blocks]
    return " + ".join(parts) if all(parts) else ""


def _of_coordinates(constant: Array, robot: Robot) -> str:
    moved = [int(i) for i in np.flatnonzero(constant)]
    factors, names = [_factor(constant[i]) for i in moved], [robot.v_labels[i].name for i in moved]
    if len(moved) == 1:
        return f"{factors[0]}adjoint mu_q of {names[0]}, a cyclic coordinate"
    terms = [f"{factor}mu_q of {name}" for factor, name in zip(factors, names, strict=True)]
    return f"adjoints {' + '.join(terms)}"


def _of_joint(block: LieBlock, robot: Robot) -> str:
    linear, angular = _twist(block)
    if linear.any() and angular.any():
        return ""  # about an axis that misses the joint's origin
    model = robot.model
    joint = next(j for j in range(1, model.njoints) if model.joints[j].idx_v == block.idx_v)
    what, axis = ("position", linear) if linear.any() else ("rotation", angular)
    is_in_world = model.parents[joint] == 0 and model.jointPlacements[joint].isApprox(pin.SE3.Identity())
    frame = "" if is_in_world else ", in the frame that the joint is fixed to"
    return f"spatial adjoint of {model.names[joint]}'s {what} along {_axis(axis)}{frame}"


def _twist(block: LieBlock) -> tuple[Array, Array]:
    """Linear and angular part of sigma, shape (3,) each."""
    out = np.zeros(6)
    out[_COMPONENTS[block.kind]] = block.sigma
    return out[:3], out[3:]


def _factor(coefficient: float) -> str:
    if abs(coefficient - 1.0) <= _COEFFICIENT_TOLERANCE:
        return ""
    return "minus " if abs(coefficient + 1.0) <= _COEFFICIENT_TOLERANCE else f"{coefficient:.4g} "


def _axis(vector: Array) -> str:
    for letter, unit in zip("xyz", np.eye(3), strict=True):
        for sign, word in ((1.0, letter), (-1.0, f"-{letter}")):
            if np.abs(vector - sign * unit).max() <= _COEFFICIENT_TOLERANCE:
                return word
    return "(" + ", ".join(f"{x:.3g}" for x in vector) + ")"
