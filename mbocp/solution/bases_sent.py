"""Limits that bases and balls leave as points of a file send them, at these and from one to the next."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp._text import list_names, warn_caller
from mbocp.exceptions import MbocpError
from mbocp.robot import Robot
from mbocp.robot.nodes import steps_between
from mbocp.solution.curves import differences
from mbocp.solution.joints_sent import CURVE_PART, Excess, find_excesses
from mbocp.solution.recordings import MotionSamples, points_of
from mbocp.solution.sent import NotCheckedWarning
from mbocp.solution.solution_data import SolutionData
from mbocp.terms.rates import RATE_TERMS

_MOST_NAMES = 6


def base_excesses(motion: MotionSamples, solution: SolutionData, robot: Robot) -> tuple[Excess, ...]:
    """By what a motion leaves limits of its bases and balls, path constraints and obstacles, the worst first.

    Speeds are those of points, and the means from one to the next; accelerations differences of speeds. Times
    are those of a message [ns].

    Warns
    -----
    NotCheckedWarning
        If path constraints or jerks cannot be looked at.
    """
    points = _Points.of(motion, robot)
    found = [*_of_bases(points, solution, robot)]
    unseen = ["jerks"] * ("jerk" in solution.facts.rates)
    if solution.facts.path:
        of_paths, others = _of_paths(points, solution, robot)
        found, unseen = found + of_paths, unseen + others
    if unseen:
        warn_caller(
            f"not checked as bases and balls are sent: {list_names(unseen, _MOST_NAMES)}", NotCheckedWarning
        )
    return tuple(sorted(found, key=lambda excess: -excess.ratio))


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of a message: times [s], their middles, configurations, velocities, mean ones, accelerations."""

    t: Array
    middles: Array
    qs: Array
    vs: Array
    means: Array
    accelerations: Array

    @classmethod
    def of(cls, motion: MotionSamples, robot: Robot) -> _Points:
        at = points_of(motion)
        t, qs, vs = np.round(motion.t[at], 9), motion.qs[at], motion.vs[at]
        accelerations, middles = differences(vs, t)
        return cls(t, middles, qs, vs, steps_between(robot, qs) / np.diff(t)[:, None], accelerations)


def _of_bases(points: _Points, solution: SolutionData, robot: Robot) -> Iterator[Excess]:
    labels, rates = solution.labels, solution.facts.rates
    both, t = np.vstack([points.vs, points.means]), np.append(points.t, points.middles)
    for joint in list(robot.model.joints)[1:]:
        if joint.nv == 1:
            continue
        for i in range(joint.idx_v, joint.idx_v + joint.nv):
            name, unit = labels.v[i].name, labels.v[i].unit
            bounds = solution.limits_v[:, i]
            yield from find_excesses("speed", name, both[:, i], bounds, t, unit, CURVE_PART)
            if "acceleration" in rates:
                found, bounds = (
                    points.accelerations[:, i],
                    solution.facts.bounds_of_rate("acceleration")[:, i],
                )
                of_rate = RATE_TERMS["acceleration"].unit(unit)
                yield from find_excesses(
                    "acceleration", name, found, bounds, points.middles, of_rate, CURVE_PART
                )
        for i in range(joint.idx_q, joint.idx_q + joint.nq):
            name, unit = labels.q[i].name, labels.q[i].unit
            yield from find_excesses(
                "position", name, points.qs[:, i], solution.limits_q[:, i], points.t, unit, CURVE_PART
            )


def _of_paths(points: _Points, solution: SolutionData, robot: Robot) -> tuple[list[Excess], list[str]]:
    """What leaves path constraints and obstacles, and the names of those that were not looked at."""
    from mbocp.solution.its_problem import problem_to_check  # as slow to import as all else
    from mbocp.solution.sent_checks import MotionStates, path_excesses_along

    t, nodes = points.t, solution.t - solution.t[0]
    states = MotionStates(
        t,
        points.qs,
        points.vs,
        solution.controls_at(solution.t[0] + t),
        np.gradient(points.vs, t, axis=0),
        np.interp(t, nodes, np.arange(len(nodes))),
    )
    try:
        excesses, unseen = path_excesses_along(states, problem_to_check(solution, lambda: robot))
    except MbocpError as error:
        return [], [f"path constraints: {error}"]
    return [*excesses], [*unseen]
