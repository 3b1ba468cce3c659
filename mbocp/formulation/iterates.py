"""Iterates of a formulation as starts for others, and back as they were; with the robot that was found."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp.formulation.base import Formulation
from mbocp.formulation.features.memory import rate_shares_at_start
from mbocp.formulation.features.step_lengths import lengths_of_states
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.motion import Motion
from mbocp.problem import Problem
from mbocp.problem.obstacles.reserves import room_of
from mbocp.programme import Iterate
from mbocp.programme.iterate import IterateRecord

_SAME = 1e-9  # relative: multipliers of steps of another length are others
_SAME_MOTION = 1e-3  # of the largest number: rotations that left their group come back to it


def place_iterate(formulation: Formulation, iterate: Iterate) -> IterateRecord:
    """An iterate with all that says where it fits."""
    carried = IterateRecord.of(iterate, formulation.programme)
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


def take_end_of(problem: Problem, carried: IterateRecord) -> Problem:
    """A solution's problem with conditions of the end where its solve chose them."""
    if carried.q_end.size:
        is_reached = not carried.first.size  # of a robot that is found the end is none of the given robot's
        problem = replace(problem, goal=replace(problem.goal, q=carried.q_end, q_is_reached=is_reached))
    if carried.first.size:
        problem = replace(_put_found(problem, carried.first), q_start=carried.q_start)
    return problem


def restore(
    carried: IterateRecord,
    dts: Array,
    motion: Iterate,
    formulation: Formulation,
    nodes: Array,
    *,
    is_later: bool,
) -> Iterate | None:
    """An iterate as it was, or its last steps; of a later part within limits its multipliers with the motion.

    None where unknowns are others, or steps are not about as long.

    Parameters
    ----------
    carried : IterateRecord
    dts : ndarray, shape (M,)
        Lengths of its steps [s].
    motion : Iterate
        Of the same motion, or a later part of it, for the formulation.
    formulation : Formulation
        Of a problem that may differ in all numbers, in its costs and in its path constraints.
    nodes : ndarray, shape (N + 1,)
        Places of those of the motion, in numbers of its own.
    is_later : bool
        Whether the motion begins after its start, or beside it.
    """
    programme, problem, at = formulation.programme, formulation.problem, formulation.layout
    if len(carried.iterate.ms) != len(dts) or carried.meaning != _meaning(formulation):
        return None
    part, lengths = carried.between(nodes), lengths_of_states(problem, at, motion.xs)
    if not part.fits(programme):
        return None
    steps = np.minimum(((nodes[:-1] + nodes[1:]) / 2.0).astype(int), len(dts) - 1)
    iterate, before, first = part.into(programme), dts[steps], int(steps[0])
    is_part = np.allclose(lengths, before, rtol=_SAME, atol=_SAME * problem.dt) and _is_of(
        iterate, motion, at
    )
    is_alike = bool(np.all((lengths <= 2.0 * before) & (before <= 2.0 * lengths)))
    if not (is_part or (is_later and is_alike and iterate.bounds is not None)):
        return None
    unit = problem.dt * iterate.xs[1, at.states["h"]] / before[0] if "h" in at.states else np.ones(0)
    is_whole = is_part and first == 0 and np.allclose(unit, 1.0, rtol=_SAME, atol=0.0)
    xs = np.vstack([programme.x_start, iterate.xs[1:]]) if is_whole else motion.xs
    us = iterate.us if is_whole else motion.us
    iterate = _in_units(
        iterate, at, {**_units_of(iterate, motion, at), "h": unit, "t": unit * len(steps) / len(dts)}
    )
    iterate = _from_start(iterate, formulation) if first else iterate
    return replace(iterate, xs=frozen_array(xs), us=frozen_array(us), is_rest=is_later)


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


def _units_of(iterate: Iterate, motion: Iterate, at: StateLayout) -> dict[str, Array | float]:
    """Unit of accelerations of a motion, see `memory_units`, by that of an iterate of about the same one."""
    if "acceleration" not in at.states:
        return {}
    before, now = (np.linalg.norm(one.xs[1:, at.states["acceleration"]]) for one in (iterate, motion))
    return {"acceleration": before / now} if before and now else {}


def _in_units(iterate: Iterate, at: StateLayout, units: Mapping[str, Array | float]) -> Iterate:
    """The iterate with multipliers for units that are so many times those it had."""
    ms, bounds = np.array(iterate.ms), iterate.bounds
    for name in units.keys() & at.states.keys():
        ms[:, at.rows[name]] *= units[name]
        if bounds is not None:
            lam_xs = np.array(bounds.xs)
            lam_xs[:, at.states[name]] *= units[name]
            bounds = replace(bounds, xs=lam_xs)
    return replace(iterate, ms=ms, bounds=bounds)


def _from_start(iterate: Iterate, formulation: Formulation) -> Iterate:
    """The iterate with multipliers of rates in a first step, which was a later one."""
    problem, ms, bounds = formulation.problem, np.array(iterate.ms), iterate.bounds
    kept = rate_shares_at_start(problem)
    for name in kept.keys() & formulation.layout.rows.keys():
        ms[0, formulation.layout.rows[name]] *= kept[name]
    if bounds is not None:
        path = np.array(bounds.path)
        for limit in problem.rate_limits:
            part = kept.get(limit.term.remembers[-1], 1.0)
            names = {label.name for label in limit.labels}
            path[0, [name in names for name in formulation.programme.path_names]] *= part
        bounds = replace(bounds, path=path)
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
