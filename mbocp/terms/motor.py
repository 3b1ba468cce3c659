"""A kind of path constraint: motors whose torque falls with their speed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import casadi as ca
import numpy as np

from mbocp._keys import Key, Table
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.robot import Robot
from mbocp.terms.path import PathNumbers, PathTerm
from mbocp.terms.point import Point
from mbocp.terms.written import Bound


@dataclass(frozen=True)
class Motor(PathTerm):
    r"""Torque with the voltage of a motor, seen behind its gear; of a `[[robot.motor]]` before it.

    .. math:: -\tau_0 \le \tau + \frac{\tau_0}{v_0} v \le \tau_0

    At rest it is the stall torque tau_0 at most, at the no-load speed v_0 none; where the motor brakes the
    voltage helps, and a limit of effort says what the current allows. It holds for the control of each step
    with the velocity at its end.
    """

    kind = "motor"
    unit = "N m"
    has_velocity = True
    of_joint = True
    remembers = ("control",)
    sizes: ClassVar[Mapping[str, int]] = {"stall": 1, "no_load": 1}

    class Keys(Table):
        """Keys."""

        stall: Annotated[
            Bound, Key('of a `"motor"`: torque of a joint, `frame`, at rest', "N m", "required")
        ] = None
        no_load: Annotated[Bound, Key("of a motor: speed without torque", "rad/s", "required")] = None

    @classmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """Bounds, of the size of the stall torque, and numbers."""
        for name in cls.sizes:
            if name not in given:
                raise ProblemError(f"{key}.{name}: this key is missing")
        numbers = {name: np.array([given[name]]) for name in cls.sizes}
        return {"lower": [-abs(given["stall"])], "upper": [abs(given["stall"])], **numbers}

    @classmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """Numbers."""
        return {name: float(given.number(name)[0]) for name in cls.sizes}

    @classmethod
    def check(cls, given: PathNumbers, key: str) -> None:
        """Refuse torques and speeds that are none."""
        super().check(given, key)
        for name in cls.sizes:
            if not given.number(name)[0] > 0.0:
                raise InvalidValue(f"{key}: {name}", float(given.number(name)[0]), "above 0")

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Torque that the voltage would give at rest [N m]."""
        place, n = _gear(self.frame, at)
        torque = (at.pushes() @ at.control)[place] / n
        return torque + p["stall"] / p["no_load"] * n * at.joint_velocity()[place]


@dataclass(frozen=True)
class MotorSpeed(PathTerm):
    r"""Speed of a motor before its gear, :math:`|n v| \le \omega_{\max}`."""

    kind = "motor_speed"
    unit = "rad/s"
    has_velocity = True
    of_joint = True

    class Keys(Table):
        """Keys."""

        max: Annotated[Bound, Key('of a `"motor_speed"`', "rad/s")] = None

    @classmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """Bounds of both directions."""
        if not given.get("max", 0.0) > 0.0:
            raise InvalidValue(f"{key}.max", given.get("max"), "a speed above 0 [rad/s]")
        return {"lower": [-given["max"]], "upper": [given["max"]]}

    @classmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """The greatest speed."""
        return {"max": float(given.upper[0])}

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Speed before the gear [rad/s]."""
        place, n = _gear(self.frame, at)
        return n * at.joint_velocity()[place]


def _gear(frame: int, at: Point) -> tuple[int, ca.SX]:
    """Where a joint has its velocity, and the ratio of its gear."""
    model = at.mechanics.robot.model
    place = int(model.joints[model.frames[frame].parentJoint].idx_v)
    return place, at.mechanics.gear_ratio(place)
