"""Inequalities and equations that frames of the robot keep along the motion, or a part of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from typing import Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass, frozen_array
from mbocp._tolerances import BOUND_TOLERANCE
from mbocp.exceptions import DimensionMismatch, InvalidValue, ProblemError
from mbocp.problem._checks import check_choice, check_finite
from mbocp.problem.goals.goal import Goal
from mbocp.problem.timeline.timeline import Timeline
from mbocp.robot import Label, Robot
from mbocp.robot.kinematics import WORLD
from mbocp.terms.bounded import BoundedTerm, MotionAtNodes
from mbocp.terms.coordinate_rows import CoordinateRows
from mbocp.terms.kinds import PATH_TERMS, Follow
from mbocp.terms.path_term import PathTerm
from mbocp.terms.span import NodePlace, Span

PATH_KINDS: tuple[str, ...] = tuple(PATH_TERMS)


@dataclass(frozen=True, kw_only=True, eq=False)
class PathConstraint(BoundedTerm):
    r"""Bounds on where a frame is, how far from something, or how fast; equal ones make it an equation.

    .. math:: \underline{h} \le h(q_n, v_n) \le \overline{h}, \qquad n = 1, \ldots, N

    or at the nodes of a part of the horizon; with, for the origin p(q) of `frame` in the axes of the world:

    - ``position``: the coordinates `axes` of p;
    - ``distance``: :math:`|p - p_b|` from the origin of the frame `other`, or from `point`;
    - ``speed``: :math:`|\dot p|`;
    - ``angular_speed``: :math:`|\omega|`;
    - ``velocity``, ``frame_acceleration``: components `axes` of these, along the axes of the frame;
    - ``centre_of_mass``, ``angular_momentum``: coordinates `axes` of the centre of mass of the robot, and of
      the angular momentum about it.

    Attributes
    ----------
    name : str
        What it is called in messages, results and plots.
    kind : str
        One of `mbocp.terms.kinds.PATH_TERMS`.
    frame : int
        Index of the frame.
    other : int, optional
        Index of the other frame of a distance.
    point : ndarray, shape (3,)
        In the world; of a distance without `other` [m].
    axes : tuple of int
        Rows of a position: 0, 1, 2 for x, y, z.
    lower, upper : ndarray, shape (rows,)
        [m] or [m/s]; infinite where there is none.
    further : mapping of str to ndarray
        Parameters of other kinds by name.
    profile : str, optional
        Name of the profile that it is of.
    span : Span
        When it holds: at all nodes 1..N, or at those of a part of the horizon.
    """

    name: str
    kind: str
    frame: int
    other: int | None = None
    point: Array = field(default_factory=lambda: frozen_array(np.zeros(3)))
    axes: tuple[int, ...] = ()
    lower: Array
    upper: Array
    further: Mapping[str, Any] = field(default_factory=dict)
    profile: str | None = None
    span: Span = field(default_factory=Span)

    def __post_init__(self) -> None:
        key = f"path {self.name!r}"
        check_choice(f"{key}: kind", self.kind, PATH_KINDS)
        object.__setattr__(self, "point", frozen_array(self.point, shape=(3,), name=f"{key}: point"))
        check_finite(f"{key}: point", self.point)
        if self.axes and not issubclass(PATH_TERMS[self.kind], CoordinateRows):
            raise ProblemError(f"{key}: axes belong to a position, got kind {self.kind!r}")
        rows = self.term.rows
        if not rows:
            raise ProblemError(f"{key}: bounds nothing; give x, y or z as [lower, upper]")
        object.__setattr__(self, "further", self._parameters(key))
        for side in ("lower", "upper"):
            value = frozen_array(getattr(self, side), shape=(rows,), name=f"{key}: {side}")
            object.__setattr__(self, side, value)
        for lo, hi in zip(self.lower, self.upper, strict=True):
            if not lo <= hi or not (np.isfinite(lo) or np.isfinite(hi)):
                expected = "a finite bound, the lower not above the upper"
                raise InvalidValue(key, [float(lo), float(hi)], expected)
        self.span.check(key)
        PATH_TERMS[self.kind].check(self, key)

    @property
    def rows(self) -> int:
        """Number of inequalities."""
        return len(self.lower)

    @property
    def size(self) -> float:
        """Of what its equations are errors from, in units of its own; 0 where bounds say all."""
        return self.term.size_of_errors

    @property
    def term(self) -> PathTerm:
        """Its structure, with its expression."""
        return PATH_TERMS[self.kind].of(self)

    @property
    def labels(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        return PATH_TERMS[self.kind].labels(self)

    @property
    def inner_bounds(self) -> tuple[Array, Array]:
        """Bounds of the expression, shapes (rows,): of squares for lengths and speeds."""
        return self.term.inner((np.asarray(self.lower), np.asarray(self.upper)))

    @property
    def numbers(self) -> dict[str, Array]:
        """Parameters of the expression by name."""
        return {name: self.number(name) for name in self.term.sizes}

    def number(self, key: str) -> Array:
        """Value of one of its parameters."""
        return self.point if key == "point" else self.further[key]

    def slopes(self, values: Array) -> Array:
        """Derivatives of the expression in the values."""
        return self.term.slope(values)

    def progress(self, robot: Robot, qs: Array) -> Array:
        """How far a frame that follows a path is along it at the nodes of a motion, shape (n,), from 0 to 1.

        Raises
        ------
        ProblemError
            If the constraint is of another kind.
        """
        term = self.term
        if not isinstance(term, Follow):
            raise ProblemError(f'path {self.name!r}: progress is for kind = "follow", got "{self.kind}"')
        return term.progress(self, robot, qs)

    def values_on_path(self, robot: Robot, qs: Array, vs: Array, progress: Array) -> Array:
        """Values where the progress along the path is known, shape (n,), as of `values_along`."""
        s = ca.SX.sym("s")
        function = self.function(robot, {"progress": s}, s).map(len(qs))
        return self.value(np.asarray(function(qs.T, vs.T, progress[None])).T)

    def values_along(
        self, robot: Robot, qs: Array, vs: Array, us: Array, accelerations: Array | None = None
    ) -> Array:
        """Values at each of n states, shape (n, rows) [m, m/s]; where they are along a path is found."""
        if self.follows:
            return self.values_on_path(robot, qs, vs, self.progress(robot, qs))
        return super().values_along(robot, qs, vs, us, accelerations)

    def values_in_motion(self, robot: Robot, nodes: MotionAtNodes) -> Array:
        """Values with the progress along a path that the motion has."""
        if self.follows:
            return self.values_on_path(robot, *nodes.states[:2], nodes.progress[self.name])
        return super().values_in_motion(robot, nodes)

    @property
    def follows(self) -> bool:
        """Whether it follows a path."""
        return "progress" in self.term.remembers

    def value(self, h: Array) -> Array:
        """Values of those of the expression."""
        return self.term.value(h)

    def nodes(self, num_steps: int, dt: float) -> BoolArray:
        """Those of the span; some rows hold at its end alone."""
        found = super().nodes(num_steps, dt)
        found[: np.flatnonzero(found[:, 0])[-1], list(self.term.rows_at_end)] = False
        return found

    def at_via(self, places: Mapping[str, NodePlace]) -> PathConstraint:
        """The same between nodes."""
        if not self.span.via_names:
            return self
        return replace(self, span=self.span.at_via(places, f"path {self.name!r}"))

    def _parameters(self, key: str) -> dict[str, Array]:
        """Parameters of the kind that are no fields, checked."""
        wanted = {name: size for name, size in self.term.sizes.items() if name != "point"}
        if set(self.further) != set(wanted):
            raise ProblemError(
                f"{key}: further: got {', '.join(self.further) or 'nothing'}, expected "
                f'{", ".join(wanted) or "nothing"} for kind = "{self.kind}"'
            )
        found = {}
        for name, size in wanted.items():
            found[name] = frozen_array(self.further[name], shape=(size,), name=f"{key}: {name}")
            check_finite(f"{key}: {name}", found[name])
        return found

    def check_frames(self, robot: Robot) -> None:
        """Refuse frames that `robot` does not have."""
        for index in (self.frame, *((self.other,) if self.other is not None else ())):
            if not 0 <= index < len(robot.frame_names):
                raise DimensionMismatch(f"path {self.name!r}: frame {index}", index, len(robot.frame_names))


def check_path(
    robot: Robot, path: Sequence[BoundedTerm], q_start: Array, v_start: Array, goal: Goal, timeline: Timeline
) -> None:
    """Refuse constraints that exclude the start, or an exact goal that says enough to tell.

    Each has to hold somewhere in the horizon.
    """
    num_steps, dt, num_lengths = timeline.num_steps, timeline.dt, timeline.num_lengths
    names = [constraint.name for constraint in path]
    for name in names:
        if names.count(name) > 1:
            raise ProblemError(f"path {name!r}: there are several of this name; give each its own")
    for constraint in path:
        constraint.check_frames(robot)
        constraint.span.check_horizon(f"path {constraint.name!r}", num_steps, dt, num_lengths=num_lengths)
        has_end = constraint.span.has_end(num_steps, dt)
        if isinstance(constraint, PathConstraint) and constraint.follows:
            if constraint.span.nodes(num_steps, dt).sum() + constraint.span.has_start < 2:
                raise ProblemError(
                    f"path {constraint.name!r}: one node between from and until is no time to follow a path; "
                    "take times farther apart"
                )
            _check_ends_of_path(constraint, robot, q_start, goal, has_end)
        elif constraint.is_known_before:  # controls and forces are not
            if constraint.span.has_start:
                _refuse_outside(constraint, constraint.values(robot, q_start, v_start, 0.0), "start")
            if has_end:
                _check_at_goal(constraint, robot, goal, None if num_lengths else num_steps * dt)


def _check_at_goal(constraint: BoundedTerm, robot: Robot, goal: Goal, at: float | None) -> None:
    """Refuse a constraint that an exact goal violates, if it says enough to tell; `at` is its time [s]."""
    has_v = goal.rate_active.all()
    if not (goal.is_exact and goal.q_active.all() and (has_v or not constraint.term.has_velocity)):
        return
    v = np.zeros(robot.nv)
    if constraint.term.has_velocity:
        v = goal.value if goal.rate == "v" else robot.velocity_from_momentum(goal.q, goal.value)
    _refuse_outside(constraint, constraint.values(robot, goal.q, v, at), "goal")


def _check_ends_of_path(
    constraint: PathConstraint, robot: Robot, q_start: Array, goal: Goal, has_end: bool
) -> None:
    """Refuse a path that does not begin where the frame is, or ends elsewhere than at an exact goal."""
    still = np.zeros((1, robot.nv))
    rows = slice(0, constraint.rows - 1)  # the last is at the end alone
    if constraint.span.has_start:
        values = constraint.values_on_path(robot, q_start[None], still, np.zeros(1))[0]
        _refuse_outside(constraint, values, "start", rows)
    if not (has_end and goal.is_exact):
        return
    for target in (frame.target for frame in goal.conditions):
        is_ours = target.relative_to == WORLD and robot.frame_id(target.name) == constraint.frame
        if is_ours and target.position is not None and len(target.coordinates) == 3:
            Follow.check_goal(constraint, target.position, f"path {constraint.name!r}")
    if goal.q_active.all():
        values = constraint.values_on_path(robot, goal.q[None], still, np.ones(1))[0]
        _refuse_outside(constraint, values, "goal", rows)


def _refuse_outside(constraint: BoundedTerm, values: Array, where: str, rows: slice = slice(None)) -> None:
    outside = (values < constraint.lower - BOUND_TOLERANCE) | (values > constraint.upper + BOUND_TOLERANCE)
    if outside[rows].any():
        raise ProblemError(constraint.refusal(values, where))
