"""What is known of a motion of a given time: boxes of states and inertias in windows of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.bounds.intervals import Box
from mbocp.bounds.momenta import gravity_by_lines, momenta_over
from mbocp.bounds.task import Place, Task

_COUNT = 32


@dataclass(frozen=True, eq=False)
class Windows:
    """What is known of a motion in K windows of time that are as long as each other.

    Attributes
    ----------
    length : float
        Of each window [s].
    M : Box, shape (K, n, n)
        Mass matrix.
    w, G : Box and ndarray, shape (K, n), (K, n, n)
        G q + w opposes forces, losses included.
    v : Box, shape (K, n)
        Velocities.
    q, inside : Box, shape (K + 1, n) and (K, n)
        Displacements where windows begin and at the end, and in each.
    ends : tuple of Box, shape (n,)
        Momenta at the start and at the end.
    """

    length: float
    M: Box
    w: Box
    G: Array
    v: Box
    q: Box
    inside: Box
    ends: tuple[Box, Box]


def windows_of(task: Task) -> Windows | None:
    """Enclose all motions of a task in its given duration; None where nothing bounds their speeds."""
    robot, T = task.problem.robot, task.problem.duration
    after, before = task.speeds(np.linspace(0.0, T, _COUNT + 1))
    start, goal = task.places[0].q, task.places[0].q + task.moves
    # An angle that may go round has one way to the goal where all others are too far.
    down, up = after.moves()
    is_one = ~task.circles | (np.maximum(-down[-1], up[-1]) + np.abs(task.moves) < 2.0 * np.pi)
    goal = np.where(is_one, goal, np.nan)
    low, high = after.tube(start)
    ends = [side[::-1] for side in before.tube(goal)]
    low, high = _within_positions(task, np.fmax(low, ends[0]), np.fmin(high, ends[1]))
    v_low, v_high = np.fmax(after.lower, -before.upper[::-1]), np.fmin(after.upper, -before.lower[::-1])
    if not (np.isfinite(v_low) & np.isfinite(v_high)).all():
        return None
    # Where no motion is that fast, boxes are empty, and any do.
    inside = Box.of(low, np.maximum(low, high))
    moment = momenta_over(robot, inside)
    G, rest = gravity_by_lines(robot, inside, moment.gravity)
    v = Box.of(v_low, np.maximum(v_low, v_high))
    losses = task.forces().losses(v.size)
    w = replace(moment, gravity=rest).opposing(v) + Box(np.zeros_like(losses), losses)
    momenta = [
        _momentum(task, Place(q, place.v), (moment.M[[k]], v[[k]]))
        for q, place, k in ((start, task.places[0], 0), (goal, task.places[-1], -1))
    ]
    at_edges = [
        np.vstack([side[:1], pick(side[1:], side[:-1]), side[-1:]])
        for side, pick in ((low, np.fmax), (high, np.fmin))
    ]
    for k, known in ((0, start), (-1, goal)):
        at_edges[0][k], at_edges[1][k] = (np.where(np.isnan(known), side[k], known) for side in at_edges)
    q = Box.of(at_edges[0], np.maximum(*at_edges))
    return Windows(T / _COUNT, moment.M, w, G, v, q, inside, (momenta[0], momenta[1]))


def _within_positions(task: Task, low: Array, high: Array) -> tuple[Array, Array]:
    """Leave out what limits of positions exclude."""
    limits = task.problem.widest_limits
    for joint in task.problem.robot.model.joints[1:]:
        if joint.nq == 1:
            low[:, joint.idx_v] = np.fmax(low[:, joint.idx_v], limits.q_lower[joint.idx_q])
            high[:, joint.idx_v] = np.fmin(high[:, joint.idx_v], limits.q_upper[joint.idx_q])
    return low, high


def _momentum(task: Task, state: Place, around: tuple[Box, Box]) -> Box:
    """Momentum in a state; where that is not known, within the boxes around it."""
    M, v = around
    if np.isfinite(state.v).all():
        v = Box.of(state.v[None], state.v[None])
        if np.isfinite(state.q).all():
            M = momenta_over(task.problem.robot, Box.of(state.q[None], state.q[None])).M
    return (M @ Box(v.centre[..., None], v.radius[..., None]))[0, :, 0]
