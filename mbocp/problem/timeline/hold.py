r"""Holds: constraints between frames that are taken on and let go along the horizon.

A hold has spans of steps ``[first, last)``, counted from 0, in which it acts, and what happens where one
begins follows from the step it begins with:

- an *impact*, a step of no duration named by `Problem.impacts`: velocities leap, inelastically. All holds
  and loops that act in that step take part, and the others are free;
- any other step: a soft landing. At the node where the span begins the motion has the velocity that the hold
  allows, as an equation;
- step 0: the start has to fit, and is refused otherwise.

Where one ends before the horizon does, the last step of its span should be one of no duration, too, named by
`Problem.impacts`: a *parting*, in which velocities become those that all that is held allows. Without, the
scheme's own errors in velocities go along with what is let go. Phases have it by themselves.

So a foot that lands at step 20 with an impact has the span (20, 40) and 20 is one of the impacts: steps 0 to
19 take time, step 20 takes none, steps 21 to 39 take time again. Steps of the robot's own constraints in
which they do not act are a `Release`.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple

from mbocp._arrays import dataclass
from mbocp._text import show
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.mechanics.held_frames import HeldFrame
from mbocp.problem._checks import check_choice
from mbocp.robot import Robot
from mbocp.robot.kinematics import WORLD
from mbocp.robot.loops.constraints import HOLDS
from mbocp.robot.loops.kinds.constraint import Axis, FrameConstraint

Spans = tuple[tuple[int, int], ...]

_PLACES = ("where_it_is", "coincide")


@dataclass(frozen=True, kw_only=True)
class FreeContact:
    """A level ground that pushes a frame where it stands, and that the frame may leave at any time.

    Attributes
    ----------
    height : float
        Of the ground [m].
    smoothing : float
        Most of the products that are to be zero, see `mbocp.terms.free_contact`.
    """

    height: float
    smoothing: float


@dataclass(frozen=True, kw_only=True)
class Hold:
    """A frame is held at another one, or in the world, in some of the steps.

    Attributes
    ----------
    name : str
        What it is called; rows of multipliers are ``name.x`` and so on.
    frame, to : str
        The frame that is held, and the one that holds it; "world" for the ground.
    kind : {"weld", "point", "hinge", "plane", "line", "screw"}
        What of the frame is held: all of it, its origin, its origin and an axis, its origin in a plane or on
        a line, what does not go along a thread; see `mbocp.robot.loops.constraints.HOLDS`.
    at : {"where_it_is", "coincide"}
        Held where it is when a span begins, relative to `to`; or with both frames in one place, as loops of a
        robot are closed.
    axis : (float, float, float)
        Of a hinge or screw in the axes of `frame`; normal of a plane and direction of a line in those of
        `to`.
    pitch : float, optional
        Of a screw: how far the frame slides in a turn [m].
    spans : tuple of (int, int)
        Steps ``[first, last)`` in which it holds, one after the other.
    free : FreeContact, optional
        Where its force is found in all steps, and it never holds.
    """

    name: str
    frame: str
    to: str = WORLD
    kind: str = "weld"
    at: Literal["where_it_is", "coincide"] = "where_it_is"
    axis: Axis = (0.0, 0.0, 1.0)
    pitch: float | None = None
    spans: Spans = ()
    free: FreeContact | None = None

    def __post_init__(self) -> None:
        key = f"hold {self.name!r}"
        check_choice(f"{key}: kind", self.kind, tuple(HOLDS))
        if (self.pitch is not None) != ("pitch" in self.keys):
            advice = "has none; leave it out" if self.pitch is not None else "needs one [m]"
            raise ProblemError(f"{key}: pitch: one of kind {self.kind!r} {advice}")
        check_choice(f"{key}: at", self.at, _PLACES)
        object.__setattr__(self, "spans", check_spans(key, self.spans))

    @property
    def is_anchored(self) -> bool:
        """Whether it is held where it is when a span begins."""
        return self.at == "where_it_is"

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the fields that its kind has beside its frames."""
        return tuple(HOLDS[self.kind].hold_keys or ())

    def as_frame(self, robot: Robot) -> HeldFrame:
        """What its equations are written of."""
        return HeldFrame(self.constraint(robot), self.is_anchored)

    def constraint(self, robot: Robot) -> FrameConstraint:
        """The constraint between the frames, of the robot's own kind.

        Raises
        ------
        UnknownFrame
            If the robot has no such frame.
        ProblemError
            If a frame is held at itself.
        """
        a, b = robot.frame_id(self.frame), robot.frame_id(self.to)
        if a == b:
            raise ProblemError(f"hold {self.name!r}: holds frame {self.frame!r} at itself; give another `to`")
        frames = (self.frame, self.to)
        given = {key: getattr(self, key) for key in self.keys}
        return HOLDS[self.kind].for_hold(self.name, (a, b), frames, given)


@dataclass(frozen=True, kw_only=True)
class Release:
    """One of the robot's own constraints does not hold in some of the steps.

    Attributes
    ----------
    constraint : str
        Its name.
    spans : tuple of (int, int)
        Steps ``[first, last)`` in which it is let go.
    """

    constraint: str
    spans: Spans = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "spans", check_spans(f"release {self.constraint!r}", self.spans))


class Schedule(NamedTuple):
    """When constraints act that do not act always, and which steps take no time."""

    holds: tuple[Hold, ...] = ()
    releases: tuple[Release, ...] = ()
    impacts: tuple[int, ...] = ()

    @property
    def is_empty(self) -> bool:
        """Whether what acts is the same in all steps, which all take time."""
        return not any(self)


def check_spans(key: str, spans: Iterable[tuple[int, int]]) -> Spans:
    """Return spans of steps that are not empty and follow each other with steps between them.

    Raises
    ------
    InvalidValue
        If they do not.
    """
    found, before = [], -1
    for span in spans:
        first, last = (int(step) for step in span)
        if not before < first < last:
            expected = "steps [first, last) that rise, with steps between one span and the next"
            raise InvalidValue(f"{key}: spans", show(list(spans)), expected)
        found.append((first, last))
        before = last
    return tuple(found)


def holds_in(spans: Spans, step: int) -> bool:
    """Return whether a step is in one of the spans."""
    return any(first <= step < last for first, last in spans)
