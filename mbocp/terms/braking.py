"""A kind of path constraint: joints that can always stop before their limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp._keys import Key, Table
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.robot import Label, Robot
from mbocp.terms.path_term import PathNumbers, PathTerm
from mbocp.terms.point import Point
from mbocp.terms.written import Bound


@dataclass(frozen=True)
class Braking(PathTerm):
    r"""Where a joint of velocity v would stand that brakes with the deceleration a, kept within its limits.

    .. math:: q + \frac{\max(v + v_0, 0)^2}{2 a} \le \overline{q}, \qquad
        q - \frac{\max(v_0 - v, 0)^2}{2 a} \ge \underline{q}

    Solved for the velocity it is a limit that depends on the position, v <= sqrt(2 a (q_max - q)) - v_0, as
    some makers publish it. The reserve v_0 holds at rest: q stays v_0^2 / 2a from its limits. Values have
    derivatives everywhere, second ones but where v = -v_0 or v = v_0.
    """

    sides: tuple[int, ...]  # of each row: 1 for the upper limit, -1 for the lower one

    kind = "braking"
    unit = "rad"
    has_velocity = True
    of_joint = True
    sizes: ClassVar[Mapping[str, int]] = {"deceleration": 1, "reserve": 1}

    class Keys(Table):
        """Keys."""

        deceleration: Annotated[Bound, Key('of a `"braking"` joint', "rad/s^2", "required")] = None
        reserve: Annotated[Bound, Key("of a braking joint: velocity on top", "rad/s", "0")] = None
        min: Annotated[Bound, Key("of a braking joint's angle", "rad", beside=("max",))] = None
        max: Bound = None

    @classmethod
    def of(cls, given: PathNumbers) -> Braking:
        """With a row for each limit."""
        return cls(given.frame, tuple(1 if np.isfinite(upper) else -1 for upper in given.upper))

    @classmethod
    def read(cls, given: Mapping[str, Any], robot: Robot, key: str) -> dict[str, Any]:
        """Rows, bounds and numbers."""
        if "min" not in given and "max" not in given:
            raise ProblemError(f"{key}: bounds nothing; give min or max")
        if "deceleration" not in given:
            raise ProblemError(f"{key}.deceleration: this key is missing")
        upper, lower = ([given[name]] if name in given else [] for name in ("max", "min"))
        return {
            "upper": [*upper, *(np.inf for _ in lower)],
            "lower": [*(-np.inf for _ in upper), *lower],
            **{name: np.array([given.get(name, 0.0)]) for name in cls.sizes},
        }

    @classmethod
    def write(cls, given: PathNumbers, robot: Robot) -> dict[str, Any]:
        """Numbers and limits."""
        limits = {"max": min(given.upper), "min": max(given.lower)}
        numbers = {name: float(given.number(name)[0]) for name in cls.sizes}
        return {**numbers, **{name: value for name, value in limits.items() if np.isfinite(value)}}

    @classmethod
    def check(cls, given: PathNumbers, key: str) -> None:
        """Refuse decelerations and reserves that are none."""
        super().check(given, key)
        if not given.number("deceleration")[0] > 0.0:
            raise InvalidValue(f"{key}: deceleration", float(given.number("deceleration")[0]), "above 0")
        if given.number("reserve")[0] < 0.0:
            raise InvalidValue(f"{key}: reserve", float(given.number("reserve")[0]), "0 or above")

    @property
    def rows(self) -> int:
        """One for each limit."""
        return len(self.sides)

    @classmethod
    def labels(cls, given: PathNumbers) -> tuple[Label, ...]:
        """The limit behind the name."""
        sides = ("max" if np.isfinite(upper) else "min" for upper in given.upper)
        return tuple(Label(f"{given.name}.{side}", cls.unit) for side in sides)

    @classmethod
    def find_missing_reserve(cls, given: PathNumbers, q: Array, v: Array) -> float:
        """By how much the reserve is too small for angles and velocities, shapes (n,), 0 or above [rad/s]."""
        slowing, reserve = (float(given.number(name)[0]) for name in ("deceleration", "reserve"))
        found = [0.0]
        for side, limit in ((1.0, min(given.upper)), (-1.0, max(given.lower))):
            if np.isfinite(limit):
                speed, room = side * v + reserve, np.maximum(side * (limit - q), 0.0)
                found.append(float(np.where(speed > 0.0, speed - np.sqrt(2.0 * slowing * room), 0.0).max()))
        return max(found)

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Angles at which it would stand [rad]."""
        model = at.mechanics.robot.model
        joint = model.frames[self.frame].parentJoint
        q = at.mechanics.joint_displacement(joint, at.q)
        v = at.joint_velocity()[model.joints[joint].idx_v]
        stops = [stop(q, v, side, p["reserve"], p["deceleration"], ca.fmax) for side in self.sides]
        return ca.vertcat(*stops)


def stop(q: Any, v: Any, side: int, reserve: Any, deceleration: Any, largest: Callable[..., Any]) -> Any:
    """Return where a joint would stand, of symbols or arrays; `largest` is the larger one of two [rad]."""
    return q + side * largest(side * v + reserve, 0.0) ** 2 / (2.0 * deceleration)
