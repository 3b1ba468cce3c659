"""Equations of motion, and where they hold, in any of the coordinates."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from mbocp.lie import ConfigurationSpace
    from mbocp.mechanics.joint_mechanics import JointMechanics
    from mbocp.mechanics.natural_coordinates.mechanics import NaturalMechanics
    from mbocp.mechanics.natural_coordinates.space import NaturalSpace

Mechanics: TypeAlias = "JointMechanics | NaturalMechanics"
Space: TypeAlias = "ConfigurationSpace | NaturalSpace"
