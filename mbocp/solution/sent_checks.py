"""What a robot and its surroundings say of a motion as it is sent: torques, path constraints, obstacles.

What follows a motion exactly has to apply these torques; links on springs follow their motors.
Path constraints hold at nodes alone, and are looked at between these, too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TypeAlias

import casadi as ca
import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp._tolerances import BOUND_TOLERANCE, PATH_TOLERANCE_PART, PATH_TOLERANCES
from mbocp.problem import Problem
from mbocp.problem.obstacles.approach import nearest_approach
from mbocp.problem.obstacles.clearance import Clearance
from mbocp.robot.nodes import between
from mbocp.solution.curves import differences
from mbocp.solution.joints_sent import CURVE_PART, EFFORT_RATE, Excess, find_excesses
from mbocp.solution.sent import Sent
from mbocp.solution.sent_states import Follower
from mbocp.terms.bounded import BoundedTerm
from mbocp.terms.rates import RATE_TERMS

_PARTS = 8  # of a polynomial at whose ends they are looked at
_SAME = 1e-6  # of a step: times closer to a node than this are the node's


def path_excesses(follower: Follower, problem: Problem) -> tuple[tuple[Excess, ...], tuple[str, ...]]:
    """What a motion is beyond its path constraints, and nearer to obstacles than it may be, as it is sent.

    Parameters
    ----------
    follower : Follower
    problem : Problem
        What the motion is a solution of.

    Returns
    -------
    excesses : tuple of Excess
        The worst of each row that is left by more than 0.5 mm, 5 mrad, or a hundredth of its limit.
    unseen : tuple of str
        Constraints with rows that were not looked at: they ask for forces, or for joints that are not sent.
    """
    if not problem.path:
        return (), ()
    return path_excesses_along(MotionStates.of(follower, problem), problem, follower)


def path_excesses_along(
    motion: MotionStates, problem: Problem, follower: Follower | None = None
) -> tuple[tuple[Excess, ...], tuple[str, ...]]:
    """The same along a motion that is known, of all joints unless a follower says which."""
    excesses, unseen = list[Excess](), list[str]()
    for constraint in problem.path:
        if isinstance(constraint, Clearance):  # floating things are where the solution has them
            excesses += _nearer(constraint, motion)
            continue
        rows = _find_rows_seen(constraint, follower, problem)
        if rows.any():
            excesses += _beyond(constraint, motion, problem, rows)
        if not rows.all():
            unseen.append(constraint.name)
    return tuple(excesses), tuple(unseen)


@dataclass(frozen=True, eq=False)
class MotionStates:
    """A motion as it is sent, at its nodes and between them.

    Attributes
    ----------
    t : ndarray, shape (n,)
        From its start [s].
    qs, vs, us, rates : ndarray, shapes (n, nq), (n, nv), (n, nu) and (n, nv)
        With the accelerations.
    nodes : ndarray, shape (n,)
        Where this is along the nodes 0..N of the solution: 1.5 is amid the second step.
    """

    t: Array
    qs: Array
    vs: Array
    us: Array
    rates: Array
    nodes: Array

    @classmethod
    def of(cls, follower: Follower, problem: Problem) -> MotionStates:
        """Parts of the polynomials that are sent."""
        sent = follower.sent
        curves, solution = sent.curves, sent.solution
        at_nodes = np.clip(sent.times_of(solution.t), 0.0, curves.nodes[-1])
        at_nodes[[0, -1]] = 0.0, curves.nodes[-1]  # a mean rests half its time later at its ends
        t = np.union1d(curves.places(_PARTS)[0], at_nodes)
        nodes = np.interp(t, at_nodes, np.arange(len(at_nodes)))
        nodes[[0, -1]] = 0.0, len(at_nodes) - 1.0
        positions, velocities, accelerations, _ = curves.at(t)
        step = np.minimum(nodes.astype(int), solution.num_steps - 1)
        others = between(problem.robot, solution.qs[step], solution.qs[step + 1], nodes - step)
        qs, vs = follower.states(t, positions, velocities, others)
        us = follower.controls(qs, vs, accelerations) if follower.has_controls else sent.controls(t)
        return cls(t, qs, vs, us, follower.rates(accelerations), nodes)

    def within(self, held: BoolArray) -> BoolArray:
        """Where rows that hold at some of the nodes 0..N, shape (N + 1, rows), hold, shape (n, rows)."""
        first, last = (
            round_(self.nodes + sign * _SAME).astype(int) for round_, sign in ((np.floor, 1), (np.ceil, -1))
        )
        return np.asarray(np.logical_and(held[first], held[last]))


def _find_rows_seen(constraint: BoundedTerm, follower: Follower | None, problem: Problem) -> BoolArray:
    """Which rows of a constraint follow from joints that are sent, and controls."""
    sizes = {"acceleration": problem.robot.nv, "progress": 1, "control": problem.robot.nu}
    symbols = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    if not set(constraint.structure("quaternion").remembers) <= set(symbols):
        return np.zeros(constraint.rows, dtype=bool)
    if follower is None or all(of.all() for of in follower.known):
        return np.ones(constraint.rows, dtype=bool)
    function = constraint.function(problem.robot, symbols, *symbols.values())
    unknown = [~of for of in (*follower.known, follower.known[1])]
    asked = [np.asarray(function.jac_sparsity(0, k), dtype=bool)[:, of] for k, of in enumerate(unknown)]
    return np.asarray(~np.hstack(asked).any(axis=1))


def _beyond(
    constraint: BoundedTerm, motion: MotionStates, problem: Problem, rows: BoolArray
) -> Iterator[Excess]:
    at_nodes = np.logical_and(constraint.nodes(problem.num_steps, problem.dt), rows)
    at_start = np.logical_and(at_nodes[:1], constraint.span.has_start)
    held = motion.within(np.vstack([at_start, at_nodes]))
    some = held.any(axis=1)  # a path that is followed begins where these do
    if not some.any():
        return
    states = (motion.qs[some], motion.vs[some], motion.us[some], motion.rates[some])
    values = constraint.values_along(problem.robot, *states)
    for k, label in enumerate(constraint.labels):
        row, bounds = held[some, k], np.array([constraint.lower[k], constraint.upper[k]])
        is_plain, of_bounds = label.unit in PATH_TOLERANCES, np.abs(bounds[np.isfinite(bounds)])
        tolerance = PATH_TOLERANCES.get(label.unit, PATH_TOLERANCE_PART)
        size = 1.0 if is_plain else max([constraint.size, *of_bounds])
        yield from find_excesses(
            "path", label.name, values[row, k], bounds, motion.t[some][row], label.unit, tolerance, size
        )


def _nearer(clearance: Clearance, motion: MotionStates) -> Iterator[Excess]:
    found = nearest_approach(clearance, motion.t, motion.qs)
    if found is not None:
        short = found.margin - found.distance
        if short > PATH_TOLERANCES["m"] or found.distance < -BOUND_TOLERANCE:
            name = f"distance of {found.between}"
            yield Excess("path", name, found.distance, found.margin, found.time, short, "m")


_PARTS_OF_CONTROLS = 4  # of a step at whose ends they are looked at


def check_sent(sent: Sent, problem: Problem) -> tuple[tuple[Excess, ...], tuple[str, ...]]:
    """Look at the torques that a motion takes as it is sent, and at path constraints and obstacles.

    Parameters
    ----------
    sent : Sent
    problem : Problem
        What the motion is a solution of; terms of one's own may be missing.

    Returns
    -------
    excesses : tuple of Excess
        Of torques, their rates, powers and root mean squares, and links on springs, the worst first; of path
        constraints.
    unknown : tuple of str
        What was not looked at: efforts, links on springs, and path constraints by name.
    """
    follower = Follower.of(sent, problem.robot)
    excesses, unseen = path_excesses(follower, problem)
    rows = {label.name for constraint in problem.path for label in constraint.labels}
    unknown = [*unseen, *(row.name for row in sent.solution.facts.path if row.name not in rows)]
    if follower.has_controls:
        return (*joint_excesses(follower), *excesses), tuple(unknown)
    facts = sent.solution.facts
    if np.isfinite(sent.solution.limits_u).any() or facts.limits_more_of_controls:
        unknown.insert(0, "efforts")
    return excesses, (*(joint.name for joint in problem.robot.elastic), *unknown)


_Along: TypeAlias = tuple[Array, Array, Array, Array]


def controls_along(follower: Follower) -> _Along:
    """Times [s], configurations, velocities and controls along a motion that says these."""
    times, (positions, velocities, accelerations, _) = follower.sent.curves.places(_PARTS_OF_CONTROLS)
    qs, vs = follower.states(times, positions, velocities)
    return times, qs, vs, follower.controls(qs, vs, accelerations)


def joint_excesses(follower: Follower) -> tuple[Excess, ...]:
    """Limits that controls, and links on springs, leave by more than a hundredth, the worst first.

    Positions of links are left by more than 0.5 mm or 5 mrad.
    """
    along = controls_along(follower)
    found = (*_of_controls(follower, along), *_of_links(follower, along))
    return tuple(sorted(found, key=lambda excess: -excess.ratio))


def _of_controls(follower: Follower, along: _Along) -> Iterator[Excess]:
    """Controls, their rates, powers and root mean squares."""
    solution, (times, _, vs, controls) = follower.sent.solution, along
    facts, columns = solution.facts, solution.labels.u
    speeds = vs @ follower.robot.actuation_matrix(follower.robot.q0)
    bounds = {"effort": solution.limits_u}
    if "power" in facts.rates:
        bounds["power"] = facts.bounds_of_rate("power")
    for kind, values in (("effort", controls), ("power", controls * speeds)):
        for k, column in enumerate(columns if kind in bounds else ()):
            unit = column.unit if kind == "effort" else "W"
            yield from find_excesses(
                kind, column.name, values[:, k], bounds[kind][:, k], times, unit, CURVE_PART
            )
    if "effort_rate" in facts.rates:
        rates, middles = _effort_rates(follower, along)
        bounds["effort_rate"] = facts.bounds_of_rate("effort_rate")
        for k, column in enumerate(columns):
            unit, sides = RATE_TERMS["effort_rate"].unit(column.unit), bounds["effort_rate"][:, k]
            yield from find_excesses(EFFORT_RATE, column.name, rates[:, k], sides, middles, unit, CURVE_PART)
    if facts.effort_rms:
        squares = controls**2
        means = np.sqrt(np.diff(times) @ (squares[1:] + squares[:-1]) / (2.0 * times[-1]))
        for column, mean, limit in zip(columns, means, facts.effort_rms, strict=True):
            sides = np.array([-np.inf, limit])
            yield from find_excesses(
                "root mean square", column.name, mean[None], sides, times[-1:], column.unit, CURVE_PART
            )


def _effort_rates(follower: Follower, along: _Along) -> tuple[Array, Array]:
    """Rates of controls, shape (n, nu), and their times [s]: where accelerations leap those of samples.

    From the controls before the start, and to those after the end, in the time from one place to the next;
    where these are free, not within the first and the last step.
    """
    sent, (times, qs, vs, controls) = follower.sent, along
    ends = qs[[0, -1]]
    if sent.curves.accelerations is None:
        accelerations, times = differences(sent.curves.at(sent.times)[1], sent.times)
        qs, vs = follower.states(times, *sent.curves.at(times)[:2])
        controls = follower.controls(qs, vs, accelerations)
    first, last = sent.slower * np.maximum(np.diff(sent.solution.t)[[0, -1]], sent.mean)
    within = [first, sent.curves.nodes[-1] - last]
    before, after = _controls_beside(follower, ends)
    if before is not None:
        controls, times = np.vstack([before, controls]), np.append(2.0 * times[0] - times[1], times)
        within[0] = -math.inf
    if after is not None:
        controls, times = np.vstack([controls, after]), np.append(times, 2.0 * times[-1] - times[-2])
        within[1] = math.inf
    rates, middles = differences(controls, times)
    is_within = (middles > within[0]) & (middles < within[1])
    return rates[is_within], middles[is_within]


def _controls_beside(follower: Follower, ends: Array) -> tuple[Array | None, Array | None]:
    """Controls before the start and after the end, from and to which limits of rates lead, shape (nu,)."""
    facts = follower.sent.solution.facts
    before = np.array(facts.u_start) if facts.u_start else None
    after = np.array(facts.u_goal) if facts.u_goal else None
    if facts.ends_held:
        still, joints = np.zeros((1, follower.robot.nv)), np.zeros((1, len(follower.sent.joints)))
        after = follower.controls(ends[1:], still, joints)[0]
    return before, after


def _of_links(follower: Follower, along: _Along) -> Iterator[Excess]:
    """Positions and speeds of links on springs."""
    solution, (times, qs, vs, _) = follower.sent.solution, along
    for joint in follower.robot.elastic:
        (at_q, _), (at_v, _) = joint.at_q, joint.at_v
        unit, bounds = solution.labels.q[at_q].unit, solution.limits_q[:, at_q]
        size = float(np.abs(bounds[np.isfinite(bounds)]).max(initial=0.0))
        yield from find_excesses(
            "position", joint.name, qs[:, at_q], bounds, times, unit, PATH_TOLERANCES[unit] / (size or 1.0)
        )
        unit = solution.labels.v[at_v].unit
        yield from find_excesses(
            "speed", joint.name, vs[:, at_v], solution.limits_v[:, at_v], times, unit, CURVE_PART
        )
