"""Clearance: spheres of a robot keep their distance from shapes, and from each other.

The rows are one function of numbers, called in a loop: for each row a sphere, by the place that carries
it and its centre, and a core (see `mbocp.terms.distances`), by its placement. Places are frames of the robot;
how these are placed, and how their placements change, is computed once for all rows. So functions depend on
how many rows there are, and not on what these are about; numbers of rows are rounded up, and rows that are
not needed are about things that are far away.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.terms.distances import CORE, Core, core_of, distance_from_core
from mbocp.terms.point import Point

__all__ = ["ClearanceRow", "ClearanceTerm", "clearance_slots"]

_LEAST_SLOTS = 16
_CENTER, _AT, _AXES, _CORE = slice(0, 3), slice(3, 6), slice(6, 15), slice(15, 15 + CORE)
_NUMBERS = 15 + CORE  # of a row, beside its places
_PLACE = 12  # axes by columns and origin
_FAR = 10.0  # [m]


def clearance_slots(count: int, least: int = 0) -> int:
    """How many rows there are where some are needed: 16, 64, 128, 256, ..., so that few are compiled."""
    slots = _LEAST_SLOTS
    while slots < max(count, least):
        slots *= 4 if slots == _LEAST_SLOTS else 2
    return slots if max(count, least) else 0


@dataclass(frozen=True)
class ClearanceRow:
    """What a row is about.

    Attributes
    ----------
    place, other : int
        What carries the sphere and the shape, see `ClearanceTerm`.
    center : ndarray, shape (3,)
        Of the sphere at its place [m].
    at : ndarray, shape (3,)
        Middle of the core at its place [m].
    axes : ndarray, shape (3, 3)
        Axes of the shape at its place, columns.
    core : Core
    """

    place: int
    other: int
    center: Array
    at: Array
    axes: Array
    core: Core

    @classmethod
    def idle(cls) -> ClearanceRow:
        """One about things that are far from each other."""
        point = core_of("sphere", (0.0,), 1e-3)
        return cls(0, 0, np.zeros(3), np.array([0.0, 0.0, _FAR]), np.eye(3), point)

    @property
    def numbers(self) -> Array:
        """Shape (_NUMBERS,)."""
        return np.concatenate([self.center, self.at, self.axes.ravel(order="F"), self.core.numbers])


@dataclass(frozen=True)
class ClearanceTerm:
    """The structure of clearances.

    Attributes
    ----------
    frames : tuple of int
        The places 1, 2, ...; the place 0 is the world.
    still : int
        Rows whose shapes are in the world.
    moving : int
        Rows whose shapes are at any place; they follow.
    """

    frames: tuple[int, ...]
    still: int
    moving: int

    has_velocity: ClassVar[bool] = False
    remembers: ClassVar[tuple[str, ...]] = ()

    @property
    def rows(self) -> int:
        """One for each sphere and shape."""
        return self.still + self.moving

    @property
    def sizes(self) -> dict[str, int]:
        """Size of each parameter."""
        return {"still": (1 + _NUMBERS) * self.still, "moving": (2 + _NUMBERS) * self.moving}

    @property
    def signature(self) -> dict[str, Any]:
        """What its function depends on."""
        return {"term": "clearance", **dataclasses.asdict(self)}

    def numbers(self, rows: list[ClearanceRow]) -> dict[str, Array]:
        """Value of each parameter."""
        still, moving = rows[: self.still], rows[self.still :]
        return {
            "still": np.concatenate([np.zeros(0), *(np.append(r.place, r.numbers) for r in still)]),
            "moving": np.concatenate([np.zeros(0), *([r.place, r.other, *r.numbers] for r in moving)]),
        }

    def function(self, at: Point) -> ca.Function:
        """(q, m, still, moving) -> h, dh_dq, upper Hessian of m'h; h are distances of centres from cores [m].

        Parameters
        ----------
        at : Point
            Its q are plain symbols.
        """
        nq = at.q.numel()
        q, m = ca.MX.sym("q", nq), ca.MX.sym("m", self.rows)
        given = {name: ca.MX.sym(name, size) for name, size in self.sizes.items()}
        places, bend = _places(at, self.frames)
        placed = places(q)
        num_places = len(self.frames) + 1
        h: list[ca.MX] = []
        dh: list[ca.MX] = []
        hessian, weights = ca.MX.zeros(nq * (nq + 1) // 2), ca.MX.zeros(_PLACE, num_places)
        plain = ca.MX.sym("plain", _PLACE, num_places)
        for name, count, carriers in (("still", self.still, 1), ("moving", self.moving, 2)):
            if not count:
                continue
            first = sum(part.numel() for part in h)
            table = ca.reshape(given[name], carriers + _NUMBERS, count)
            chosen = [table[k, :] for k in range(carriers)]
            row = _row(nq, carriers).map(count)
            arguments = [placed[:, which] for which in chosen]
            found = row(*arguments, table[carriers:, :], m[first : first + count].T)
            h.append(found[0].T)
            dh.append(found[1].T)
            hessian += ca.repsum(found[2], 1, count)
            for which, share in zip(chosen, found[3:], strict=True):  # added up by place
                weights += ca.jtimes(plain[:, which], plain, share, True)
        upper = ca.MX(ca.Sparsity.upper(nq), hessian) + bend(q, weights)
        outputs = [ca.vertcat(*h), ca.vertcat(*dh), upper]
        return ca.Function("clearance", [q, m, *given.values()], outputs)

    def values(self, at: Point) -> ca.Function:
        """(q, still, moving) -> h, as in `function`."""
        q = ca.MX.sym("q", at.q.numel())
        given = {name: ca.MX.sym(name, size) for name, size in self.sizes.items()}
        placed = ca.Function("placed", [at.q], [ca.densify(ca.horzcat(*_columns(at, self.frames)))])(q)
        h = [ca.MX(0, 1)]
        for name, count, carriers in (("still", self.still, 1), ("moving", self.moving, 2)):
            if count:
                table = ca.reshape(given[name], carriers + _NUMBERS, count)
                arguments = [placed[:, table[k, :]] for k in range(carriers)]
                h.append(_distance(carriers).map(count)(*arguments, table[carriers:, :]).T)
        return ca.Function("clearances", [q, *given.values()], [ca.vertcat(*h)])


def _columns(at: Point, frames: tuple[int, ...]) -> list[ca.SX]:
    """Axes and origin of each place, the world first."""
    columns = [ca.vertcat(ca.vec(ca.densify(ca.SX.eye(3))), ca.SX.zeros(3))]
    for frame in frames:
        rotation = ca.densify(at.mechanics.frame_rotation(frame, at.q))
        columns.append(ca.vertcat(ca.vec(rotation), at.mechanics.frame_position(frame, at.q)))
    return columns


def _places(at: Point, frames: tuple[int, ...]) -> tuple[ca.Function, ca.Function]:
    """Placements with their derivatives, a column for each place; and what their curvature adds.

    q -> (placement, its Jacobian by columns); (q, weights) -> upper Hessian of the weighted placements.
    """
    columns = _columns(at, frames)
    with_slopes = [ca.vertcat(c, ca.vec(ca.densify(ca.jacobian(c, at.q)))) for c in columns]
    weights = ca.SX.sym("weights", _PLACE, len(columns))
    hessian, _ = ca.hessian(ca.dot(weights, ca.horzcat(*columns)), at.q)
    upper = ca.densify(hessian)[ca.Sparsity.upper(at.q.numel())]
    return (
        ca.Function("places", [at.q], ca.cse([ca.densify(ca.horzcat(*with_slopes))])),
        ca.Function("bend", [at.q, weights], ca.cse([ca.SX(ca.Sparsity.upper(at.q.numel()), upper.nz[:])])),
    )


def _row(nq: int, carriers: int) -> ca.Function:
    """(place..., numbers, m) -> h, its gradient, m times its curvature by first derivatives, m dh_dplace...

    Along the tangent e of the configuration places are, to first order, their value and Jacobian times e.
    What these leave out of the second derivative is the curvature of the places, weighed with m dh_dplace.
    """
    given = [ca.SX.sym(f"place{k}", _PLACE * (1 + nq)) for k in range(carriers)]
    numbers, m = ca.SX.sym("numbers", _NUMBERS), ca.SX.sym("m")
    e, p, pull = ca.SX.sym("e", nq), ca.SX.sym("p", 3), ca.SX.sym("pull", 3)
    here = [column[:_PLACE] for column in given]
    moved = [column[:_PLACE] + ca.reshape(column[_PLACE:], _PLACE, nq) @ e for column in given]
    along = _point(moved, numbers)
    at_rest = ca.Function("rest", [e, *given, numbers], [along, ca.jacobian(along, e)])
    p0, J = at_rest(ca.SX.zeros(nq), *given, numbers)
    core = numbers[_CORE]
    distance = distance_from_core(p, core)
    h, slope, curvature = ca.Function("distance", [p, core], [distance, *reversed(ca.hessian(distance, p))])(
        p0, core
    )
    rest = ca.Function("bilinear", [e, pull, *given, numbers], [ca.hessian(ca.dot(pull, along), e)[0]])
    bilinear = rest(ca.SX.zeros(nq), slope, *given, numbers)
    hessian = m * (J.T @ (curvature @ J) + bilinear)
    symbols = [ca.SX.sym(f"at{k}", _PLACE) for k in range(carriers)]
    pulled = ca.dot(pull, _point(symbols, numbers))
    shares = ca.Function(
        "shares", [pull, *symbols, numbers], [ca.densify(ca.gradient(pulled, s)) for s in symbols]
    ).call([m * slope, *here, numbers])
    upper = ca.densify(hessian)[ca.Sparsity.upper(nq)]
    outputs = [h, ca.densify(J.T @ slope), upper.nz[:], *shares]
    return ca.Function("row", [*given, numbers, m], ca.cse(outputs))


def _distance(carriers: int) -> ca.Function:
    """(place..., numbers) -> h."""
    here, numbers = [ca.SX.sym(f"place{k}", _PLACE) for k in range(carriers)], ca.SX.sym("numbers", _NUMBERS)
    h = distance_from_core(_point(here, numbers), numbers[_CORE])
    return ca.Function("row_value", [*here, numbers], ca.cse([h]))


def _point(places: list[ca.SX], numbers: ca.SX) -> ca.SX:
    """Centre of a sphere from the middle of a core, in the axes of the shape, shape (3,) [m]."""
    point = _act(places[0], numbers[_CENTER])
    for place in places[1:]:
        point = ca.reshape(place[:9], 3, 3).T @ (point - place[9:])
    return ca.reshape(numbers[_AXES], 3, 3).T @ (point - numbers[_AT])


def _act(place: ca.SX, point: ca.SX) -> ca.SX:
    return ca.reshape(place[:9], 3, 3) @ point + place[9:]
