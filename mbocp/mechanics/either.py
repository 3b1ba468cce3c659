"""Equations of motion in any of the coordinates."""

from __future__ import annotations

from typing import TypeAlias

from mbocp.mechanics.joint import JointMechanics
from mbocp.mechanics.natural_coordinates.mechanics import NaturalMechanics

Mechanics: TypeAlias = JointMechanics | NaturalMechanics
