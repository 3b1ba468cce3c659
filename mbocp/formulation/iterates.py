"""Iterates of a formulation as starts for others, and back as they were; with the robot that was found."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp.formulation.base import Formulation
from mbocp.formulation.features.step_lengths import lengths_of_states
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.motion import Motion
from mbocp.problem import Problem
from mbocp.problem.obstacles.reserves import room_of
from mbocp.programme import Iterate
from mbocp.programme.iterate import Carried

_SAME = 1e-9  # relative: multipliers of steps of another length are others
_SAME_MOTION = 1e-3  # of the largest number: rotations that left their group come back to it


def carried_of(formulation: Formulation, iterate: Iterate) -> Carried:
    """An iterate with all that says where it fits."""
    carried = Carried.of(iterate, formulation.programme)
    problem, nothing = formulation.problem, np.zeros(0)
    return replace(
        carried,
        meaning=_meaning(formulation),
        room=frozen_array(room_of(problem)),
        limits_within=problem.limits_within,
        q_end=problem.goal.q if problem.goal.q_is_reached or problem.parameter else nothing,
        q_start=problem.q_start if problem.parameter else nothing,
        first=frozen_array([one.start for one in problem.parameter]),
    )


def take_end_of(problem: Problem, carried: Carried) -> Problem:
    """A solution's problem with conditions of the end where its solve chose them."""
    if carried.q_end.size:
        is_reached = not carried.first.size  # of a robot that is found the end is none of the given robot's
        problem = replace(problem, goal=replace(problem.goal, q=carried.q_end, q_is_reached=is_reached))
    if carried.first.size:
        problem = replace(_put_found(problem, carried.first), q_start=carried.q_start)
    return problem


def restore(carried: Carried, dts: Array, motion: Iterate, formulation: Formulation) -> Iterate | None:
    """An iterate as it was; of one with more steps the last ones. None where unknowns or motion are others.

    Parameters
    ----------
    carried : Carried
    dts : ndarray, shape (M,)
        Lengths of its steps [s].
    motion : Iterate
        Of the same motion, or its last steps, for the formulation.
    formulation : Formulation
        Of a problem that may differ in all numbers but the lengths of steps, in its costs and in its path
        constraints.
    """
    programme, problem, at = formulation.programme, formulation.problem, formulation.layout
    first = len(dts) - problem.num_steps
    if first < 0 or carried.meaning != _meaning(formulation):
        return None
    rest, lengths = carried.rest(first), lengths_of_states(problem, at, motion.xs)
    if not (rest.fits(programme) and np.allclose(lengths, dts[first:], rtol=_SAME, atol=_SAME * problem.dt)):
        return None
    iterate = rest.into(programme)
    if not _is_of(iterate, motion, at):
        return None
    unit = problem.dt * iterate.xs[1, at.states["h"]] / dts[first] if "h" in at.states else np.ones(0)
    is_whole = first == 0 and np.allclose(unit, 1.0, rtol=_SAME, atol=0.0)
    xs = np.vstack([programme.x_start, iterate.xs[1:]]) if is_whole else motion.xs
    us = iterate.us if is_whole else motion.us
    return replace(_in_units(iterate, at, unit, len(dts)), xs=frozen_array(xs), us=frozen_array(us))


def _is_of(iterate: Iterate, motion: Iterate, at: StateLayout) -> bool:
    """Whether an iterate has a motion, whose arrays somebody may have changed."""
    places, own = slice(0, at.nz + at.ns), slice(0, at.num_own)
    found = at.controls.get("found", slice(0))
    pairs = [(iterate.us[:, part], motion.us[:, part]) for part in (own, found)]
    pairs.append((iterate.xs[1:, places], motion.xs[1:, places]))
    return all(
        np.abs(one - other).max(initial=0.0) <= _SAME_MOTION * (1.0 + np.abs(one).max(initial=0.0))
        for one, other in pairs
    )


def _in_units(iterate: Iterate, at: StateLayout, unit: Array, steps: int) -> Iterate:
    """The iterate with multipliers for a unit of lengths that is so many times the one it had."""
    units = {"h": unit, "t": unit * len(iterate.ms) / steps}
    ms, bounds = np.array(iterate.ms), iterate.bounds
    for name in units.keys() & at.states.keys():
        ms[:, at.rows[name]] *= units[name]
        if bounds is not None:
            lam_xs = np.array(bounds.xs)
            lam_xs[:, at.states[name]] *= units[name]
            bounds = replace(bounds, xs=lam_xs)
    return replace(iterate, ms=ms, bounds=bounds)


def _meaning(formulation: Formulation) -> str:
    """Digest of what unknowns and multipliers are."""
    problem = formulation.problem
    ends = [problem.num_steps - run.last for run in problem.timeline.free_phases]
    material = json.dumps([formulation.pieces.signature.unknowns, problem.scheme, ends])
    return hashlib.sha256(material.encode()).hexdigest()


def with_robot_of(formulation: Formulation, motion: Motion) -> Formulation:
    """Return it with the robot of a motion; its programme and all else of the problem stay as they are."""
    if not formulation.problem.parameter:
        return formulation
    return replace(formulation, problem=_put_found(formulation.problem, motion.found))


def _put_found(problem: Problem, values: Array) -> Problem:
    names = [one.name for one in problem.parameter]
    return problem.with_found(dict(zip(names, values.tolist(), strict=True)))
