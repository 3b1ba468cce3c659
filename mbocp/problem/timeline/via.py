"""Via points: states, or poses of frames, that the motion goes through on its way.

As a path constraint a via point holds at one node.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass, frozen_array, independent_rows, largest_entry
from mbocp._quantities import is_number
from mbocp._text import show
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.lie import ConfigurationSpace
from mbocp.mechanisms.consistent_states import span_allowed_velocities, tangent_space
from mbocp.problem.goals.frames import pose_jacobian, rate_jacobian
from mbocp.problem.goals.goal import Goal
from mbocp.problem.timeline.times import FreeTime, InPhase
from mbocp.robot import Label, Robot
from mbocp.terms.bounded import BoundedTerm
from mbocp.terms.frame_end import FrameShape
from mbocp.terms.frame_goal import FrameGoal
from mbocp.terms.span import Span
from mbocp.terms.via_term import ViaFrameShape, ViaTerm


@dataclass(frozen=True, kw_only=True, eq=False)
class ViaPoint:
    """What holds at one node between the start and the end.

    Attributes
    ----------
    name : str
        What it is called in messages, results and plots.
    goal : Goal
        What is asked of joints and frames there, by the words of a goal: exact, and velocities, no momenta.
        Entries of `q` that are not active hold a configuration that is there.
    time : float, FreeTime or InPhase, optional
        When it holds [s]; or that the solver finds it, and between which bounds; or in which phase.
    share : float, optional
        In place of a time that is given: part of the horizon that is over by then, between 0 and 1. Beside
        one that is free: part of the steps that lead there.
    """

    name: str
    goal: Goal
    time: float | FreeTime | InPhase | None = None
    share: float | None = None

    def __post_init__(self) -> None:
        key = f"via {self.name!r}"
        _check_goal(key, self.goal)
        given: float | None = None
        if isinstance(self.time, (FreeTime, InPhase)):
            self.time.check(key)
        else:
            given = self.time
        if isinstance(self.time, InPhase) and self.share is not None:
            raise ProblemError(
                f"{key}: share is one of the horizon; give time = {{ phase = {self.time.name!r}, "
                "share = number }"
            )
        if given is not None and self.share is not None:
            raise ProblemError(f"{key}: give time or share, not both; a share is beside a time that is free")
        _check_between(f"{key}: time", given, np.inf, "a time after the start [s]")
        _check_between(f"{key}: share", self.share, 1.0, "a part of the horizon, 0 < share < 1")

    @property
    def is_free(self) -> bool:
        """Whether its time is found with the motion."""
        return isinstance(self.time, FreeTime)


@dataclass(frozen=True, eq=False)
class ViaConstraint(BoundedTerm):
    """A via point among the path constraints of a problem, see `mbocp.problem.PathConstraint`.

    Attributes
    ----------
    via : ViaPoint
        Its goal holds a configuration that is there.
    robot : Robot
    node : int
        Where it holds.
    """

    via: ViaPoint
    robot: Robot
    node: int

    @property
    def name(self) -> str:
        """What it is called."""
        return self.via.name

    @property
    def span(self) -> Span:
        """When it holds."""
        return Span.at_node(self.node)

    @cached_property
    def _shapes(self) -> tuple[ViaFrameShape, ...]:
        return tuple(
            ViaFrameShape(
                FrameShape.of(frame, self.robot),
                has_box=frame.position_tolerance is not None,
                has_cone=frame.orientation_tolerance is not None,
            )
            for frame in self.via.goal.frames
        )

    @cached_property
    def _projections(self) -> tuple[Array, Array]:
        """Independent combinations of the equations on configuration and velocity."""
        robot, goal = self.robot, self.via.goal
        active, rates = goal.q_active.any(), goal.rate_active.any()
        poses = [np.diag(goal.q_active.astype(float))] * bool(active)
        poses.append(pose_jacobian(robot, goal))
        velocities = [np.diag(goal.rate_active.astype(float))] * bool(rates)
        velocities.append(rate_jacobian(robot, goal))
        return (
            independent_rows(np.vstack(poses) @ tangent_space(robot, goal.q), RANK_TOLERANCE),
            independent_rows(np.vstack(velocities) @ span_allowed_velocities(robot, goal.q), RANK_TOLERANCE),
        )

    @cached_property
    def _exact(self) -> BoolArray:
        """Which rows of all poses are equations."""
        found: list[bool] = []
        for shape in self._shapes:
            coordinates = len(shape.shape.coordinates)
            found += [not shape.has_box] * coordinates
            found += [not shape.has_cone] * (shape.shape.pose_rows - coordinates)
        return np.array(found, dtype=np.bool_)

    @property
    def num_equations(self) -> int:
        """Number of equations."""
        return sum(len(D) for D in self._projections)

    @property
    def size(self) -> float:
        """The largest velocity that is asked for [m/s, rad/s]."""
        goal = self.via.goal
        rates = [np.asarray(goal.value)[goal.rate_active], *(frame.rates for frame in goal.frames)]
        return float(np.abs(np.concatenate(rates)).max(initial=0.0))

    @property
    def term(self) -> ViaTerm:
        """Its structure, with its expression."""
        return self.structure("quaternion")

    def structure(self, rotations: str) -> ViaTerm:
        """The same with attitudes in these coordinates."""
        goal, space = self.via.goal, ConfigurationSpace(self.robot.model, rotations)
        D_pose, D_rate = self._projections
        return ViaTerm(
            frames=self._shapes,
            has_q=bool(goal.q_active.any()),
            has_v=bool(goal.rate_active.any()),
            nq=space.nz,
            nv=self.robot.nv,
            guarded=self._guarded_parts,
            num_pose=len(D_pose),
            num_rate=len(D_rate),
        )

    @cached_property
    def _guarded_parts(self) -> tuple[int, ...]:
        parts, active = ConfigurationSpace(self.robot.model).parts, self.via.goal.q_active
        return tuple(i for i, p in enumerate(parts) if not p.group.is_vector and active[p.at_v].all())

    def numbers_in(self, rotations: str) -> dict[str, Array]:
        """Parameters by name with attitudes in these coordinates."""
        goal, (D_pose, D_rate) = self.via.goal, self._projections
        space = ConfigurationSpace(self.robot.model, rotations)
        found = {
            "q": space.coordinates(np.asarray(goal.q)[None])[0],
            "v": np.asarray(goal.value),
            "D_pose": D_pose.ravel(order="F"),
            "D_rate": D_rate.ravel(order="F"),
        }
        for k, frame in enumerate(goal.frames):
            found |= {f"{k}.{name}": value for name, value in FrameShape.numbers(frame).items()}
        return {name: found[name] for name in self.structure(rotations).sizes}

    @cached_property
    def labels(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        found = [*self._labels_of_equations(), *self._labels_of_bounds()]
        words = [f"{self.name}: {label.name}" for label in found]
        return tuple(
            Label(word if words.count(word) == 1 else f"{word} ({words[: i + 1].count(word)})", label.unit)
            for i, (word, label) in enumerate(zip(words, found, strict=True))
        )

    def _labels_of_equations(self) -> Iterator[Label]:
        """Each is called after the row that weighs most in it."""
        goal, speeds = self.via.goal, self.robot.v_labels
        poses = list(self.robot.move_labels) * bool(goal.q_active.any()) + self._pose_labels(are_exact=True)
        rates = [Label(f"rate of {x.name}", x.unit) for x in speeds] * bool(goal.rate_active.any())
        rates += [Label(name, "m/s, rad/s") for frame in goal.frames for name in frame.rate_labels]
        for D, names in zip(self._projections, (poses, rates), strict=True):
            yield from (names[largest_entry(row)] for row in D)

    def _labels_of_bounds(self) -> Iterator[Label]:
        """Coordinates in boxes, sides of attitudes, and angles in cones."""
        yield from (label for label in self._pose_labels(are_exact=False) if label.unit == "m")
        yield from (Label(f"side {i}", "") for i in self._guarded_parts)
        for frame, shape in zip(self.via.goal.frames, self._shapes, strict=True):
            if shape.shape.turn:
                yield Label(f"angle of {frame.name}", "rad")

    def _pose_labels(self, *, are_exact: bool) -> list[Label]:
        labels = [label for frame in self.via.goal.frames for label in _labels_of_pose(frame)]
        return [label for label, is_exact in zip(labels, self._exact, strict=True) if is_exact == are_exact]

    @cached_property
    def _bounds(self) -> tuple[Array, Array]:
        """Bounds of the values that people speak of."""
        count = self.num_equations
        boxes, angles = [np.zeros(0)], []
        for frame, shape in zip(self.via.goal.frames, self._shapes, strict=True):
            if frame.position_tolerance is not None:
                boxes.append(frame.position_tolerance[frame.target.coordinates])
            if shape.shape.turn:
                cone = frame.orientation_tolerance
                angles.append(np.pi / 2 if cone is None else cone)
        box, sides = np.concatenate(boxes), np.zeros(len(self._guarded_parts))
        lower = np.concatenate([np.zeros(count), -box, sides, np.full(len(angles), -np.inf)])
        upper = np.concatenate([np.zeros(count), box, np.full(len(sides), np.inf), angles])
        return frozen_array(lower), frozen_array(upper)

    @property
    def lower(self) -> Array:
        """Lower bounds, shape (rows,)."""
        return self._bounds[0]

    @property
    def upper(self) -> Array:
        """Upper bounds, shape (rows,)."""
        return self._bounds[1]

    @property
    def inner_bounds(self) -> tuple[Array, Array]:
        """Bounds of the expression: of cosines for angles."""
        lower, upper = (np.array(side) for side in self._bounds)
        first = self.rows - self.term.num_angles
        lower[first:], upper[first:] = np.cos(upper[first:]), np.inf
        return lower, upper

    def value(self, h: Array) -> Array:
        """Angles of their cosines."""
        found, first = np.array(h), self.rows - self.term.num_angles
        found[:, first:] = np.arccos(np.clip(found[:, first:], -1.0, 1.0))
        return found

    def slopes(self, values: Array) -> Array:
        """Derivatives of the expression in the values."""
        found, first = np.ones_like(values), self.rows - self.term.num_angles
        found[..., first:] = -np.sin(values[..., first:])
        return found


def _check_goal(key: str, goal: Goal) -> None:
    if goal.enforce != "exact" or goal.rate != "v":
        raise ProblemError(f"{key}: takes q, v and frame; no momentum, and no weight instead of it")
    if goal.a_active.any():
        raise ProblemError(f"{key}: a is for the goal; a via point takes q, v and frame")
    for frame in goal.frames:
        if frame.weight != 1.0:
            raise ProblemError(f"{key}: weight of {frame.name!r}: is for goal.frame; a via point is no cost")


def _check_between(key: str, value: float | None, largest: float, expected: str) -> None:
    if value is not None and not (is_number(value) and 0.0 < value < largest):
        raise InvalidValue(key, show(value), expected)


def _labels_of_pose(frame: FrameGoal) -> list[Label]:
    units = ["m"] * frame.target.coordinates.size
    names = frame.pose_labels
    return [Label(n, u) for n, u in zip(names, units + ["rad"] * (len(names) - len(units)), strict=True)]
