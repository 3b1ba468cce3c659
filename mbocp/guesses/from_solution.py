"""A guess from a solution of the same robot: a warm start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, IntArray, dataclass
from mbocp._text import warn_caller
from mbocp.exceptions import DimensionMismatch
from mbocp.formulation import Formulation, Motion
from mbocp.formulation.features.changing_constraints import fill_impulses
from mbocp.formulation.iterates import restore
from mbocp.integrators import SCHEMES
from mbocp.mechanics import dual_of_velocity
from mbocp.problem import Problem
from mbocp.problem.coordinates import COORDINATES
from mbocp.programme import BoundMultipliers, Iterate
from mbocp.robot.nodes import between
from mbocp.solution import Solution
from mbocp.solution.rest import begins_beside, place_at, place_of_start

_ON_NODE = 1e-9  # of a step: what is nearer to a node is the node


def iterate_from_solution(saved: Solution, formulation: Formulation, at: float | None = None) -> Iterate:
    """Iterate from a solution with any number of steps, or from the rest of it where a problem begins later.

    Where nodes are nodes of the solution, and unknowns mean the same, multipliers are those of the solver;
    else the motion is interpolated in time on the manifold, with those that the solution has.

    Parameters
    ----------
    saved : Solution
    formulation : Formulation
    at : float, optional
        Time [s] on the motion with which to begin; None: where the problem's start lies on it, or its start.

    Raises
    ------
    DimensionMismatch
        If the solution belongs to a robot of other dimensions.
    InvalidValue
        If the motion has ended by that time, or not begun.
    """
    problem, robot = formulation.problem, formulation.problem.robot
    known = COORDINATES.get(saved.coordinates)
    has_multipliers = known is None or known.has_robot_multipliers
    has_own = has_multipliers and COORDINATES[problem.coordinates].has_robot_multipliers
    rows = len(formulation.constraint_labels) if has_own else robot.nc
    _check("(nq, nv, nu)", (saved.nq, saved.nv, saved.nu), (robot.nq, robot.nv, robot.nu))
    if has_multipliers and rows:  # without, they are left to be worked out when something else needs them
        _check("nc", (saved.nc,), (rows,))
    begin = _begin(problem, saved) if at is None else place_at(saved, at)
    _tell_of_accelerations(problem, saved, begin)
    nodes = _nodes_of(problem, saved, begin)
    places = _Places.of(nodes, saved)
    if has_multipliers and rows:
        lams = saved.lams[places.middle]
    else:
        lams = np.zeros((problem.num_steps, 0 if has_multipliers else robot.nc))
    motion = _motion(saved, formulation, places)
    iterate = formulation.iterate_of(motion, lams)
    if saved.iterate is not None:
        is_later = bool(nodes[0] > 0.0) or begins_beside(saved, problem)
        kept = restore(saved.iterate, np.diff(saved.t), iterate, formulation, nodes, is_later=is_later)
        if kept is not None:
            return kept
    if has_multipliers:
        _check("nc", (saved.nc,), (rows,))
    if not (has_multipliers and formulation.keeps_adjoints):
        return iterate
    return _with_multipliers(iterate, saved, formulation, places, motion.dts)


def _tell_of_accelerations(problem: Problem, saved: Solution, begin: float) -> None:
    """Warn where limits of jerk begin with another acceleration than the motion has there."""
    limits = problem.limits_of_ends[0]
    limited = np.flatnonzero(limits.finite("j"))
    if not begin or not limited.size:
        return
    there = saved.acceleration_at(round(begin))
    reach = problem.dt * np.maximum(-limits.j_lower, limits.j_upper)  # a step makes as much of a difference
    apart = np.abs(there - problem.a_start)[limited] / reach[limited]
    worst = int(limited[apart.argmax()])
    if apart.max() > 1.0:
        label = problem.robot.v_labels[worst]
        warn_caller(
            f"the motion goes on from the middle of another one, but start.a of {label.name} is "
            f"{problem.a_start[worst]:.3g} {label.unit}^2 where that has {there[worst]:.3g}: within limits "
            f"of jerk this is another motion; say start.a = solution.acceleration_at({round(begin)})"
        )


@dataclass(frozen=True, eq=False)
class _Places:
    """Where on a saved motion the nodes of another one are.

    Attributes
    ----------
    nodes : ndarray, shape (N + 1,)
        In numbers of its nodes.
    left : ndarray of int, shape (N + 1,)
        The saved node before each.
    share : ndarray, shape (N + 1,)
        Of the saved step after that.
    middle : ndarray of int, shape (N,)
        The saved step in which the middle of each step is.
    """

    nodes: Array
    left: IntArray
    share: Array
    middle: IntArray

    @classmethod
    def of(cls, nodes: Array, saved: Solution) -> _Places:
        last = saved.num_steps - 1
        left = np.minimum(nodes.astype(int), last)
        middle = np.minimum(((nodes[:-1] + nodes[1:]) / 2.0).astype(int), last)
        return cls(nodes, left, nodes - left, middle)

    def between(self, values: Array) -> Array:
        """Values at the nodes, from those at the saved ones."""
        return values[self.left] + self.share[:, None] * (values[self.left + 1] - values[self.left])


def _motion(saved: Solution, formulation: Formulation, places: _Places) -> Motion:
    """The saved motion with the steps of a formulation."""
    problem, nodes = formulation.problem, places.nodes
    shares = formulation.pieces.signature.control_values.shares
    qs = between(problem.robot, saved.qs[places.left], saved.qs[places.left + 1], places.share)
    dts = np.diff(np.interp(nodes, np.arange(saved.num_steps + 1.0), saved.t))
    dts = dts if problem.timeline.has_free_lengths else problem.timeline.lengths()
    us, values = saved.us[places.middle], _values(saved, nodes, shares)
    us[problem.timeline.is_impact] = 0.0  # those that a motion repeats there would cost
    known = [saved.parameters.get(one.name, one.start) for one in problem.parameter]
    return Motion(qs, places.between(saved.vs), us, dts, values, shares, np.array(known))


def _with_multipliers(
    iterate: Iterate, saved: Solution, formulation: Formulation, places: _Places, dts: Array
) -> Iterate:
    """The iterate with the multipliers that the solution has."""
    programme, more = formulation.programme, formulation.layout.num_more_states
    zetas = fill_impulses(formulation.problem, dts) ** 2 * saved.zetas[places.middle]
    mus = _row_multipliers(saved, formulation, places)
    return replace(
        iterate,
        ms=np.hstack([mus, np.zeros((len(mus), more)), zetas]),
        eta=saved.eta if saved.eta.size == programme.ng else np.zeros(programme.ng),
        bounds=_bound_multipliers(saved, formulation, places),
    )


def _check(words: str, got: tuple[int, ...], expected: tuple[int, ...]) -> None:
    if got != expected:
        raise DimensionMismatch(f"warm start {words}", got, expected)


def _values(saved: Solution, nodes: Array, shares: tuple[float, ...]) -> Array:
    """Controls of the saved motion at shares of the new steps, shape (N, k, nu).

    At the end of a new step they are those before it, where the saved ones leap.
    """
    if not shares or saved.has_constant_controls:
        return np.zeros((0, 0, 0))
    numbers = nodes[:-1, None] + np.outer(np.diff(nodes), shares)
    inner = numbers - _ON_NODE * np.diff(nodes)[:, None] * (np.array(shares) > 1.0 - _ON_NODE)
    times = np.interp(inner.ravel(), np.arange(saved.num_steps + 1.0), saved.t)
    return saved.controls_at(times).reshape(len(numbers), len(shares), -1)


def _begin(problem: Problem, saved: Solution) -> float:
    """Where on the saved motion the problem begins; at its start if it has passed a via point of both."""
    begin, numbers = place_of_start(saved, problem), np.arange(saved.num_steps + 1.0)
    names = {name for name, _, _ in _phases_of(problem)}
    if not (begin and names):
        return begin
    passed = _times_by_name(saved)
    time = np.interp(begin, numbers, saved.t - saved.t[0])
    return 0.0 if any(passed[name] <= time for name in names & passed.keys()) else begin


def _times_by_name(saved: Solution) -> dict[str, float]:
    """When via points are passed and phases end [s], by name."""
    return {**saved.via_times, **{name: end for name, (_, end) in saved.phase_times.items()}}


def _nodes_of(problem: Problem, saved: Solution, begin: float) -> Array:
    """Where on the saved motion the nodes are, in numbers of its nodes, shape (N + 1,).

    Phases begin at the via points of the same names, or else when the guess has them begin. Within a phase,
    and where there are none, the motion from `begin` on is stretched evenly in time.
    """
    numbers, times = np.arange(saved.num_steps + 1.0), saved.t - saved.t[0]
    if (
        problem.timeline.impacts and begin + problem.num_steps == saved.num_steps
    ):  # nodes of an impact have one time
        return numbers[int(begin) :]
    phases = _phases_of(problem)
    clock = problem.timeline.times()
    before = float(np.interp(begin, numbers, times))
    wanted = before + clock * ((times[-1] - before) / clock[-1])
    passed = _times_by_name(saved) if phases else {}
    for i, (name, first, last) in enumerate(phases):
        is_last = i == len(phases) - 1
        at = times[-1] if is_last else passed.get(name, wanted[last])
        if not before < at <= times[-1]:
            at = before + (times[-1] - before) * (last - first) / (len(wanted) - 1 - first)
        wanted[first : last + 1] = np.interp(clock[first : last + 1], clock[[first, last]], [before, at])
        before = at
    found: Array = np.interp(wanted, times, numbers)
    _put_impacts(found, problem.timeline.impacts, np.flatnonzero(np.diff(saved.t) == 0.0))
    return np.where(np.abs(found - found.round()) < _ON_NODE, found.round(), found)


def _put_impacts(nodes: Array, impacts: Sequence[int], saved: IntArray) -> None:
    """The nodes before and after each impact on those of the saved one, which have one time."""
    if len(impacts) == len(saved):
        nodes[list(impacts)] = saved
        nodes[np.array(impacts, dtype=int) + 1] = saved + 1


def _phases_of(problem: Problem) -> tuple[tuple[str, int, int], ...]:
    """Name, first and last node of each phase, where there are several."""
    timeline = problem.timeline
    phases = timeline.phases if timeline.named_phases or len(timeline.phases) > 1 else ()
    return tuple((timeline.name_of(phase), phase.first, phase.last) for phase in phases)


def _bound_multipliers(saved: Solution, formulation: Formulation, places: _Places) -> BoundMultipliers | None:
    """Multipliers of limits where states are (q, v); those of path constraints and guards begin anew."""
    programme = formulation.programme
    if not (saved.lam_us.any() or saved.lam_qs.any() or saved.lam_vs.any()):
        return None
    lam_xs = places.between(np.hstack([saved.lam_qs, saved.lam_vs]))
    N, at = programme.num_steps, formulation.layout
    return BoundMultipliers(
        xs=np.hstack([lam_xs, np.zeros((N + 1, at.num_more_states))]),
        us=np.hstack([saved.lam_us[places.middle], np.zeros((N, at.num_more_controls))]),
        path=np.zeros((N, programme.bounds.nh)),
        guard=np.zeros(programme.num_guards),
    )


def _row_multipliers(saved: Solution, formulation: Formulation, places: _Places) -> Array:
    """Multipliers of kinematic and momentum rows from the adjoints of a solution by any scheme.

    The kinematic row's is the dual of q at one end of the step, the momentum row's that of p at 1 - tau (to
    first order in dt where the mass matrix varies, which the first Newton step mends).
    """
    robot, tau = formulation.problem.robot, formulation.force_tau
    nv = robot.nv
    duals_q, duals_p = saved.mus[:, :nv].copy(), saved.mus[:, nv:]
    is_of_rows = SCHEMES[saved.scheme].has_row_adjoints  # but at the last node
    for n in [-1] if is_of_rows else range(saved.num_steps + 1):
        duals_q[n] = dual_of_velocity(robot, saved.qs[n], saved.vs[n], saved.mus[n])[:nv]
    duals_q, duals_p = places.between(duals_q), places.between(duals_p)
    along_q = duals_q[:-1] if tau == 1.0 else duals_q[1:]
    return np.hstack([along_q, tau * duals_p[:-1] + (1.0 - tau) * duals_p[1:]])
