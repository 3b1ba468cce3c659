"""A ground to stand on: `[ground]`, and `contacts` of phases.

Phases say which feet stand. From there follow holds, via points where feet land, path constraints that keep
other feet above the ground, and bounds of the forces: all that can be written by hand, and is in the text of
the problem.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray
from mbocp._keys import Key, Table
from mbocp._tolerances import BOUND_TOLERANCE, RANK_TOLERANCE
from mbocp.exceptions import ProblemError
from mbocp.problem._checks import check_choice, choice
from mbocp.problem.file.frame_table import FrameGoalTable
from mbocp.problem.file.goal_table import GoalTable
from mbocp.problem.file.messages import locate
from mbocp.problem.file.path_table import PathTable
from mbocp.problem.file.phase_table import HoldTable, PhaseTable
from mbocp.problem.file.via_table import ViaTable
from mbocp.problem.goals.free_start import FreeStart
from mbocp.problem.timeline.phase import MEETINGS
from mbocp.robot import Robot
from mbocp.robot.kinematics import frame_jacobian
from mbocp.terms import ContactTerm
from mbocp.terms.span import Share
from mbocp.terms.written import Finite, NonNegative, Pair


class GroundTable(Table):
    """A level ground, and what stands on it."""

    feet: Annotated[
        dict[str, str],
        Key(
            "short names of feet, for `phase.contacts`, and their frames; [legs](contact.md#legs)",
            "",
            "required",
            takes="table of strings",
        ),
    ]
    height: Annotated[
        Finite | None,
        Key("of the ground: z of the origins of feet that stand", "m", "of the lowest foot at the start"),
    ] = None
    friction: Annotated[
        NonNegative | None,
        Key("of the ground: see `path.friction`", "", "none: feet stick, and are not pulled"),
    ] = None
    sole: Annotated[
        Pair,
        Key("sides of the soles about the frames of feet, which do not tilt then", "m", "feet are points"),
    ] = None
    lift: Annotated[
        NonNegative,
        Key("how far feet in the air are above the ground in the middle of a swing at least", "m"),
    ] = 0.0
    meeting: Annotated[
        str, choice(MEETINGS), Key('how feet land: with an `"impact"`, or `"soft"`, at rest already')
    ] = "impact"


def on_ground(
    phases_of_gait: list[PhaseTable],
    ground_table: GroundTable | None,
    goal_table: GoalTable,
    robot: Robot,
    said_q_start: Array,
    start_free: FreeStart | None,
) -> tuple[list[PhaseTable], list[Any]]:
    """Return the phases with what follows from their contacts, and path constraints of the whole motion.

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
        return phase_table, []
    if not phase_table:
        raise ProblemError("ground: phases say which feet stand; give one [[phase]] with contacts at least")
    ground = _Ground.of(ground_table, robot, said_q_start)
    stands = [ground.contacts(table) for table in phase_table]
    ground.check_start(phase_table[0], stands[0])
    after = [set(names) - set(before) for before, names in pairwise(stands)]
    highest = ground.highest(phase_table, stands, is_cycle=bool(goal_table.periodic))
    found = [
        ground.complete(table, names, lands, lifted)
        for table, names, lands, lifted in zip(phase_table, stands, [*after, set()], highest, strict=True)
    ]
    if start_free is not None:
        found[0] = ground.complete_start(found[0], stands[0], robot, said_q_start, start_free.q)
    used = [name for name in ground.table.feet if any(name in names for names in stands)]
    return found, [ground.force(name) for name in used]


