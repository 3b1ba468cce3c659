"""Forces of constraints and holds along a motion, as arrows of a replay and lines of a figure have them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.exceptions import MbocpError
from mbocp.robot import Constraint, Robot
from mbocp.solution import Solution


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
    for constraint, model in (*((one, robot.model) for one in robot.constraints), *_held(solution)):
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


def _held(solution: Solution) -> list[tuple[Constraint, pin.Model]]:
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
