"""A problem as bounds see it: what is known of joints at both ends and in windows of time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.bounds.intervals import Box
from mbocp.bounds.momenta import gravity_by_lines, momenta_over, why_no_momenta
from mbocp.bounds.speeds import Forces, Speeds, speeds_after
from mbocp.problem import Goal, Problem
from mbocp.robot.joints import displacement, joint_kind

SIGNED = ("potential", "fuel", "energy")  # terms of the cost that may be negative


@dataclass(frozen=True, eq=False)
class Displacements:
    """Displacements [rad, m] and rates of joints of one velocity, by velocity component; NaN: not known."""

    q: Array
    v: Array


@dataclass(frozen=True, eq=False)
class BoundTask:
    """A problem with one goal.

    Attributes
    ----------
    problem : Problem
    places : tuple of Displacements
        The start, via points, the goal.
    circles : ndarray of bool, shape (nv,)
        Which are angles that may go round.
    reached : float
        A cost that some motion has; NaN where none is known.
    """

    problem: Problem
    places: tuple[Displacements, ...]
    circles: BoolArray
    reached: float

    @classmethod
    def of(cls, problem: Problem, reached: float = math.nan) -> BoundTask:
        """Read what is known."""
        model, nv = problem.robot.model, problem.robot.nv
        circles = np.zeros(nv, dtype=np.bool_)
        for joint in range(1, model.njoints):
            if joint_kind(model, joint).word == "continuous":
                circles[model.joints[joint].idx_v] = True
        return cls(problem, tuple(_places(problem)), circles, reached)

    @property
    def why_none(self) -> str:
        """Why nothing is bounded; "" where something may be."""
        if self.problem.start_free is not None:
            return "the start is found with the motion"
        if self.problem.timeline.switches is not None:
            return "holds and impacts are not looked at"
        if not all(drive.has_state for drive in self.problem.robot.drives):
            return "controls that prescribe velocities are not looked at"
        return ""

    @property
    def why_no_cost(self) -> str:
        """Why the cost has no bound, but for what `why_none` says."""
        signed = [key for key in SIGNED if np.any(self.problem.cost.weight(key))]
        signed += [term.name for term in self.problem.terms if term.role in ("running", "terminal")]
        return f"the cost may be negative by {', '.join(signed)}" if signed else ""

    @property
    def moves(self) -> Array:
        """How far joints are from the goal at the start, angles that may go round the shortest way."""
        return self.between(self.places[0].q, self.places[-1].q)

    @property
    def ways(self) -> Array:
        """How far joints go from place to place at least; where one is not known, to the next that is."""
        found, last = np.zeros(self.problem.robot.nv), self.places[0].q
        for place in self.places[1:]:
            found += np.abs(np.nan_to_num(self.between(last, place.q)))
            last = np.where(np.isnan(place.q), last, place.q)
        return found

    def between(self, begin: Array, end: Array) -> Array:
        """How far joints go from one place to another, angles that may go round the shortest way."""
        away = end - begin
        return np.where(self.circles, (away + np.pi) % (2.0 * np.pi) - np.pi, away)

    def lightest(self, key: str, size: int) -> Array:
        """Weights of a term of the cost, the least of all phases."""
        cost = self.problem.cost
        each = [cost.with_weights(phase.weights).weight(key) for phase in self.problem.timeline.phases]
        return np.min([np.broadcast_to(weights, size) for weights in each], axis=0)

    def motors(self) -> Iterator[tuple[int, int, float]]:
        """Control, velocity component that it acts on, and by what factor."""
        for u, column in enumerate(np.asarray(self.problem.robot.actuation.selection).T):
            at = int(np.flatnonzero(column)[0])
            yield u, at, float(column[at])

    @property
    def why_no_forces(self) -> str:
        """Why forces say nothing of the motion; "" where they may."""
        robot = self.problem.robot
        if self.problem.parameter:
            return "numbers of the robot are found"
        if robot.nc:
            return "constraints close loops"
        selection = np.asarray(robot.actuation.selection) != 0.0
        if robot.forces or robot.elastic or robot.actuation.frame_actuators:
            return "springs or forces at frames act"
        if robot.drives:
            return "controls are accelerations"
        if not ((selection.sum(axis=0) == 1).all() and (selection.sum(axis=1) <= 1).all()):
            return "controls act on several joints"
        return why_no_momenta(robot)

    def forces(self) -> Forces:
        """What moves the joints, where `why_no_forces` says nothing."""
        robot, limits = self.problem.robot, self.problem.widest_limits
        low, high, damping, friction = np.zeros((4, robot.nv))
        squares, weights = np.zeros(robot.nv), self.lightest("effort", robot.nu)
        is_known = not (math.isnan(self.reached) or self.why_no_cost)
        for u, at, factor in self.motors():
            low[at], high[at] = np.sort(factor * np.array([limits.u_lower[u], limits.u_upper[u]]))
            is_bounded = is_known and weights[u] > 0.0
            squares[at] = 2.0 * self.reached / weights[u] * factor**2 if is_bounded else np.inf
        for loss in robot.resistances:
            damping[loss.dof] += loss.ratio**2 * loss.damping
            friction[loss.dof] += abs(loss.ratio) * loss.friction
        return Forces(robot, low, high, damping, friction, squares)

    def speeds(self, edges: Array) -> tuple[Speeds, Speeds]:
        """Bounds of velocities after the start, and of those before the goal, which are those backwards."""
        limits, start, goal = self.problem.widest_limits, self.places[0], self.places[-1]
        forces = None if self.why_no_forces else self.forces()
        v, a = (limits.v_lower, limits.v_upper), (limits.a_lower, limits.a_upper)
        after = speeds_after(edges, start.q, start.v, v, a, forces)
        before = speeds_after(edges, start.q + self.moves, -goal.v, (-v[1], -v[0]), a, forces)
        return after, before


def _places(problem: Problem) -> Iterator[Displacements]:
    every = np.ones(problem.robot.nv, dtype=np.bool_)
    yield Displacements(_displacements(problem, problem.q_start, every), np.array(problem.v_start))
    for point in problem.timeline.waypoints:
        yield _of_goal(problem, point.via.goal)
    yield _of_goal(problem, problem.goal)


def _of_goal(problem: Problem, goal: Goal) -> Displacements:
    nothing = np.full(problem.robot.nv, np.nan)
    if not goal.is_exact or goal.periodic is not None:
        return Displacements(nothing, nothing)
    is_rate = goal.rate == "v" or (goal.rate_active.all() and not goal.value.any())
    rate = np.where(goal.rate_active & is_rate, goal.value, np.nan)
    return Displacements(_displacements(problem, goal.q, goal.q_active), rate)


def _displacements(problem: Problem, q: Array, known: BoolArray) -> Array:
    model = problem.robot.model
    found = np.full(model.nv, np.nan)
    for joint in range(1, model.njoints):
        entry = model.joints[joint]
        if entry.nv == 1 and known[entry.idx_v]:
            found[entry.idx_v] = displacement(model, joint, np.array(q))
    return found


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


def windows_of(task: BoundTask) -> Windows | None:
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
    w = replace(moment, gravity=rest).enclose_opposing(v) + Box(np.zeros_like(losses), losses)
    momenta = [
        _momentum(task, Displacements(q, place.v), (moment.M[[k]], v[[k]]))
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


def _within_positions(task: BoundTask, low: Array, high: Array) -> tuple[Array, Array]:
    """Leave out what limits of positions exclude."""
    limits = task.problem.widest_limits
    for joint in task.problem.robot.model.joints[1:]:
        if joint.nq == 1:
            low[:, joint.idx_v] = np.fmax(low[:, joint.idx_v], limits.q_lower[joint.idx_q])
            high[:, joint.idx_v] = np.fmin(high[:, joint.idx_v], limits.q_upper[joint.idx_q])
    return low, high


def _momentum(task: BoundTask, state: Displacements, around: tuple[Box, Box]) -> Box:
    """Momentum in a state; where that is not known, within the boxes around it."""
    M, v = around
    if np.isfinite(state.v).all():
        v = Box.of(state.v[None], state.v[None])
        if np.isfinite(state.q).all():
            M = momenta_over(task.problem.robot, Box.of(state.q[None], state.q[None])).M
    return (M @ Box(v.centre[..., None], v.radius[..., None]))[0, :, 0]
