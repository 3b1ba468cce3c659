"""Tables of a robot.toml that join frames: `[[constraint]]`, `[[spring]]`, `[[spring_damper]]`."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import Field, model_validator

from mbocp.robot.loading.placement_table import Orientation, Position
from mbocp.robot.loading.table_types import (
    Direction,
    FramePair,
    Length,
    Number,
    PositiveNumber,
    Table,
)

__all__ = [
    "ConstraintTable",
    "CouplingTable",
    "HingeTable",
    "LineTable",
    "PlaneTable",
    "PointTable",
    "QuarticSpringTable",
    "RodTable",
    "SpringDamperTable",
    "WeldTable",
]


class _Pair(Table):
    name: str | None = None
    frames: FramePair

    @model_validator(mode="after")
    def _two_frames(self) -> _Pair:
        if self.frames[0] == self.frames[1]:
            raise ValueError(f"frames must be two different frames, got {self.frames[0]!r} twice")
        return self


class _Joined(_Pair):
    """Two frames that are joined, and where in each of them the joint is."""

    position: Position | None = None
    orientation: Orientation | None = None
    position_b: Position | None = None
    orientation_b: Orientation | None = None


class RodTable(_Joined):
    """A rigid massless rod."""

    type: Literal["rod"]
    length: PositiveNumber | None = None


class PointTable(_Joined):
    """The origins of two frames coincide."""

    type: Literal["point"]


class HingeTable(_Joined):
    """The origins of two frames coincide, and an axis of one with an axis of the other."""

    type: Literal["hinge"]
    axis: Direction = (0.0, 0.0, 1.0)
    axis_b: Direction | None = None


class WeldTable(_Joined):
    """Two frames coincide."""

    type: Literal["weld"]


class PlaneTable(_Joined):
    """The origin of the first frame stays in a plane of the second."""

    type: Literal["plane"]
    normal: Direction = (0.0, 0.0, 1.0)


class LineTable(_Joined):
    """The origin of the first frame stays on a line of the second."""

    type: Literal["line"]
    axis: Direction = (0.0, 0.0, 1.0)


class CouplingTable(Table):
    """Two joints move together."""

    type: Literal["coupling"]
    name: str | None = None
    joints: FramePair
    ratio: Number = 1.0
    offset: Number = 0.0

    @model_validator(mode="after")
    def _two_joints(self) -> CouplingTable:
        if self.joints[0] == self.joints[1]:
            raise ValueError(f"joints must be two different joints, got {self.joints[0]!r} twice")
        if self.ratio == 0.0:
            raise ValueError("ratio must not be zero; to hold a joint still, lock it")
        return self


class QuarticSpringTable(_Pair):
    """A spring with a quartic potential."""

    type: Literal["quartic"] = "quartic"
    stiffness: PositiveNumber | None = None
    coefficient: PositiveNumber | None = None
    length: PositiveNumber | None = None

    @model_validator(mode="after")
    def _one_strength(self) -> QuarticSpringTable:
        if (self.stiffness is None) == (self.coefficient is None):
            raise ValueError("give either stiffness k [N/m] or coefficient c [N/m^3]; c = k/(2 length^2)")
        return self


class SpringDamperTable(_Pair):
    """A linear spring and damper."""

    stiffness: Length = 0.0
    damping: Length = 0.0
    length: Length | None = None


ConstraintTable: TypeAlias = Annotated[
    RodTable | PointTable | HingeTable | WeldTable | PlaneTable | LineTable | CouplingTable,
    Field(discriminator="type"),
]
