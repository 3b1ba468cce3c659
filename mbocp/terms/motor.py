"""Kinds of path constraints: motors whose torque falls with their speed, and which have a largest speed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import casadi as ca
import numpy as np

from mbocp._arrays import dataclass
from mbocp._keys import Key, Table
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.robot import Robot
from mbocp.terms.over_speed import (
    CURVE_UNIT,
    Curve,
    OverSpeed,
    check_curve,
    place_of,
    slopes_of,
    values_at_rest,
)
from mbocp.terms.path_term import PathNumbers, PathTerm
from mbocp.terms.point import Point
from mbocp.terms.written import Bound


@dataclass(frozen=True)
class MotorTorque(OverSpeed):
    r"""Torque with the voltage of a motor, seen behind its gear; of a `[[robot.motor]]` before it.

    .. math:: -\tau_0 \le \tau + \frac{\tau_0}{v_0} v \le \tau_0

    At rest it is the stall torque tau_0 at most, at the no-load speed v_0 none; where the motor brakes the
    voltage helps, and a limit of effort says what the current allows. It holds for the control of each step
    with the velocity at its end. A table of torques over speeds is such a line for each two of its rows.
    """

    kind = "motor"
    unit = "N m"
    of_motor = True
    remembers = ("control",)
    excess = "torque"
    values = "torques"

    class Keys(Table):
        """Keys."""

        stall: Annotated[
            Bound,
            Key('of a `"motor"`: torque of a joint at rest', "N m", "required, but with a curve"),
        ] = None
        no_load: Annotated[
            Bound, Key("of a motor: speed without torque", "rad/s", "required, but with a curve")
        ] = None
        curve: Annotated[
            Curve,
            Key(
                "of a motor in place of both: rows [speed, torque] from rest on, which fall ever faster",
                CURVE_UNIT,
                takes="list of pairs",
            ),
        ] = None

    @classmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """Bounds, of the sizes of the torques that lines have at rest, and numbers."""
        if "curve" in given:
            for name in ("stall", "no_load"):
                if name in given:
                    raise ProblemError(f"{key}: curve and {name}; which of the two? Give one")
            speeds, torques = check_curve(np.array(given["curve"]).reshape(-1, 2), f"{key}.curve", cls.values)
        else:
            for name in ("stall", "no_load"):
                if name not in given:
                    raise ProblemError(f"{key}.{name}: this key is missing")
                if not (given[name] > 0.0 and np.isfinite(given[name])):
                    raise InvalidValue(f"{key}: {name}", float(given[name]), "above 0, and finite")
            speeds, torques = np.array([0.0, given["no_load"]]), np.array([given["stall"], 0.0])
        at_rest = values_at_rest(speeds, torques)
        return {"lower": -at_rest, "upper": at_rest, "speeds": speeds, "values": torques}

    @classmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """Numbers."""
        speeds, torques = given.number("speeds"), given.number("values")
        if len(speeds) == 2 and torques[1] == 0.0:
            return {"stall": float(torques[0]), "no_load": float(speeds[1])}
        return super().write(given, robot)

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Torque that the voltage would give at rest, by each line [N m]."""
        place, n = _gear(self.frame, at)
        torque = (at.pushes() @ at.control)[place] / n
        return torque + slopes_of(p["speeds"], p["values"]) * n * at.joint_velocity()[place]


@dataclass(frozen=True)
class MotorSpeed(PathTerm):
    r"""Speed of a motor before its gear, :math:`|n v| \le \omega_{\max}`."""

    kind = "motor_speed"
    unit = "rad/s"
    has_velocity = True
    of_joint = True
    of_motor = True

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
    place = place_of(frame, at.mechanics.robot)
    return place, at.mechanics.gear_ratio(place)
