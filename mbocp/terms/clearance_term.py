"""Clearance: spheres of a robot keep their distance from shapes, and from each other.

The rows are one function of numbers, called in a loop: for each row a sphere, by the place that carries
it and its centre, and a core (see `mbocp.terms.distances`), by its placement. Places are frames of the robot;
how these are placed, and how their placements change, is computed once for all rows. Further places move by
the time, which then follows q: each in pieces, of which the one at that time is chosen. So functions depend
on how many rows there are, and not on what these are about; numbers of rows are rounded up, and rows that are
not needed are about things that are far away. Rows about hulls (see `mbocp.terms.distances`) name theirs in a
table of hulls.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.robot.collision.obstacle_motion import PIECE, placement_of_piece
from mbocp.symbolic.columns import STAYS_A_CALL, WHERE_ANY, add_chosen_columns, choose_columns
from mbocp.terms.bounded import Structure
from mbocp.terms.distances import (
    CORE,
    PLANE,
    Core,
    HullCore,
    core_of,
    distance_from_core,
    hull_measure,
    level_off,
    plane_slots,
)
from mbocp.terms.point import Point

_LEAST_SLOTS = 16
_CENTER, _AT, _AXES, _KEPT, _PLACED = slice(0, 3), slice(3, 6), slice(6, 15), 15, 16
_NUMBERS = _PLACED + CORE  # of a row, beside its places
_OF_HULL = _PLACED + 2  # of a row about a hull: which, and its sharpness
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
    core : Core or HullCore
    kept : float
        Least distance of the sphere's centre from the core [m].
    """

    place: int
    other: int
    center: Array
    at: Array
    axes: Array
    core: Core | HullCore
    kept: float = 0.0

    @classmethod
    def idle(cls) -> ClearanceRow:
        """One about things that are far from each other."""
        point = core_of("sphere", (0.0,), 1e-3)
        return cls(0, 0, np.zeros(3), np.array([0.0, 0.0, _FAR]), np.eye(3), point)

    @cached_property
    def numbers(self) -> Array:
        """Shape (_NUMBERS,); those of a hull without which it is."""
        core = [self.core.sharpness] if isinstance(self.core, HullCore) else self.core.numbers
        return np.concatenate([self.center, self.at, self.axes.ravel(order="F"), [self.kept], core])


@dataclass(frozen=True)
class HullSlots:
    """Room for hulls.

    Attributes
    ----------
    rows : int
        About hulls; they follow those about other shapes.
    hulls, planes : int
        How many hulls, and planes of each.
    """

    rows: int = 0
    hulls: int = 0
    planes: int = 0

    @classmethod
    def of(cls, cores: list[HullCore], rows: int) -> HullSlots:
        """For some hulls; 1, 2, 4, 8, ... of them."""
        if not cores:
            return cls()
        return cls(rows, 1 << (len(cores) - 1).bit_length(), plane_slots(max(len(c.planes) for c in cores)))

    @property
    def sizes(self) -> dict[str, int]:
        """Size of each parameter."""
        found = {"of_hulls": (2 + _OF_HULL) * self.rows, "hulls": PLANE * self.planes * self.hulls}
        return found if self.rows else {}

    def numbers(self, rows: list[ClearanceRow]) -> dict[str, Array]:
        """Value of each parameter; rows that are not about hulls are not needed."""
        if not self.rows:
            return {}
        cores = list({id(row.core): row.core for row in rows if isinstance(row.core, HullCore)}.values())
        nothing = HullCore(np.zeros((0, PLANE)), 1.0, 1.0)
        hulls = cores + [nothing] * (self.hulls - len(cores))
        table = np.zeros((len(rows), 2 + _OF_HULL))
        for line, row in zip(table, rows, strict=True):
            which = next((k for k, core in enumerate(cores) if core is row.core), 0)
            sharpness = row.core.sharpness if isinstance(row.core, HullCore) else 1.0
            line[:] = [row.place, row.other, which, *row.numbers[:_PLACED], sharpness]
        return {
            "of_hulls": table.ravel(),
            "hulls": np.concatenate([hull.fill(self.planes) for hull in hulls]),
        }


