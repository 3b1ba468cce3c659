"""A ground to stand on: `[ground]`, and `contacts` of phases.

Phases say which feet stand. From there follow holds, via points where feet land, path constraints that keep
other feet above the ground, and bounds of the forces: all that can be written by hand, and is in the text of
the problem.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp._files import path_of
from mbocp._keys import Key, Table
from mbocp._text import shorten
from mbocp._tolerances import BOUND_TOLERANCE, RANK_TOLERANCE
from mbocp.exceptions import InvalidValue, ProblemError, Unreadable, locate
from mbocp.meshes.points import read_heights
from mbocp.problem._checks import check_choice, choice
from mbocp.problem.file.frame_table import FrameGoalTable
from mbocp.problem.file.path_table import PathTable
from mbocp.problem.file.phase_table import HoldTable, PhaseTable
from mbocp.problem.file.start_tables import ViaTable
from mbocp.problem.free_contact_bounds import refuse_beside_free
from mbocp.problem.goals.free_start import FreeStart
from mbocp.problem.timeline.hold import FreeContact, Hold
from mbocp.problem.timeline.phase import MEETINGS
from mbocp.robot import Robot
from mbocp.robot.kinematics import WORLD, frame_jacobian
from mbocp.terms.contact import ContactTerm
from mbocp.terms.free_contact import FACETS
from mbocp.terms.heights import HeightGrid, surface_from
from mbocp.terms.kinds import Height
from mbocp.terms.span import Share
from mbocp.terms.written import Finite, NonNegative, Pair, Positive

_CONTACTS = ("phases", "free")
_NEARLY = 5e-3  # [m] that a foot may be off a map at the start: nobody places four of them better
_LEAST_LOAD = 5e-3  # of the weight: at the tip of its cone a force has no one multiplier, and solvers stall
_AT_END = (None, 1.0)  # shares of via points at the end of their phase


class GroundTable(Table):
    """A level ground, a height map, or footholds, and what stands there."""

    feet: Annotated[
        dict[str, str],
        Key(
            "short names of [feet](contact.md#legs), and their frames",
            "",
            "required",
            takes="table of strings",
        ),
    ]
    height: Annotated[
        Finite | None,
        Key("of the ground, and of the origins of feet that stand", "m", "of the lowest foot at the start"),
    ] = None
    heights: Annotated[
        str | list[list[Finite]] | None,
        Key(
            "[map](contact.md#uneven-ground) of uneven ground, or its file; `height` is its zero",
            "m",
            "level",
            "string or list of lists",
        ),
    ] = None
    scale: Annotated[Positive | None, Key("of a unit of the heights of a file", "m", "1")] = None
    cell: Annotated[Positive | None, Key("from height to height", "m", "required with `heights`")] = None
    middle: Annotated[Pair, Key("x and y of the middle of the map", "m", "0")] = None
    friction: Annotated[
        NonNegative | None,
        Key("of the ground: see `path.friction`", "", "none: feet stick, and are not pulled"),
    ] = None
    min_normal: Annotated[
        NonNegative | None,
        Key("least force on a foot that stands", "N", "0.5 % of the weight with friction, else 0"),
    ] = None
    sole: Annotated[Pair, Key("sides of soles, which do not tilt", "m", "feet are points")] = None
    lift: Annotated[NonNegative, Key("least height of feet in the middle of a swing", "m")] = 0.0
    meeting: Annotated[
        str, choice(MEETINGS), Key('how feet land: with an `"impact"`, or `"soft"`, at rest')
    ] = "impact"
    contact: Annotated[
        str,
        choice(_CONTACTS),
        Key(
            '`"free"`: [the solver finds](contact.md#contact-without-phases) which feet stand',
            "",
            '`"phases"`',
        ),
    ] = "phases"
    smoothing: Annotated[
        Positive,
        Key("of free contacts: most of force by height, in units of the robot"),
    ] = 1e-4


def on_ground(
    phases_of_gait: list[PhaseTable],
    ground_table: GroundTable | None,
    is_cycle: bool,
    robot: Robot,
    said_q_start: Array,
    start_free: FreeStart | None,
    folder: Path | None = None,
) -> tuple[list[PhaseTable], list[Any], tuple[Hold, ...]]:
    """Return the phases with what follows from their contacts, path constraints, and feet that are free.

    Raises
    ------
    ProblemError, UnknownFrame
        If a phase has contacts without a ground, or a foot is unknown or does not stand on it.
    """
    phase_table = phases_of_gait
    if ground_table is None:
        for table in phase_table:
            if table.contacts is not None:
                raise ProblemError(f"phase {table.name!r}: contacts: of which feet? Say it in [ground]")
        return phase_table, [], ()
    if ground_table.contact == "free":
        _check_free(ground_table, phase_table, start_free)
        ground = _Ground.of(ground_table, robot, said_q_start, folder or Path())
        return phase_table, [ground.force(name) for name in ground_table.feet], ground.free_feet()
    if not phase_table:
        raise ProblemError("ground: phases say which feet stand; give one [[phase]] with contacts at least")
    ground = _Ground.of(ground_table, robot, said_q_start, folder or Path())
    stands = [ground.contacts(table) for table in phase_table]
    ground.check_start(phase_table[0], stands[0])
    swings = ground.swings(phase_table, stands, is_cycle=is_cycle)
    found = [ground.complete(*each) for each in zip(phase_table, stands, swings, strict=True)]
    if start_free is not None:
        found[0] = ground.complete_start(found[0], stands[0], robot, said_q_start, start_free.q)
    used = [name for name in ground.table.feet if any(name in names for names in stands)]
    return found, [ground.force(name) for name in used], ()


def _check_free(table: GroundTable, phases: Sequence[PhaseTable], start_free: FreeStart | None) -> None:
    """Refuse what is said of ground, phases and start that contacts that are found do not go with."""
    others = {
        "a ground without friction": not table.friction,
        "ground.heights": table.heights is not None,
        "ground.sole": table.sole is not None,
        "ground.lift": table.lift > 0.0,
        "ground.min_normal": bool(table.min_normal),
        "start.free": start_free is not None,
        "contacts of phases, or a gait": any(phase.contacts is not None for phase in phases),
        "holds of phases": any(phase.hold or phase.release for phase in phases),
    }
    refuse_beside_free(others)


class _Swing(NamedTuple):
    """A foot in the air in a phase.

    Attributes
    ----------
    foot : str
    low, high : float
        Of the heights of the ground where it left and where it lands: the lower and the higher one [m].
    lands : float, optional
        Height of the ground where it lands at the end of the phase [m].
    middle : float, optional
        Which part of the phase is the middle of the swing.
    """

    foot: str
    low: float
    high: float
    lands: float | None = None
    middle: float | None = None


@dataclass(frozen=True, eq=False)
class _Ground:
    """A ground, its height [m], least forces of feet [N], places of these at the start, keys of its map."""

    table: GroundTable
    height: float
    min_normal: float
    places: Mapping[str, pin.SE3]
    map: Mapping[str, Any]

    @classmethod
    def of(cls, table: GroundTable, robot: Robot, q_start: Array, folder: Path) -> _Ground:
        if not table.feet:
            raise ProblemError("ground.feet: there are none; name the frames of feet")
        check_choice("ground.meeting", table.meeting, MEETINGS)
        with locate("ground.feet"):
            places = {name: robot.frame_placement(frame, q_start) for name, frame in table.feet.items()}
        weight = pin.computeTotalMass(robot.model) * float(np.linalg.norm(robot.model.gravity.linear))
        least = 0.0 if table.friction is None else _LEAST_LOAD * weight
        min_normal = least if table.min_normal is None else table.min_normal
        surface = _surface(table, folder)
        above = [_above(surface, place) for place in places.values()]
        height = min(above) if table.height is None else table.height
        keys = {} if surface is None else surface.keys
        keys |= {"middle": [*keys["middle"][:2], height]} if keys else {}
        return cls(table, height, min_normal, places, keys)

    def contacts(self, table: PhaseTable) -> Sequence[str]:
        """Names of the feet that stand in a phase."""
        for name in table.contacts or ():
            check_foot(f"phase {table.name!r}: contacts", name, self.table)
        return table.contacts or ()

    def check_start(self, table: PhaseTable, stands: Sequence[str]) -> None:
        """Refuse feet that stand in the air."""
        for name in stands:
            there = float(self.places[name].translation[2])
            ground = self.height
            if self.map:
                ground = there - _above(surface_from(self.map, "ground"), self.places[name])
            if abs(there - ground) > (_NEARLY if self.map else BOUND_TOLERANCE):
                raise ProblemError(
                    f"phase {table.name!r}: contacts: at the start {name!r} is at z = {there:.6g} m, and the "
                    f"ground at {ground:.6g} m; move the start, or ground.height"
                )

    def complete_start(
        self, table: PhaseTable, stands: Sequence[str], robot: Robot, q_start: Array, free: BoolArray
    ) -> PhaseTable:
        """The first phase, with feet that a free start moves held where the ground is.

        Raises
        ------
        ProblemError
            If what is free moves some of them, and cannot bring each to the ground.
        """
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        places = [robot.frame_names.index(self.table.feet[name]) for name in stands]
        rows = [frame_jacobian(robot.model, q_start, place, axes)[2, free] for place in places]
        heights = np.reshape(rows, (len(stands), int(free.sum())))
        moved = [
            name for name, row in zip(stands, heights, strict=True) if np.abs(row).max(initial=0.0) > 0.0
        ]
        if not moved:
            return table
        if np.linalg.matrix_rank(heights, tol=RANK_TOLERANCE) < len(moved):
            raise ProblemError(
                f"start.free: feet stand in phase {table.name!r}, and what is free cannot bring "
                f"each of {', '.join(map(repr, moved))} to the ground; free more of base and legs"
            )
        if self.map:
            share = 1.0 / table.steps
            on_it = [self._height(name, table, "on the ground", share, share, 0.0, 0.0) for name in moved]
            return table.model_copy(update={"path": [*table.path, *on_it]})
        here = ViaTable(share=1.0 / table.steps, frame=[self._land(name, self.height, ()) for name in moved])
        return table.model_copy(update={"via": [here, *table.via]})

    def swings(
        self, tables: Sequence[PhaseTable], stands: Sequence[Sequence[str]], *, is_cycle: bool
    ) -> list[list[_Swing]]:
        """Feet that are in the air, for each phase.

        The middle of a swing that goes on where a cycle closes is its end: at its start the image is as high.
        """
        ends = np.cumsum([0, *(table.steps for table in tables)])
        found: list[list[_Swing]] = [[] for _ in tables]
        for name in self.table.feet:
            in_air, height = [False, *(name not in names for names in stands), False], self.height
            changes = [k for k, (before, after) in enumerate(pairwise(in_air)) if before != after]
            for first, last in zip(changes[::2], changes[1::2], strict=True):  # `last` is the phase after it
                is_cut = is_cycle and (first == 0 or last == len(tables))
                middle = ends[-1] if is_cut else (ends[first] + ends[last]) / 2
                there = self._height_at_end(tables[last - 1], name) if last < len(tables) else None
                low, high = sorted((height, height if there is None else there))
                for k in range(first, last):
                    share = (middle - ends[k]) / tables[k].steps
                    found[k].append(
                        _Swing(
                            name,
                            low,
                            high,
                            there if k == last - 1 else None,
                            float(share) if 0.0 < share <= 1.0 else None,
                        )
                    )
                height = height if there is None else there
        return found

    def _height_at_end(self, table: PhaseTable, name: str) -> float:
        """Of the ground where a foot lands: where a via point wants it, else that of all of it."""
        for frame in _frames_at_end(table, self.table.feet[name]):
            if self.map and (frame.z is not None or frame.position is not None):
                raise ProblemError(f"phase {table.name!r}: via: {name!r} lands on a map; give x and y alone")
            z = frame.position[2] if frame.position is not None else frame.z
            if z is not None:
                return float(z)
        return self.height

    def complete(self, table: PhaseTable, stands: Sequence[str], swings: Sequence[_Swing]) -> PhaseTable:
        """A phase in which feet stand, others stay above the ground, and some land at its end."""
        kind = "point" if self.table.sole is None else "weld"
        holds = [
            HoldTable(name=name, frame=self.table.feet[name], kind=kind, meeting=self.table.meeting)
            for name in stands
        ]
        above = [path for swing in swings for path in self._above(table, swing)]
        landing = [swing for swing in swings if swing.lands is not None]
        if self.map:
            names = [swing.foot for swing in landing]
            above += [self._height(name, table, "on the ground", 1.0, 1.0, 0.0, 0.0) for name in names]
            landing = []
        at_end = [
            self._land(swing.foot, swing.lands, _frames_at_end(table, self.table.feet[swing.foot]))
            for swing in landing
            if swing.lands is not None
        ]
        at_end = [frame for frame in at_end if frame.z is not None or frame.axis is not None]
        update = {"hold": [*table.hold, *holds], "path": [*table.path, *above]}
        return table.model_copy(update={**update, "via": _with_frames(table.via, at_end)})

    def free_feet(self) -> tuple[Hold, ...]:
        """Feet whose forces are found in all steps.

        Raises
        ------
        ProblemError
            If one is below the ground at the start.
        """
        for name, place in self.places.items():
            if (z := float(place.translation[2])) < self.height - BOUND_TOLERANCE:
                raise ProblemError(
                    f"ground: at the start {name!r} is at z = {z:.6g} m, below the ground at "
                    f"{self.height:.6g} m; move the start, or ground.height"
                )
        contact = FreeContact(height=self.height, smoothing=self.table.smoothing)
        feet = self.table.feet.items()
        return tuple(Hold(name=name, frame=frame, kind="point", free=contact) for name, frame in feet)

    def force(self, name: str) -> Any:
        """The ground pushes, and holds as far as its friction does."""
        friction, sole = self.table.friction, self.table.sole
        is_free = self.table.contact == "free"
        least = 0.0 if is_free else self.min_normal
        found: dict[str, Any] = {"kind": ContactTerm.kind, "constraint": name, "min_normal": least}
        found |= {"facets": FACETS} if is_free else {}
        found |= {} if friction is None else {"friction": friction}
        found |= {} if sole is None else {"pressure": sole}
        found |= self.map
        return PathTable(**found)

    def _above(self, table: PhaseTable, swing: _Swing) -> list[Any]:
        """Keep a foot above the ground within a phase, and at its end unless it lands there."""
        last = table.steps if swing.lands is None else table.steps - 1
        if last < 1:
            return []
        shares = {"above the ground": (1.0 / table.steps, last / table.steps, swing.low)}
        lift = self.table.lift + swing.high
        if swing.middle is not None and lift > swing.low:
            shares["lifted"] = (swing.middle, swing.middle, lift)
        if self.map:  # heights are those above it
            lows = {"above the ground": 0.0, "lifted": self.table.lift}
            return [
                self._height(swing.foot, table, words, since, until, lows[words], np.inf)
                for words, (since, until, _) in shares.items()
            ]
        found = []
        for words, (since, until, z) in shares.items():
            keys: dict[str, Any] = {"name": f"{swing.foot} {words} in {table.name}", "kind": "position"}
            keys |= {"frame": self.table.feet[swing.foot], "z": [z, np.inf]}
            keys |= {"from": Share(since), "until": Share(until)}
            found.append(PathTable(**keys))
        return found

    def _height(
        self, foot: str, table: PhaseTable, words: str, since: float, until: float, least: float, most: float
    ) -> Any:
        """A bound on the height of a foot above the map, between shares of a phase."""
        keys: dict[str, Any] = {"name": f"{foot} {words} in {table.name}", "kind": Height.kind}
        keys |= {"frame": self.table.feet[foot], "min": least, **self.map}
        keys |= {"from": Share(since), "until": Share(until)} | ({"max": most} if np.isfinite(most) else {})
        return PathTable(**keys)

    def _land(self, name: str, height: float, said: Sequence[FrameGoalTable]) -> FrameGoalTable:
        """A foot on the ground, a sole as level as at the start; but for a height that is said."""
        found: dict[str, Any] = {"name": self.table.feet[name]}
        if all(frame.z is None and frame.position is None for frame in said):
            found["z"] = height
        if self.table.sole is not None:
            up = [0.0, 0.0, 1.0]
            found |= {"axis": (self.places[name].rotation.T @ up).tolist(), "direction": up}
        return FrameGoalTable(**found)


def _surface(table: GroundTable, folder: Path) -> HeightGrid | None:
    """The map of a ground, its zero at z = 0; None where it is level.

    Raises
    ------
    ProblemError, InvalidValue
        If its file cannot be read, or keys do not fit.
    """
    middle, given = table.middle or [0.0, 0.0], dict(table)
    if isinstance(table.heights, str):
        path = folder / path_of(table.heights)
        try:
            given["heights"] = (read_heights(path) * (table.scale or 1.0)).tolist()
        except Unreadable as error:
            what = f"{shorten(str(path))}, which {error}"
            raise InvalidValue("ground.heights", what, "a map: NPY, CSV, PNG or TIFF") from error
    elif table.scale is not None:
        raise ProblemError("ground.scale: of a file; heights that are written are in metres")
    given["middle"] = None if table.middle is None else [*middle, 0.0]
    surface = surface_from(given, "ground")
    if surface is not None and table.sole is not None:
        raise ProblemError("ground.sole: not on a map: feet on it are points")
    return surface


def _above(surface: HeightGrid | None, place: pin.SE3) -> float:
    """Height of a place above a map [m]."""
    z = float(place.translation[2])
    return z if surface is None else z - float(surface.at(place.translation[None])[0][0])


def check_foot(key: str, name: str, ground: GroundTable) -> None:
    """Refuse a foot that the ground does not name.

    Raises
    ------
    ProblemError
    """
    if name not in ground.feet:
        raise ProblemError(f"{key}: no foot {name!r}; [ground] has {', '.join(map(repr, ground.feet))}")


def _frames_at_end(table: PhaseTable, frame: str) -> list[FrameGoalTable]:
    """What is said of a frame's place in the world at the end of a phase."""
    return [
        goal
        for point in table.via
        if point.share in _AT_END
        for goal in point.frame
        if goal.name == frame and goal.relative_to in (None, WORLD)
    ]


def _with_frames(via: Sequence[ViaTable], at_end: list[FrameGoalTable]) -> list[ViaTable]:
    """Via points of a phase with frames at its end: in the one that is there, or in one more."""
    if not at_end:
        return list(via)
    there = [k for k, point in enumerate(via) if point.share in _AT_END]
    if not there:
        return [*via, ViaTable(frame=at_end)]
    k = there[0]
    return [*via[:k], via[k].model_copy(update={"frame": [*via[k].frame, *at_end]}), *via[k + 1 :]]
