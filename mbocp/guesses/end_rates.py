"""Velocities at the end, where the configuration of the end is found with the motion.

Which entries of the velocity are conditions of the end follows from the constraints at `goal.q`. Where the
goal does not give every joint, that is a guess, and feet that land, say, stand elsewhere in the end. Where
the chosen entries leave velocities that the constraints allow there, the problem is solved again from where
it is, with conditions on just these: they are numbers of a parameter, and compile nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation import Formulation, formulate
from mbocp.formulation.end_reached import miss_of_rates
from mbocp.programme.iterate import Carried
from mbocp.solvers import Outcome, Status

_ROUNDS = 6  # of solving again: each leaves a tenth or less, since the end moves with the conditions

Again = Callable[[Formulation, Carried], Outcome]


def with_rates_at_end(
    formulation: Formulation, outcome: Outcome, again: Again
) -> tuple[Formulation, Outcome]:
    """Formulation and outcome whose velocities are the goal's at the configuration in which the motion ends.

    Parameters
    ----------
    formulation : Formulation
    outcome : Outcome
        As the solver left it. What has not converged stays as it is, and so does what does not get there,
        and a robot that is found with the motion, of which the end is no configuration of the given one.
    again : callable
        Solves a formulation from an iterate.
    """
    known, shown = formulation, outcome
    for _ in range(_ROUNDS):
        if shown.result.status is not Status.CONVERGED or known.problem.parameter:
            break
        motion = known.motion_of(shown.result.iterate)
        missed = miss_of_rates(known, motion)
        if missed is None or not missed.is_free or missed.is_small:
            formulation, outcome = known, shown  # of use, whatever comes of a further round
        if missed is None or not missed.is_free or known.problem.goal.q_active.all():
            break
        moved = _with_end_at(known, motion.qs[-1])
        if np.array_equal(moved.end_rows.of_joints, known.end_rows.of_joints):
            break
        carried = Carried.of(shown.result.iterate, moved.programme)
        known, shown = moved, _join(shown, again(moved, _fit(carried, moved)))
    return formulation, outcome.with_history(shown.result.history)


def _with_end_at(formulation: Formulation, q: Array) -> Formulation:
    """The same problem, its conditions of the end chosen at another configuration."""
    problem = formulation.problem
    return formulate(replace(problem, goal=replace(problem.goal, q=q, q_is_reached=True)))


def _fit(carried: Carried, formulation: Formulation) -> Carried:
    """With no multiplier of the end: its rows are others."""
    return replace(carried, iterate=replace(carried.iterate, eta=np.zeros(formulation.programme.ng)))


def _join(before: Outcome, after: Outcome) -> Outcome:
    """An outcome with the records of the one before it."""
    return after.with_history((*before.result.history, *after.result.history))
