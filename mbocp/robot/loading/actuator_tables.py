"""Tables of a robot.toml that say how a robot is driven: `[actuation]`, `[[actuator]]`, `[[drive]]`."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import Field, PositiveFloat, model_validator

from mbocp.robot.loading.table_types import Component, Number, Table, Vector3, is_zero


class ActuationTable(Table):
    """[actuation]: the joints that have motors, in the order of the controls."""

    joints: list[str] | None = None


class JointActuator(Table):
    """A motor on a joint: one control for each velocity component of the joint."""

    type: Literal["joint"]
    joint: str
    effort: PositiveFloat | None = None


class Wrench(Table):
    """Forces and moments on a frame, in its own axes: one control a component."""

    type: Literal["wrench"]
    frame: str
    name: str | None = None
    components: list[Component] = Field(default=["fx", "fy", "fz", "mx", "my", "mz"], min_length=1)
    effort: PositiveFloat | list[PositiveFloat] | None = None

    @model_validator(mode="after")
    def _one_effort_a_component(self) -> Wrench:
        if len(set(self.components)) != len(self.components):
            raise ValueError(f"components are repeated: {', '.join(self.components)}")
        if isinstance(self.effort, list) and len(self.effort) != len(self.components):
            raise ValueError(f"effort has {len(self.effort)} numbers for {len(self.components)} components")
        return self


class Thruster(Table):
    """A thrust along an axis of a frame, with a reaction torque about it."""

    type: Literal["thruster"]
    frame: str
    name: str | None = None
    axis: Vector3 = (0.0, 0.0, 1.0)
    position: Vector3 = (0.0, 0.0, 0.0)
    torque_ratio: Number = 0.0
    effort: PositiveFloat | None = None

    @model_validator(mode="after")
    def _axis_has_a_direction(self) -> Thruster:
        if is_zero(self.axis):
            raise ValueError("axis must not be zero")
        return self


class DriveTable(Table):
    """A control that prescribes a joint's motion, or a frame's along a direction."""

    name: str | None = None
    joint: str | None = None
    frame: str | None = None
    direction: Vector3 | None = None
    joints: Annotated[list[str], Field(min_length=1)] | None = None
    control: Literal["velocity", "acceleration"]
    limit: PositiveFloat | None = None

    @model_validator(mode="after")
    def _a_joint_or_a_frame(self) -> DriveTable:
        if (self.joint is None) == (self.frame is None):
            raise ValueError("give either joint, or frame with direction and joints")
        if self.joint is not None and (self.direction, self.joints) != (None, None):
            raise ValueError("direction and joints go with frame, not with joint")
        if self.frame is not None and (self.direction is None or self.joints is None):
            raise ValueError("frame needs direction (in its own axes) and joints (those that it is moved by)")
        if self.direction is not None and is_zero(self.direction):
            raise ValueError("direction must not be zero")
        return self


Actuator: TypeAlias = Annotated[JointActuator | Wrench | Thruster, Field(discriminator="type")]
