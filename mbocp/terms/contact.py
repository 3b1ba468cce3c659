r"""Contact forces: bounds on the forces of constraints, friction cones, pressure inside a foot.

With the force :math:`f` that a constraint exerts on its first frame in a step, its component :math:`f_n`
along the normal and :math:`f_t` across it, and for a weld its torque :math:`\tau` about the frame's origin:

.. math::
    \underline{f} \le f_n \le \overline{f}, \quad
    \mu^2 f_n^2 - |f_t|^2 \ge 0, \quad |f| \le \overline{F}, \quad
    |\tau_2| \le \tfrac{l_1}{2} f_n, \; |\tau_1| \le \tfrac{l_2}{2} f_n, \quad
    |\tau_n| \le \mu_\tau f_n

Beside :math:`f_n \ge 0` the second is the cone :math:`|f_t| \le \mu f_n`, by a polynomial, which has
derivatives at its apex, too. Or a pyramid within the cone, with k facets:
:math:`\cos\theta_i f_1 + \sin\theta_i f_2 \le \mu \cos(\pi/k) f_n`.

Where a constraint is taken on, positions coincide and velocities fit it: :math:`\Phi(q_n) = 0` where frames
coincide, :math:`J(q_n)\,v_n = 0` without an impact.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import casadi as ca

from mbocp._arrays import dataclass
from mbocp._keys import Key
from mbocp.mechanics.held_frames import HeldFrame, write_held_jacobian, write_held_rows
from mbocp.terms.bounded import Structure
from mbocp.terms.heights import SurfaceKeys, SurfaceShape
from mbocp.terms.point import Point
from mbocp.terms.written import Bound, Pair, Positive, Triple

_SIZE = 6  # force along the normal and two tangents, torque about them


@dataclass(frozen=True)
class ContactTerm(Structure):
    """The structure of bounds on a contact force.

    Attributes
    ----------
    of_rows : tuple of int
        Rows of the robot's constraints that exert it.
    has_cone : bool
        Whether friction is bounded by a cone.
    facets : int
        Of a pyramid in its place; 0: none.
    has_norm : bool
        Whether the size of the force is bounded.
    has_pressure : bool
        Whether the centre of pressure stays inside a rectangle.
    has_yaw : bool
        Whether the torque about the normal is bounded.
    ground : tuple of int
        Frame that stands on a map, whose normal is meant, and the map's rows and columns; or nothing.
    """

    of_rows: tuple[int, ...]
    has_cone: bool = False
    facets: int = 0
    has_norm: bool = False
    has_pressure: bool = False
    has_yaw: bool = False
    ground: tuple[int, ...] = ()

    kind: ClassVar[str] = "contact_force"
    unit: ClassVar[str] = "N"
    remembers: ClassVar[tuple[str, ...]] = ("reaction",)

    @property
    def rows(self) -> int:
        """The normal force, then friction, size, pressure and yaw."""
        of_friction = 1 if self.has_cone else self.facets
        return 1 + of_friction + self.has_norm + 4 * self.has_pressure + 2 * self.has_yaw

    @property
    def sizes(self) -> dict[str, int]:
        """Size of each parameter: forces by the multipliers and the scale, by columns; then ratios."""
        found = {"map": _SIZE * len(self.of_rows)}
        found |= {"friction": 1} if self.has_cone else {}
        found |= {"facets": 3 * self.facets} if self.facets else {}
        found |= {"halves": 2} if self.has_pressure else {}
        if self.ground:
            found |= SurfaceShape(*self.ground[1:]).sizes
        return found | ({"yaw": 1} if self.has_yaw else {})

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Its rows of the forces that the state remembers, by the scale of forces, and its square."""
        lam = at.remembered["reaction"][list(self.of_rows)]
        wrench = ca.reshape(p["map"], _SIZE, len(self.of_rows)) @ lam
        normal, across, torque = wrench[0], wrench[1:3], wrench[3:]
        if self.ground:
            place = at.mechanics.frame_position(self.ground[0], at.q)
            up = SurfaceShape(*self.ground[1:]).normal(place, p)
            normal, across = ca.dot(up, wrench[:3]), ca.cross(up, wrench[:3])
        rows = [normal]
        if self.has_cone:
            rows.append((p["friction"] * normal) ** 2 - ca.sumsqr(across))
        if self.facets:
            rows.append(ca.reshape(p["facets"], self.facets, 3) @ wrench[:3])
        if self.has_norm:
            rows.append(ca.sumsqr(wrench[:3]))
        if self.has_pressure:
            room = p["halves"] * normal
            rows += [room[0] - torque[2], room[0] + torque[2], room[1] - torque[1], room[1] + torque[1]]
        if self.has_yaw:
            rows += [p["yaw"] * normal - torque[0], p["yaw"] * normal + torque[0]]
        return ca.vertcat(*rows)


class ContactKeys(SurfaceKeys):
    """Keys of the kind `"contact_force"`."""

    constraint: Annotated[
        str | None, Key('of a `"contact_force"`: whose [force](contact.md) is bounded', default="required")
    ] = None
    normal: Annotated[
        Triple,
        Key("in the axes of the constraint's second frame", default="z; that of a map, where `heights` are"),
    ] = None
    friction: Annotated[Positive | None, Key("friction coefficient")] = None
    facets: Annotated[int | None, Key("of a pyramid in place of the cone", takes="whole number > 2")] = None
    min_normal: Annotated[
        Bound,
        Key(
            "of the force along the normal",
            "N",
            default="0 with friction, pressure or yaw, else none; none",
            beside=("max_normal",),
        ),
    ] = None
    max_normal: Bound = None
    max: Annotated[Bound, Key("of a contact force", "N")] = None
    pressure: Annotated[
        Pair, Key("sides of the rectangle of a weld's centre of pressure", "m", takes="2 numbers > 0")
    ] = None
    yaw_friction: Annotated[
        Positive | None, Key("of a weld: torque about the normal by the normal force", "m")
    ] = None
    impulses: Annotated[
        bool | None, Key("whether [impulses](contact.md#impacts) stay in the cone, too", default="true")
    ] = None


@dataclass(frozen=True)
class ContactConditionTerm:
    """The structure of such rows, as `mbocp.terms.path_term.PathTerm` is that of a path constraint.

    Attributes
    ----------
    frame : HeldFrame
    kept : tuple of int
        Those of its rows that act.
    has_place, has_rate : bool
        Whether positions coincide and velocities are allowed.
    """

    frame: HeldFrame
    kept: tuple[int, ...]
    has_place: bool
    has_rate: bool

    remembers: ClassVar[tuple[str, ...]] = ()

    @property
    def has_velocity(self) -> bool:
        """Whether it depends on the velocity."""
        return self.has_rate

    @property
    def signature(self) -> dict[str, Any]:
        """What its function depends on."""
        said = {"kept": self.kept, "has_place": self.has_place, "has_rate": self.has_rate}
        return {"term": "meeting", "frame": self.frame.signature, **said}

    @property
    def rows(self) -> int:
        """Number of its values."""
        return len(self.kept) * (self.has_place + self.has_rate)

    @property
    def sizes(self) -> dict[str, int]:
        """No parameters."""
        return {}

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Rows of positions, and of velocities below them."""
        kept, found = list(self.kept), [ca.SX.zeros(0, 1)]
        if self.has_place:
            found.append(write_held_rows((self.frame,), at.mechanics, at.q, at.q)[kept])
        if self.has_rate:
            found.append((write_held_jacobian((self.frame,), at.mechanics, at.q) @ at.v)[kept])
        return ca.vertcat(*found)