@dataclass(frozen=True, eq=False)
class _Ground:
    """A ground, its height [m], and where feet are at the start, by name."""

    table: GroundTable
    height: float
    places: Mapping[str, pin.SE3]

    @classmethod
    def of(cls, table: GroundTable, robot: Robot, q_start: Array) -> _Ground:
        if not table.feet:
            raise ProblemError("ground.feet: there are none; name the frames of feet")
        check_choice("ground.meeting", table.meeting, MEETINGS)
        with locate("ground.feet"):
            places = {name: robot.frame_placement(frame, q_start) for name, frame in table.feet.items()}
        lowest = min(float(place.translation[2]) for place in places.values())
        return cls(table, lowest if table.height is None else table.height, places)

    def contacts(self, table: PhaseTable) -> Sequence[str]:
        """Names of the feet that stand in a phase."""
        for name in table.contacts or ():
            check_foot(f"phase {table.name!r}: contacts", name, self.table)
        return table.contacts or ()

    def check_start(self, table: PhaseTable, stands: Sequence[str]) -> None:
        """Refuse feet that stand in the air."""
        for name in stands:
            there = float(self.places[name].translation[2])
            if abs(there - self.height) > BOUND_TOLERANCE:
                raise ProblemError(
                    f"phase {table.name!r}: contacts: at the start {name!r} is at z = {there:.6g} m, and the "
                    f"ground at {self.height:.6g} m; move the start, or ground.height"
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
        here = ViaTable(share=1.0 / table.steps, frame=[self._landed(name) for name in moved])
        return table.model_copy(update={"via": [here, *table.via]})

    def highest(
        self, tables: Sequence[PhaseTable], stands: Sequence[Sequence[str]], *, is_cycle: bool
    ) -> list[dict[str, float]]:
        """For each phase the feet that are lifted in it, and at which part of it: in the middle of a swing.

        The middle of a swing that goes on where a cycle closes is its end: at its start the image is as high.
        """
        ends = np.cumsum([0, *(table.steps for table in tables)])
        found: list[dict[str, float]] = [{} for _ in tables]
        for name in self.table.feet:
            in_air = [False, *(name not in names for names in stands), False]
            changes = [k for k, (before, after) in enumerate(pairwise(in_air)) if before != after]
            for first, last in zip(
                changes[::2], changes[1::2], strict=True
            ):  # phases of a swing, but the last
                if is_cycle and (first == 0 or last == len(tables)):
                    if last == len(tables):
                        found[-1][name] = 1.0
                    continue
                middle = (ends[first] + ends[last]) / 2
                k = int(np.searchsorted(ends, middle, side="left")) - 1
                found[k][name] = float((middle - ends[k]) / tables[k].steps)
        return found

    def complete(
        self, table: PhaseTable, stands: Sequence[str], lands: Set[str], lifted: Mapping[str, float]
    ) -> PhaseTable:
        """A phase in which feet stand, others stay above the ground, and some land at its end."""
        kind = "point" if self.table.sole is None else "weld"
        holds = [
            HoldTable(name=name, frame=self.table.feet[name], kind=kind, meeting=self.table.meeting)
            for name in stands
        ]
        swings = [name for name in self.table.feet if name not in stands]
        above = [
            path
            for name in swings
            for path in self._above(table, name, lifted.get(name), lands=name in lands)
        ]
        at_end = [self._landed(name) for name in self.table.feet if name in lands]
        update = {"hold": [*table.hold, *holds], "path": [*table.path, *above]}
        return table.model_copy(update={**update, "via": _with_frames(table.via, at_end)})

    def force(self, name: str) -> Any:
        """The ground pushes, and holds as far as its friction does."""
        friction, sole = self.table.friction, self.table.sole
        found: dict[str, Any] = {"kind": ContactTerm.kind, "constraint": name}
        found |= {"friction": friction} if friction is not None else {"min_normal": 0.0}
        found |= {} if sole is None else {"pressure": sole}
        return PathTable(**found)

    def _above(self, table: PhaseTable, name: str, highest: float | None, *, lands: bool) -> list[Any]:
        """Keep a foot above the ground within a phase, and at its end unless it lands there."""
        last = table.steps - 1 if lands else table.steps
        if last < 1:
            return []
        shares = {"above the ground": (1.0 / table.steps, last / table.steps, 0.0)}
        if self.table.lift > 0.0 and highest is not None:
            shares["lifted"] = (highest, highest, self.table.lift)
        found = []
        for words, (since, until, lift) in shares.items():
            keys: dict[str, Any] = {"name": f"{name} {words} in {table.name}", "kind": "position"}
            keys |= {"frame": self.table.feet[name], "z": [self.height + lift, np.inf]}
            keys |= {"from": Share(since), "until": Share(until)}
            found.append(PathTable(**keys))
        return found

    def _landed(self, name: str) -> FrameGoalTable:
        """A foot on the ground, a sole as level as at the start."""
        found: dict[str, Any] = {"name": self.table.feet[name], "z": self.height}
        if self.table.sole is not None:
            up = [0.0, 0.0, 1.0]
            found |= {"axis": (self.places[name].rotation.T @ up).tolist(), "direction": up}
        return FrameGoalTable(**found)


def check_foot(key: str, name: str, ground: GroundTable) -> None:
    """Refuse a foot that the ground does not name.

    Raises
    ------
    ProblemError
    """
    if name not in ground.feet:
        raise ProblemError(f"{key}: no foot {name!r}; [ground] has {', '.join(map(repr, ground.feet))}")


def _with_frames(via: Sequence[ViaTable], at_end: list[FrameGoalTable]) -> list[ViaTable]:
    """Via points of a phase with frames at its end: in the one that is there, or in one more."""
    if not at_end:
        return list(via)
    there = [k for k, point in enumerate(via) if point.share in (None, 1.0)]
    if not there:
        return [*via, ViaTable(frame=at_end)]
    k = there[0]
    return [*via[:k], via[k].model_copy(update={"frame": [*via[k].frame, *at_end]}), *via[k + 1 :]]
