"""The numbers that the stage functions take beside the unknowns, by name and place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.shape import Shape
from mbocp.mechanics import Mechanics, NaturalMechanics

__all__ = ["COST_WEIGHTS", "ParameterLayout", "Sizes", "concatenated", "parameter_layout", "pieces"]

# Parameters in which the costs are linear: all of them scaled, the costs are.
COST_WEIGHTS = ("effort", "weight_q", "weight_p", "weight_rate", "velocity", "potential", "control_rate")


@dataclass(frozen=True)
class ParameterLayout:
    """Sizes of the named pieces of theta (whole horizon), rho (a stage) and rho of the end, in order."""

    theta: Mapping[str, int]
    stage: Mapping[str, int]
    terminal: Mapping[str, int]


class Sizes(NamedTuple):
    """Sizes of what the parameters speak of; in joint coordinates the last two repeat the first."""

    nz: int  # coordinates of a configuration
    nv: int  # its tangent directions
    nu: int
    joint_nz: int  # coordinates of the joints, which costs compare
    joint_nv: int  # velocities of the joints, which costs weigh

    @classmethod
    def of(cls, mechanics: Mechanics) -> Sizes:
        """Sizes of a robot in its coordinates."""
        if isinstance(mechanics, NaturalMechanics):
            joints = (mechanics.joint_space.nz, mechanics.robot.nv)
        else:
            joints = (mechanics.nq, mechanics.nv)
        return cls(mechanics.nq, mechanics.nv, mechanics.nu, *joints)


def parameter_layout(shape: Shape, sizes: Sizes) -> ParameterLayout:
    """Parameters that the stage functions of `shape` take."""
    nz, nv, nu, joint_nz, joint_nv = sizes
    theta = {"dt": 1, "effort": nu}
    stage = {}
    if shape.track_q:
        theta["weight_q"], stage["target_q"] = joint_nv, joint_nz
    if shape.track_p:
        theta["weight_p"], stage["target_p"] = joint_nv, joint_nv
    if shape.weigh_velocity:
        theta["velocity"] = joint_nv
    if shape.weigh_potential:
        theta["potential"] = 1
    if shape.weigh_rate:
        theta["control_rate"], stage["has_before"] = nu, 1
    if shape.is_explicit:
        theta["gains"] = 3
    if shape.path:
        theta["path_points"] = 3 * len(shape.path)
    terminal = {"q": nz, "rate": nv, "D_q": shape.ng_q * nv, "D_rate": shape.ng_rate * nv}
    if shape.penalise_q:
        terminal["weight_q"] = joint_nv
        if shape.is_natural:
            terminal["joint_q"] = joint_nz
    if shape.penalise_rate:
        terminal["weight_rate"] = joint_nv
        if shape.is_natural:
            terminal["joint_rate"] = joint_nv
    return ParameterLayout(theta, stage, terminal)


def pieces(vector: ca.SX, sizes: Mapping[str, int]) -> dict[str, ca.SX]:
    """Named pieces of a symbolic vector."""
    bounds = [0]
    for size in sizes.values():
        bounds.append(bounds[-1] + size)
    return {name: vector[bounds[i] : bounds[i + 1]] for i, name in enumerate(sizes)}


def concatenated(named: Mapping[str, Array], sizes: Mapping[str, int]) -> Array:
    """One vector of the pieces that `sizes` names, in its order."""
    found = [np.asarray(named[name], dtype=float).ravel() for name in sizes]
    return np.concatenate(found) if found else np.zeros(0)
