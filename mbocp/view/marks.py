"""What a motion was to go through, for a replay: via points, lines and paths; obstacles, and forces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import MbocpError
from mbocp.robot import Constraint, Robot
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.robot.kinematics import WORLD
from mbocp.solution import Solution

if TYPE_CHECKING:
    from mbocp.problem import Problem
    from mbocp.terms.frame_goal import FrameGoal


@dataclass(frozen=True, eq=False)
class ViaMark:
    """A pose of a frame on the way.

    Attributes
    ----------
    share : float
        Part of the motion's time that is over there.
    goal : FrameGoal
        Pose and tolerances.
    """

    share: float
    goal: FrameGoal


@dataclass(frozen=True, eq=False)
class Marks:
    """All that is drawn.

    Attributes
    ----------
    via : tuple of ViaMark
    lines : tuple of ndarray
        Points of each line and each path that is followed, shape (k, 3) [m].
    obstacles : tuple of Obstacle
    forces : tuple of ForceMark
    """

    via: tuple[ViaMark, ...] = ()
    lines: tuple[Array, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()
    forces: tuple[ForceMark, ...] = ()


def marks_of(problem: Problem) -> Marks:
    """Poses of frames at the via points of a problem, lines and paths of its path constraints, obstacles."""
    at = problem.timeline.times()
    shares = {point.via.name: float(at[point.node] / at[-1]) for point in problem.timeline.waypoints}
    return _marks(problem, shares)


def _marks(problem: Problem, shares: Mapping[str, float]) -> Marks:
    """What is drawn of a problem, with the via points of which it is known when they are passed."""
    via = (
        ViaMark(shares[point.via.name], frame)
        for point in problem.timeline.waypoints
        if point.via.name in shares
        for frame in point.via.goal.poses
    )
    lines = (constraint.term.draw(constraint) for constraint in problem.frame_constraints)
    drawn = tuple(points for points in lines if points is not None)
    return Marks(tuple(via), drawn, problem.obstacle)


def marks_of_result(solution: Solution, robot: Robot) -> Marks:
    """Return the same of a solution's problem, and its forces; frames that `robot` lacks are left out."""
    known, forces = {WORLD, *robot.frame_names}, forces_of(solution, robot)
    asked = solution.shown
    if asked is None:
        return Marks(forces=forces)
    whole = solution.duration or 1.0
    marks = _marks(asked.problem, {name: time / whole for name, time in solution.via_times.items()})
    via = (mark for mark in marks.via if {mark.goal.name, mark.goal.target.relative_to} <= known)
    obstacles = (obstacle for obstacle in asked.obstacles if obstacle.frame in known)
    return replace(marks, via=tuple(via), obstacles=tuple(obstacles), forces=forces)


@dataclass(frozen=True, eq=False)
class ForceMark:
    """The force that one frame exerts on another.

    Attributes
    ----------
    name : str
        Of the constraint.
    frame, other : int
        Frame on whose origin it acts, and the one that exerts it.
    is_along : bool
        Whether it is along the way from `other` to `frame`, its first component alone; otherwise its axes
        are those of `other`.
    t : ndarray, shape (N + 1,)
        Times of the nodes [s].
    forces : ndarray, shape (N, 3)
        In each step [N].
    """

    name: str
    frame: int
    other: int
    is_along: bool
    t: Array
    forces: Array


def forces_of(solution: Solution, robot: Robot) -> tuple[ForceMark, ...]:
    """Forces of all constraints between frames: loops, contacts, and what phases hold.

    Parameters
    ----------
    solution : Solution
    robot : Robot
    """
    columns = {label.name: k for k, label in enumerate(solution.labels.lam)}
    if not columns or not np.isfinite(solution.lams).all():
        return ()
    marks = []
    for constraint, model in (*((one, robot.model) for one in robot.constraints), *_holds_of(solution)):
        rows = [k for k, row in enumerate(constraint.rows) if row.name in columns]
        if not constraint.frame_ids or not rows:
            continue
        try:
            frame, other = (robot.frame_id(model.frames[end].name) for end in constraint.frame_ids)
        except MbocpError:  # shown with another robot
            continue
        lams = solution.lams[:, [columns[constraint.rows[k].name] for k in rows]]
        forces = lams @ constraint.wrench_map[:3, rows].T
        timed, t = in_time(forces, np.diff(solution.t)), solution.t - solution.t[0]
        marks.append(ForceMark(constraint.name, frame, other, constraint.is_pushing, t, timed))
    return tuple(marks)


def _holds_of(solution: Solution) -> list[tuple[Constraint, pin.Model]]:
    """Constraints of what phases hold, with the model that has their frames."""
    shown = solution.shown if solution.facts.held else None
    if shown is None or shown.problem.timeline.switches is None:
        return []
    return [(held.constraint, shown.problem.robot.model) for held in shown.problem.timeline.switches.held]


def in_time(values: Array, dts: Array) -> Array:
    """Values of the steps, those of no duration as before: impulses are no forces.

    Parameters
    ----------
    values : ndarray, shape (N, k)
    dts : ndarray, shape (N,)
        Durations of the steps [s].
    """
    timed = np.flatnonzero(dts > 0.0)
    if not timed.size:
        return values
    before = np.maximum(np.searchsorted(timed, np.arange(len(dts)), side="right") - 1, 0)
    return values[timed[before]]
