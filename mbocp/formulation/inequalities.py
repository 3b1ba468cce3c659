"""Limits and path constraints along a trajectory: how far they are violated, and their multipliers."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.base import Formulation
from mbocp.formulation.features.braking_within import BRAKING_WITHIN, name_braking_rows
from mbocp.formulation.features.changing_constraints import reactions_along
from mbocp.formulation.features.lines_within import LINES_WITHIN, names_of_lines
from mbocp.formulation.features.path_progress import progress_along
from mbocp.formulation.features.paths_within import PATHS_WITHIN, names_of_paths, slopes_of_paths
from mbocp.formulation.features.within_steps import names_within, units_within
from mbocp.formulation.motion import Motion
from mbocp.formulation.state_bounds import sides_of_path
from mbocp.integrators import root_mean_squares
from mbocp.mechanics.motion_rates import rates_along
from mbocp.problem import Problem
from mbocp.problem.first_motion import find_holding_controls
from mbocp.programme import Iterate
from mbocp.terms.bounded import MotionAtNodes


def inequalities(formulation: Formulation, iterate: Iterate, motion: Motion) -> dict[str, Any]:
    """Fields of a solution that speak of inequalities, by name."""
    problem = formulation.problem
    path = _path_of(formulation, iterate, motion)
    names = tuple(label.name for constraint in problem.inequalities for label in constraint.labels)
    names += _names_within(problem)
    return {
        **_multipliers(formulation, iterate, path),
        "path_names": names,
        "limit_violation": _violation(problem, motion, path),
    }


def _names_within(problem: Problem) -> tuple[str, ...]:
    """Of all limits that hold within steps, too."""
    return (
        *names_within(problem),
        *names_of_lines(problem),
        *name_braking_rows(problem),
        *names_of_paths(problem),
    )


def limit_violation(formulation: Formulation, iterate: Iterate, motion: Motion) -> float:
    """Largest violation of a limit or path constraint."""
    return _violation(formulation.problem, motion, _path_of(formulation, iterate, motion))


def _path_of(formulation: Formulation, iterate: Iterate, motion: Motion) -> Array:
    problem = formulation.problem
    return path_along(problem, motion, reactions_along(problem, formulation.layout, iterate.xs))


def path_along(problem: Problem, motion: Motion, lams: Array) -> Array:
    """Values of path constraints and limited rates at the nodes 1..N, shape (N, nh), in their own units.

    `lams`: forces of the robot's constraints that contacts speak of, see `reactions_along`.
    """
    robot, qs, vs, us = problem.robot, motion.qs, motion.vs, motion.us
    along = _along(problem, motion, lams)
    linear = motion.values if problem.controls == "linear" else None
    along_steps = partial(
        rates_along, robot, qs, vs, us, motion.dts, motion.us_at_ends, linear, problem.a_start
    )
    limits = problem.limits_of_rates
    rates = along_steps(problem.u_before) | {"control": motion.us_at_ends} if limits else {}
    if isinstance(problem.u_after, str) and (held := find_holding_controls(robot, qs[-1])) is not None:
        rates["held"] = held
    return np.hstack([np.zeros((len(us), 0)), *along, *(c.values_of(rates, motion.dts) for c in limits)])


def _along(problem: Problem, motion: Motion, lams: Array) -> list[Array]:
    """Values of each path constraint at the nodes 1..N."""
    if not problem.path:
        return []
    states = motion.qs[1:], motion.vs[1:], motion.us_at_ends
    names = [constraint.name for constraint in problem.frame_constraints if constraint.follows]
    progress = dict(zip(names, progress_along(problem, motion.qs)[1:].T, strict=True))
    means = rates_along(None, motion.qs, motion.vs, motion.us, motion.dts)["acceleration"]
    nodes = MotionAtNodes(np.cumsum(motion.dts), states, means, lams, progress)
    return [one.values_in_motion(problem.robot, nodes) for one in problem.path]


def _violation(problem: Problem, motion: Motion, path: Array) -> float:
    limits, qs, vs = problem.limits_along(), motion.qs, motion.vs
    values = np.moveaxis(motion.values, 1, 0) if motion.shares else motion.us
    pairs = [(values, *limits["u"]), (qs[1:], *limits["q"]), (vs[1:], *limits["v"])]
    if problem.limits.finite("rms").any():
        squares = root_mean_squares(motion.dts, motion.us, motion.values, motion.shares)
        pairs.append((squares, problem.limits.rms_lower, problem.limits.rms_upper))
    if problem.inequalities:
        pairs.append((path, *sides_of_path(problem)))
    timeline = problem.timeline
    for phase in timeline.free_phases:
        (shortest, longest), end = timeline.sides_of(phase), timeline.end_of(phase)
        taken = motion.dts[phase.first : phase.last].sum(keepdims=True)
        pairs.append((taken, np.array([shortest]), np.array([longest])))
        earliest, latest = np.array([end.earliest]), np.array([end.latest])
        pairs.append((motion.dts[: phase.last].sum(keepdims=True), earliest, latest))
    worst = [float(np.max([lower - values, values - upper], initial=0.0)) for values, lower, upper in pairs]
    return max(worst)


def _multipliers(formulation: Formulation, iterate: Iterate, path: Array) -> dict[str, Array]:
    problem = formulation.problem
    robot, N = problem.robot, problem.num_steps
    lam_qs = np.zeros((N + 1, robot.nq))
    bounds = iterate.bounds
    if bounds is None:
        nh = path.shape[1] + len(_names_within(problem))
        return {
            "lam_us": np.zeros((N, robot.nu)),
            "lam_qs": lam_qs,
            "lam_vs": np.zeros((N + 1, robot.nv)),
            "lam_path": np.zeros((N, nh)),
        }
    for part in formulation.space.parts:
        plain = min(part.at_q.stop - part.at_q.start, part.at_z.stop - part.at_z.start)
        plain = plain if part.at_matrix < 0 else part.at_matrix - part.at_z.start
        lam_qs[:, part.at_q.start : part.at_q.start + plain] = bounds.xs[
            :, part.at_z.start : part.at_z.start + plain
        ]
    lam_vs = formulation.velocity_multipliers(bounds.xs)
    factors = [
        c.slopes(values) for c, values in zip(problem.inequalities, _columns(problem, path), strict=True)
    ]
    slopes = np.hstack(factors) if factors else np.ones_like(path)
    own = bounds.us[:, : formulation.layout.num_own]
    lam_us = formulation.pieces.signature.control_values.sum_up(own)
    of_path = [bounds.path * slopes]
    states = formulation.layout.states
    within = units_within(problem) | dict.fromkeys(states.keys() & {LINES_WITHIN, BRAKING_WITHIN}, 1.0)
    of_path += [bounds.xs[1:, states[name]] / within[name] for name in states if name in within]
    if PATHS_WITHIN in states:
        multipliers = bounds.xs[1:, states[PATHS_WITHIN]]
        of_path.append(multipliers * slopes_of_paths(problem, multipliers))
    return {"lam_us": lam_us, "lam_qs": lam_qs, "lam_vs": lam_vs, "lam_path": np.hstack(of_path)}


def _columns(problem: Problem, path: Array) -> list[Array]:
    """The columns of each path constraint."""
    ends = np.cumsum([constraint.rows for constraint in problem.inequalities])
    return np.split(path, ends[:-1], axis=1) if problem.inequalities else []