@dataclass(frozen=True)
class ClearanceTerm(Structure):
    """The structure of clearances.

    Attributes
    ----------
    frames : tuple of int
        The places 1, 2, ...; the place 0 is the world.
    still : int
        Rows whose shapes are in the world.
    moving : int
        Rows whose shapes are at any place; they follow.
    hull_slots : HullSlots
        Rows about hulls at any place follow these.
    movers, pieces : int
        Places that move by the time, which follow the frames, and the pieces of each motion.
    """

    frames: tuple[int, ...]
    still: int
    moving: int
    hull_slots: HullSlots = HullSlots()
    movers: int = 0
    pieces: int = 0

    kind = "clearance"

    @property
    def signature(self) -> dict[str, Any]:
        """What its function depends on."""
        found = super().signature
        return found if self.movers else {k: v for k, v in found.items() if k not in ("movers", "pieces")}

    @property
    def rows(self) -> int:
        """One for each sphere and shape."""
        return self.still + self.moving + self.hull_slots.rows

    @property
    def sizes(self) -> dict[str, int]:
        """Size of each parameter."""
        found = {"still": (1 + _NUMBERS) * self.still, "moving": (2 + _NUMBERS) * self.moving}
        motions = {"motions": PIECE * self.pieces * self.movers} if self.movers else {}
        return found | self.hull_slots.sizes | motions

    def numbers(self, rows: list[ClearanceRow]) -> dict[str, Array]:
        """Value of each parameter but for the motions."""
        until = self.still + self.moving
        still, moving, of_hulls = rows[: self.still], rows[self.still : until], rows[until:]
        return {
            "still": np.concatenate([np.zeros(0), *(np.append(r.place, r.numbers) for r in still)]),
            "moving": np.concatenate([np.zeros(0), *([r.place, r.other, *r.numbers] for r in moving)]),
            **self.hull_slots.numbers(of_hulls),
        }

    def function(self, at: Point) -> ca.Function:
        """(q, m, still, moving) -> h, dh_dq, upper Hessian of m'h; h are distances of centres from cores [m].

        As far as these are near, see `mbocp.terms.distances.level_off`.

        Parameters
        ----------
        at : Point
            Its q are plain symbols, and so is its time, which follows q. The symbols of its mechanics are the
            last input, where there are any.
        """
        symbols = self._coordinates(at)
        nq = symbols.numel()
        q, m = ca.MX.sym("q", nq), ca.MX.sym("m", self.rows)
        given = {name: ca.MX.sym(name, size) for name, size in self.sizes.items()}
        numbers_of_robot = _numbers_of(at)
        known = [*self._pieces_at(q, given), *numbers_of_robot]
        columns, inputs = self._columns(at)
        places, bend = _places(symbols, columns, inputs)
        placed = places(q, *known)
        num_places = len(columns)
        h: list[ca.MX] = []
        dh: list[ca.MX] = []
        hessian, weights = ca.MX.zeros(nq * (nq + 1) // 2), ca.MX.zeros(_PLACE, num_places)
        for group in self._groups:
            first, count = sum(part.numel() for part in h), group.count
            chosen, numbers = group.take(given)
            distance = _distance(_PLACE * (1 + nq), group.carriers, group.measure).map(count)
            slopes = _slopes(nq, group.carriers, group.measure).map(count)
            arguments = [*(choose_columns(placed, which) for which in chosen), numbers]
            values, is_near = distance(*arguments)
            found = slopes(is_near, *arguments, m[first : first + count].T)
            h.append(values.T)
            dh.append(found[0].T)
            hessian += ca.repsum(found[1], 1, count)
            for which, share in zip(chosen, found[2:], strict=True):  # added up by place
                weights += add_chosen_columns(num_places, which, share)
        upper = ca.MX(ca.Sparsity.upper(nq), hessian) + bend(q, weights, *known)
        outputs = [ca.vertcat(*h), ca.vertcat(*dh), upper]
        return ca.Function("clearance", [q, m, *given.values(), *numbers_of_robot], outputs)

    def values(self, at: Point) -> ca.Function:
        """(q, still, moving) -> h, as in `function`."""
        numbers_of_robot, symbols = _numbers_of(at), self._coordinates(at)
        q = ca.MX.sym("q", symbols.numel())
        given = {name: ca.MX.sym(name, size) for name, size in self.sizes.items()}
        columns, inputs = self._columns(at)
        place = ca.Function("placed", [symbols, *inputs], [ca.densify(ca.horzcat(*columns))])
        placed = place(q, *self._pieces_at(q, given), *numbers_of_robot)
        h = [ca.MX(0, 1)]
        for group in self._groups:
            chosen, numbers = group.take(given)
            distance = _distance(_PLACE, group.carriers, group.measure).map(group.count)
            h.append(distance(*(choose_columns(placed, which) for which in chosen), numbers)[0].T)
        return ca.Function("clearances", [q, *given.values(), *numbers_of_robot], [ca.vertcat(*h)])

    def _coordinates(self, at: Point) -> ca.SX:
        """Symbols of the configuration, and of the time where something moves by it."""
        return ca.vertcat(at.q, at.time) if self.movers else at.q

    def _columns(self, at: Point) -> tuple[list[ca.SX], list[ca.SX]]:
        """Axes and origin of each place, the world first, and the symbols of numbers that they depend on."""
        columns, inputs = _columns(at, self.frames), _symbols_of(at)
        if not self.movers:
            return columns, inputs
        pieces = ca.SX.sym("pieces", PIECE, self.movers)
        return [*columns, *(placement_of_piece(at.time, piece) for piece in ca.horzsplit(pieces))], [
            pieces,
            *inputs,
        ]

    def _pieces_at(self, q: ca.MX, given: dict[str, ca.MX]) -> list[ca.MX]:
        """The piece of each motion at the time that follows the configuration."""
        if not self.movers:
            return []
        t, table = ca.SX.sym("t"), ca.SX.sym("motions", PIECE, self.pieces * self.movers)
        begins = ca.reshape(table[0, :], self.pieces, self.movers)
        first = self.pieces * ca.DM(range(self.movers)).T
        number = first + ca.sum1(begins[1:, :] <= t)
        which = ca.Function("pieces_at", [t, table], [ca.densify(number)])
        motions = ca.reshape(given["motions"], PIECE, self.pieces * self.movers)
        return [choose_columns(motions, which(q[-1], motions))]

    @property
    def _groups(self) -> list[_Group]:
        """Rows of the same kind, those that there are."""
        slots = self.hull_slots
        found = [
            _Group("still", self.still, 1, _core_measure()),
            _Group("moving", self.moving, 2, _core_measure()),
        ]
        if slots.rows:
            found.append(_Group("of_hulls", slots.rows, 2, hull_measure(slots.planes), slots.hulls))
        return [group for group in found if group.count]


@dataclass(frozen=True)
class _Group:
    """Rows of the same kind: their parameter, how many there are, of how many carriers, and their measure.

    The measure is a function (p, numbers of the shape) -> distance, gradient, curvature.
    """

    name: str
    count: int
    carriers: int
    measure: ca.Function
    hulls: int = 0

    def take(self, given: dict[str, ca.MX]) -> tuple[list[ca.MX], ca.MX]:
        """Places, one row for each carrier, and a column of numbers for each row."""
        if not self.hulls:
            table = ca.reshape(given[self.name], self.carriers + _NUMBERS, self.count)
            return [table[k, :] for k in range(self.carriers)], table[self.carriers :, :]
        table = ca.reshape(given[self.name], 2 + _OF_HULL, self.count)
        hulls = ca.reshape(given["hulls"], -1, self.hulls)
        return [table[0, :], table[1, :]], ca.vertcat(table[3:, :], choose_columns(hulls, table[2, :]))


def _core_measure() -> ca.Function:
    p, core = ca.SX.sym("p", 3), ca.SX.sym("core", CORE)
    distance = distance_from_core(p, core)
    return ca.Function("distance", [p, core], [distance, *reversed(ca.hessian(distance, p))])


def _columns(at: Point, frames: tuple[int, ...]) -> list[ca.SX]:
    """Axes and origin of each place, the world first."""
    columns = [ca.vertcat(ca.vec(ca.densify(ca.SX.eye(3))), ca.SX.zeros(3))]
    for frame in frames:
        rotation = ca.densify(at.mechanics.frame_rotation(frame, at.q))
        columns.append(ca.vertcat(ca.vec(rotation), at.mechanics.frame_position(frame, at.q)))
    return columns


def _symbols_of(at: Point) -> list[ca.SX]:
    """Symbols of the robot's numbers, if there are any."""
    return [at.mechanics.symbols] if at.mechanics.symbols.numel() else []


def _numbers_of(at: Point) -> list[ca.MX]:
    """What stands for them in functions that call others."""
    return [ca.MX.sym("numbers", symbols.numel()) for symbols in _symbols_of(at)]


def _places(symbols: ca.SX, columns: list[ca.SX], inputs: list[ca.SX]) -> tuple[ca.Function, ca.Function]:
    """Placements with their derivatives, a column for each place; and what their curvature adds.

    q -> (placement, its Jacobian by columns); (q, weights) -> upper Hessian of the weighted placements.
    """
    with_slopes = [ca.vertcat(c, ca.vec(ca.densify(ca.jacobian(c, symbols)))) for c in columns]
    weights = ca.SX.sym("weights", _PLACE, len(columns))
    hessian, _ = ca.hessian(ca.dot(weights, ca.horzcat(*columns)), symbols)
    sparsity = ca.Sparsity.upper(symbols.numel())
    upper = ca.SX(sparsity, ca.densify(hessian)[sparsity].nz[:])
    placed = ca.densify(ca.horzcat(*with_slopes))
    return (
        ca.Function("places", [symbols, *inputs], ca.cse([placed])),
        ca.Function("bend", [symbols, weights, *inputs], ca.cse([upper])),
    )


def _slopes(nq: int, carriers: int, measure: ca.Function) -> ca.Function:
    """(is_near, place..., numbers, m) -> dh, m times the curvature of h by first derivatives, m dh_dplace...

    What is not near has none of these. Along the tangent e of the configuration places are, to first order,
    their value and Jacobian times e. What these leave out of the second derivative is the curvature of the
    places, weighed with m dh_dplace.
    """
    given = [ca.SX.sym(f"place{k}", _PLACE * (1 + nq)) for k in range(carriers)]
    numbers, m = ca.SX.sym("numbers", _PLACED + measure.numel_in(1)), ca.SX.sym("m")
    is_near = ca.SX.sym("is_near")
    e, pull = ca.SX.sym("e", nq), ca.SX.sym("pull", 3)
    here = [column[:_PLACE] for column in given]
    moved = [column[:_PLACE] + ca.reshape(column[_PLACE:], _PLACE, nq) @ e for column in given]
    along = _point(moved, numbers)
    at_rest = ca.Function("rest", [e, *given, numbers], [along, ca.jacobian(along, e)])
    p0, J = at_rest(ca.SX.zeros(nq), *given, numbers)
    _, slope, curvature, _ = level_off(numbers[_KEPT], *measure(p0, numbers[_PLACED:]))
    rest = ca.Function("bilinear", [e, pull, *given, numbers], [ca.hessian(ca.dot(pull, along), e)[0]])
    bilinear = rest(ca.SX.zeros(nq), slope, *given, numbers)
    hessian = m * (J.T @ (curvature @ J) + bilinear)
    symbols = [ca.SX.sym(f"at{k}", _PLACE) for k in range(carriers)]
    pulled = ca.dot(pull, _point(symbols, numbers))
    shares = ca.Function(
        "shares", [pull, *symbols, numbers], [ca.densify(ca.gradient(pulled, s)) for s in symbols]
    ).call([m * slope, *here, numbers])
    upper = ca.densify(hessian)[ca.Sparsity.upper(nq)]
    outputs = [ca.densify(J.T @ slope), upper.nz[:], *shares]
    return ca.Function(WHERE_ANY, [is_near, *given, numbers, m], ca.cse(outputs), STAYS_A_CALL)


def _distance(rows: int, carriers: int, measure: ca.Function) -> ca.Function:
    """(place..., numbers) -> h, whether it is near; of places with so many rows the first ones count."""
    given = [ca.SX.sym(f"place{k}", rows) for k in range(carriers)]
    numbers = ca.SX.sym("numbers", _PLACED + measure.numel_in(1))
    p = _point([place[:_PLACE] for place in given], numbers)
    h, *_, is_near = level_off(numbers[_KEPT], *measure(p, numbers[_PLACED:]))
    return ca.Function("distance", [*given, numbers], ca.cse([h, is_near]), STAYS_A_CALL)


def _point(places: list[ca.SX], numbers: ca.SX) -> ca.SX:
    """Centre of a sphere from the middle of a core, in the axes of the shape, shape (3,) [m]."""
    point = _act(places[0], numbers[_CENTER])
    for place in places[1:]:
        point = ca.reshape(place[:9], 3, 3).T @ (point - place[9:])
    return ca.reshape(numbers[_AXES], 3, 3).T @ (point - numbers[_AT])


def _act(place: ca.SX, point: ca.SX) -> ca.SX:
    return ca.reshape(place[:9], 3, 3) @ point + place[9:]
