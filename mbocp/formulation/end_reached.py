"""Whether a motion ends at the goal, or at another root of the end condition.

An end condition that is projected onto constraints, or that speaks of matrices, holds at more configurations
than the goal. Closed loops may be assembled another way; in natural coordinates a revolute joint may have
turned half around. That is no solution of what was asked for. Two ends beside the goal are:

- *Whole turns in natural coordinates.* They know where bodies are, and not how often a joint has turned. Goal
  and end are the same configuration of the robot.
- *Drift.* Explicit schemes leave the loops as time goes on. The end is on no other branch then, it is as far
  off as the loops are open.

Conditions on velocities are chosen by what the constraints leave free at `goal.q`, which is a guess where the
goal does not give every joint. At another configuration they may leave velocities free that should be zero:
`miss_of_rates` looks at the configuration in which the motion ends. What it finds across the constraints is
the scheme's: those of index 3 keep velocities in the constraints to some order alone, and explicit ones leave
the constraints themselves, too. A part of that may be seen along the constraints, until the conditions are
chosen where the motion ends.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mbocp._arrays import Array, null_space
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.formulation.base import Formulation
from mbocp.formulation.features.changing_constraints import ties_at_end
from mbocp.formulation.motion import Motion
from mbocp.integrators import SCHEMES
from mbocp.mechanics.diagnostics import constraint_violation
from mbocp.mechanisms.consistent_states import span_allowed_velocities
from mbocp.problem import Problem
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.goals.frames import errors_of_poses
from mbocp.problem.integration import SMALL_LOOP, has_rotations
from mbocp.robot.kinematics import momenta_of

_REACHED = 1e-6  # tangent-space distance [m, rad] beyond which the end is not at the goal
_OPEN = (
    1e-3  # violation of the loops, by that distance, that speaks of drift: on another branch it is round-off
)
_UNSAID = "the conditions of the end do not say it there; start from another guess"
_OF_BODIES = "those of bodies are those of joints to the order of the scheme alone: take more steps"
_ACROSS = "the scheme leaves it across the constraints"
_GROSS_OPENING = 0.01  # [m, rad]: loops that are open by more are none
_NO_TIME = 0.01  # of the mean length of a step
_SHARE = 0.05  # of the motion's largest velocity of that unit: what a scheme may leave across the constraints


class EndMiss(NamedTuple):
    """An end condition holds beside the goal.

    Attributes
    ----------
    is_other_root : bool
        Whether the end is another configuration of the robot than the one asked for.
    words : str
        Where it is, and what to do.
    """

    is_other_root: bool
    words: str


def miss_of_end(formulation: Formulation, qs: Array) -> EndMiss | None:
    """How a motion that meets the end condition misses the goal, or None where it is there.

    Parameters
    ----------
    formulation : Formulation
    qs : ndarray, shape (N + 1, nq)
        Configurations [m, rad, unit quaternion].
    """
    goal = formulation.problem.goal
    if not goal.is_exact:
        return None
    if goal.q_active.any():
        missed = _miss_of_joints(formulation, qs)
        if missed is not None:
            return missed
    return _miss_of_frames(formulation, qs[-1]) if goal.poses else None


def _miss_of_joints(formulation: Formulation, qs: Array) -> EndMiss | None:
    goal, robot = formulation.problem.goal, formulation.problem.robot
    missing = robot.difference(goal.q, qs[-1])[goal.q_active]
    distance = float(np.linalg.norm(missing))
    if distance <= _REACHED:
        return None
    turns = missing / (2.0 * np.pi)
    if not formulation.counts_turns and np.abs(turns - turns.round()).max() <= _REACHED:
        return EndMiss(
            is_other_root=False,
            words="but whole turns away from goal.q: bodies do not know how often a joint has turned; start "
            "from a guess that turns as often, or take joint coordinates",
        )
    violation = constraint_violation(robot, qs[-1:], np.zeros((1, robot.nv))).position
    if violation > _OPEN * distance:
        return EndMiss(
            is_other_root=False,
            words=f"but the end is {distance:.3g} off goal.q, since the scheme drifts off the loops (by "
            f"{violation:.1e} there): take more steps",
        )
    return EndMiss(
        is_other_root=goal.guard,  # who takes the guard away asks for the condition as it stands
        words=f"but the end is {distance:.3g} off goal.q: the end condition, projected onto the constraints, "
        "has another root there; start from another guess",
    )


def _miss_of_frames(formulation: Formulation, q: Array) -> EndMiss | None:
    """How the last configuration misses the poses of frames.

    Their rows vanish at the goal alone. Where constraints decide some of them, those are not conditions.
    """
    robot, goal = formulation.problem.robot, formulation.problem.goal
    poses = [
        frame for frame in goal.conditions if frame.has_pose
    ]  # tolerances are bounds: the status has them
    if not poses:
        return None
    errors = errors_of_poses(robot, poses, q)
    worst = int(np.argmax(errors.positions + errors.angles))
    distance, angle = float(errors.positions[worst]), float(errors.angles[worst])
    if max(distance, angle) <= _REACHED:
        return None
    name = poses[worst].name
    off = f"but {name!r} ends {1e3 * distance:.3g} mm and {np.degrees(angle):.3g} deg off its goal"
    violation = constraint_violation(robot, q[None], np.zeros((1, robot.nv))).position
    if violation > _OPEN * max(distance, angle):
        return EndMiss(
            is_other_root=False,
            words=f"{off}, since the scheme drifts off the loops (by {violation:.1e} there): take more steps",
        )
    return EndMiss(
        is_other_root=goal.guard,
        words=f"{off}: the end condition, projected onto the constraints, has another root there; start from "
        "another guess",
    )


class RateMiss(NamedTuple):
    """Velocities at the end are not those that the goal asks for.

    Attributes
    ----------
    is_free : bool
        Whether the constraints would let the robot end with the velocities of the goal; else the scheme's
        steps leave velocities across the constraints, or those of joints beside those of bodies.
    words : str
        By how much, and what to do.
    is_small : bool
        Whether it is no more than a scheme may leave.
    """

    is_free: bool
    words: str
    is_small: bool = False


def miss_of_rates(formulation: Formulation, motion: Motion, *, is_strict: bool = True) -> RateMiss | None:
    """How the last velocities or momenta miss those of an exact goal, or None where they do not.

    Parameters
    ----------
    formulation : Formulation
    motion : Motion
    is_strict : bool
        Whether it counts, too, where it is no more than a scheme may leave.
    """
    problem = formulation.problem
    robot, goal, q = problem.robot, problem.goal, motion.qs[-1]
    if not (goal.is_exact and goal.rate_active.any()):
        return None
    is_momentum = goal.rate == "p"
    to_rate = robot.mass_matrix(q) if is_momentum else np.eye(robot.nv)
    error = np.where(goal.rate_active, to_rate @ motion.vs[-1] - goal.value, 0.0)
    free = _free_velocities(formulation, q)
    basis = _range(np.where(goal.rate_active[:, None], to_rate @ free, 0.0))
    along = basis @ (basis.T @ error)
    scale = _largest_of_unit(formulation, motion, is_momentum)
    tolerance = np.maximum(_REACHED * scale, _REACHED)
    by_scheme = np.maximum(_SHARE * scale, tolerance)
    # Velocities of bodies in natural coordinates are those of joints to the order of the scheme alone.
    of_joints = formulation.counts_turns
    is_exact = of_joints and free.shape[1] == robot.nv
    labels = robot.p_labels if is_momentum else robot.v_labels
    for is_free, part, most, remedy in (
        (of_joints, along, tolerance if is_exact else by_scheme, _UNSAID if of_joints else _OF_BODIES),
        (False, error - along, by_scheme, f"{_ACROSS}: {_more_steps(problem)}"),
    ):
        told = tolerance if is_strict else most
        worst = int(np.argmax(np.abs(part) / told))
        size = abs(part[worst])
        if size > told[worst]:
            off = f"{labels[worst].name} ends {size:.3g} {labels[worst].unit} off goal.{goal.rate}"
            return RateMiss(is_free, f"{off}: {remedy}", is_small=bool(size <= most[worst]))
    return None


def miss_of_vias(formulation: Formulation, motion: Motion) -> tuple[str, bool]:
    """Say how velocities miss those of via points, the worst, and whether by far; "" where they do not."""
    problem, worst, words = formulation.problem, 1.0, ""
    scale = _largest_of_unit(formulation, motion, is_momentum=False)
    tolerance = np.maximum(_REACHED * scale, _REACHED)
    for point in problem.timeline.waypoints:
        goal = point.via.goal
        ratios = np.where(goal.rate_active, np.abs(motion.vs[point.node] - goal.value) / tolerance, 0.0)
        if ratios.max() > worst:
            entry = int(ratios.argmax())
            worst, label = ratios[entry], problem.robot.v_labels[entry]
            off = f"{label.name} passes {worst * tolerance[entry]:.3g} {label.unit} off its v"
            words = f"via {point.via.name!r}: {off}: {_ACROSS}: {_more_steps(problem)}"
    return words, worst > _SHARE / _REACHED


def vias_at_once(problem: Problem, t: Array) -> str:
    """Say between which via points of free times no time passes; "" where some does.

    What holds between them asks for nothing then, or for what cannot be.
    """
    timeline = problem.timeline
    mean = (t[-1] - t[0]) / timeline.num_timed_steps
    for before, phase in pairwise(timeline.free_phases):
        length, names = t[phase.last] - t[phase.first], [timeline.name_of(one) for one in (before, phase)]
        is_short = length < _NO_TIME * mean * phase.steps
        if is_short and phase is not timeline.phases[-1] and not (before.name or phase.name):
            between = f"the time between via {names[0]!r} and {names[1]!r} vanishes ({length:.2g} s)"
            return f"{between}, as where their tolerances meet: make these smaller, or leave one out"
    return ""


def describe_opening(formulation: Formulation, motion: Motion) -> tuple[str, bool]:
    """Say how far a scheme that does not solve constraints leaves them, and whether by far; "" where not."""
    problem = formulation.problem
    if SCHEMES[problem.scheme].solves_constraints or not problem.robot.nc:
        return "", False
    found = constraint_violation(problem.robot, motion.qs, motion.vs)
    if found.position <= _REACHED:
        return "", False
    at = f"{found.position:.2g} at {found.position_name}, t = {motion.dts[: found.position_node].sum():.4g} s"
    words = f"the scheme drifts off the loops by up to {at}: {_more_steps(problem)}"
    return words, found.position > _GROSS_OPENING


def _more_steps(problem: Problem) -> str:
    """What to do about a scheme that leaves velocities or positions across the constraints."""
    robot, is_natural = problem.robot, COORDINATES[problem.coordinates].needs_constraints
    if robot.drives or (robot.rotations == "dcm" and has_rotations(robot)):
        return "take more steps"
    others = robot.nv > SMALL_LOOP or problem.timeline.switches or is_natural
    return f"take more steps, or the scheme {'se1' if others else 'lobatto3 or se1'}"


def _free_velocities(formulation: Formulation, q: Array) -> Array:
    """Directions of the velocities that everything which acts at the end allows there, shape (nv, any)."""
    ties = ties_at_end(formulation.problem, q)
    if ties is None:
        return span_allowed_velocities(formulation.problem.robot, q)
    return null_space(ties[1], RANK_TOLERANCE)


def _range(matrix: Array) -> Array:
    """Orthonormal basis of what the columns span, to the same tolerance as null spaces."""
    left, values, _ = np.linalg.svd(matrix, full_matrices=False)
    return left[:, values > RANK_TOLERANCE * max(float(values.max(initial=0.0)), 1.0)]


def _largest_of_unit(formulation: Formulation, motion: Motion, is_momentum: bool) -> Array:
    """For each entry the largest one of its unit along the motion, shape (nv,)."""
    robot = formulation.problem.robot
    labels = robot.p_labels if is_momentum else robot.v_labels
    rates = momenta_of(robot.model, motion.qs, motion.vs) if is_momentum else motion.vs
    largest = np.abs(rates).max(axis=0)
    units = np.array([label.unit for label in labels])
    return np.array([largest[units == unit].max() for unit in units])
