"""Bounds on the force of a constraint, as people write them."""

from __future__ import annotations

import math
from dataclasses import field
from typing import Any

import numpy as np

from mbocp._arrays import dataclass
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem._checks import check_bool, check_integer, check_number, check_positive
from mbocp.robot.loops.kinds.constraint import Axis, Constraint, unit_axis
from mbocp.terms.contact import ContactTerm
from mbocp.terms.heights import HeightGrid
from mbocp.terms.span import Span

_Z: Axis = (0.0, 0.0, 1.0)
_LEAST_FACETS, _MOST_FACETS = 3, 64
_ALONG = 1e-6  # part of a normal along which there is no force


@dataclass(frozen=True, kw_only=True)
class ContactForce:
    r"""Bounds on the force that a constraint exerts on its first frame, see `mbocp.terms.contact`.

    It is the force of each step, by the second frame or what carries it, in the axes of the second frame; the
    torque of a weld is about the first frame's origin. For a rod it is the force along it, positive where it
    pushes.

    Attributes
    ----------
    name : str
        What it is called in messages, results and plots.
    constraint : str
        Name of the constraint.
    normal : (float, float, float), optional
        Direction of the normal, normalised; z by default. A plane has its own, a rod its direction.
    friction : float, optional
        Coefficient of the friction cone.
    facets : int, optional
        Of a pyramid in the place of the cone, within it.
    min_normal, max_normal : float, optional
        Bounds of the force along the normal [N]; the lower one is zero beside friction, pressure or yaw
        unless it is given.
    max : float, optional
        Bound of the size of the force [N].
    pressure : (float, float), optional
        Sides of the rectangle about the first frame's origin in which the centre of pressure stays [m]: along
        x and y for the normal z.
    yaw_friction : float, optional
        Bound of the torque about the normal by the normal force [m].
    impulses : bool
        Whether impulses of impacts in which the constraint acts stay in the cones, and push, too.
    surface : HeightGrid, optional
        A map on which the first frame stands, in the world: its normal is meant, wherever the frame is.
    span : Span
        When it holds.
    """

    name: str
    constraint: str
    normal: Axis | None = None
    friction: float | None = None
    facets: int | None = None
    min_normal: float | None = None
    max_normal: float | None = None
    max: float | None = None
    pressure: tuple[float, float] | None = None
    yaw_friction: float | None = None
    impulses: bool = True
    surface: HeightGrid | None = None
    span: Span = field(default_factory=Span)

    def __post_init__(self) -> None:
        key = self.key
        for name in ("friction", "max", "yaw_friction"):
            if getattr(self, name) is not None:
                check_positive(f"{key}: {name}", getattr(self, name))
        for name in ("min_normal", "max_normal"):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, float) and math.isinf(value)):
                check_number(f"{key}: {name}", value)
        if self.normal is not None:
            object.__setattr__(self, "normal", unit_axis(self.normal, f"{key}: normal"))
        if self.pressure is not None:
            sides = tuple(check_positive(f"{key}: pressure", side, "m") for side in self.pressure)
            if len(sides) != 2:
                raise InvalidValue(f"{key}: pressure", list(sides), "two lengths")
            object.__setattr__(self, "pressure", sides)
        check_bool(f"{key}: impulses", self.impulses)
        for name in ("normal", "facets", "pressure", "yaw_friction") if self.surface is not None else ():
            if getattr(self, name) is not None:
                raise ProblemError(f"{key}: {name}: not on a map, whose normal changes from place to place")
        self._check_facets()
        self._check_bounds()
        self.span.check(key)

    @property
    def key(self) -> str:
        """What messages begin with."""
        return f"path {self.name!r}"

    @property
    def has_ratio(self) -> bool:
        """Whether something is bounded by the normal force."""
        return any(given is not None for given in (self.friction, self.pressure, self.yaw_friction))

    @property
    def normal_bounds(self) -> tuple[float, float]:
        """Of the force along the normal [N]."""
        least = 0.0 if self.has_ratio else -math.inf
        lower = least if self.min_normal is None else float(self.min_normal)
        return lower, math.inf if self.max_normal is None else float(self.max_normal)

    @property
    def _bounds_normal(self) -> bool:
        return self.has_ratio or any(math.isfinite(side) for side in self.normal_bounds)

    def _check_facets(self) -> None:
        if self.facets is None:
            return
        if self.friction is None:
            raise ProblemError(f"{self.key}: facets of which cone? Give friction")
        check_integer(f"{self.key}: facets", self.facets, _LEAST_FACETS)
        if self.facets > _MOST_FACETS:
            raise InvalidValue(f"{self.key}: facets", self.facets, f"at most {_MOST_FACETS}")

    def _check_bounds(self) -> None:
        lower, upper = self.normal_bounds
        if not lower <= upper:
            expected = "the lower not above the upper"
            raise InvalidValue(f"{self.key}: min_normal, max_normal", [lower, upper], expected)
        if self.has_ratio and lower < 0.0:
            expected = "a force >= 0 beside friction, pressure or yaw_friction"
            raise InvalidValue(f"{self.key}: min_normal", lower, expected)
        if not self._bounds_normal and self.max is None:
            raise ProblemError(
                f"{self.key}: bounds nothing; give friction, min_normal, max_normal, max, pressure or "
                "yaw_friction"
            )

    def check_kind(self, found: Constraint) -> None:
        """Refuse what is said of forces that a constraint does not have.

        Raises
        ------
        ProblemError
        """
        key, kind = self.key, found.kind
        if self.normal is not None and found.own_normal is not None:
            raise ProblemError(f"{key}: normal: a {kind} has its own; leave it out")
        if self.friction is not None and not found.fixes_origin:
            raise ProblemError(
                f"{key}: friction: a {kind} lets the frame slide and has no friction; hold the frame by a "
                "point, a hinge or a weld"
            )
        for name in ("pressure", "yaw_friction"):
            if getattr(self, name) is not None and found.attitude is None:
                raise ProblemError(f"{key}: {name}: a {kind} exerts no such torque; a weld does")
        forces, normal = found.wrench_map[:3], np.array(self.normal_of(found))
        missing = normal - forces @ np.linalg.pinv(forces) @ normal
        if self._bounds_normal and np.linalg.norm(missing) > _ALONG:
            raise ProblemError(f"{key}: normal: a {kind} exerts no force along its axis; give one across it")

    def normal_of(self, found: Constraint) -> Axis:
        """The normal in the axes of the second frame; of a rod the first component is along it."""
        return found.own_normal or self.normal or _Z

    def write(self) -> dict[str, Any]:
        """Keys of `[[path]]` that read back as the same."""
        table: dict[str, Any] = {"name": self.name, "kind": ContactTerm.kind, "constraint": self.constraint}
        names = "normal", "pressure", "friction", "facets", "min_normal", "max_normal", "max", "yaw_friction"
        for name, value in ((name, getattr(self, name)) for name in names):
            table |= {} if value is None else {name: list(value) if isinstance(value, tuple) else value}
        table |= {} if self.impulses else {"impulses": False}
        table |= {} if self.surface is None else self.surface.keys
        return {**table, **self.span.write()}
