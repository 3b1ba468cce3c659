"""All kinds of holonomic constraints, in the order of the documentation.

A kind is one file of `mbocp.robot.loops.kinds`, and an entry here.
"""

from __future__ import annotations

from mbocp.robot.loops.kinds.constraint import Constraint, FrameConstraint
from mbocp.robot.loops.kinds.coupling import Coupling
from mbocp.robot.loops.kinds.hinges import Hinge, Screw, Weld
from mbocp.robot.loops.kinds.kept_points import PointOnLine, PointOnPlane, PointOnPoint
from mbocp.robot.loops.kinds.rod import Rod

_KINDS: tuple[type[Constraint], ...] = (
    Rod,
    PointOnPoint,
    Hinge,
    Weld,
    PointOnPlane,
    PointOnLine,
    Coupling,
    Screw,
)

CONSTRAINTS: dict[str, type[Constraint]] = {kind.kind: kind for kind in _KINDS}
HOLDS: dict[str, type[FrameConstraint]] = {
    kind.kind: kind for kind in _KINDS if issubclass(kind, FrameConstraint) and kind.hold_keys is not None
}
