"""Which of several outcomes is the better one."""

from __future__ import annotations

from dataclasses import replace

from mbocp.formulation import Formulation
from mbocp.formulation.end_reached import miss_of_end
from mbocp.formulation.iterates import with_robot_of
from mbocp.formulation.read_trajectory import describe_coarse_turn
from mbocp.solvers import Outcome, SolverResult, Status

SAME_COST = 1e-9  # relative: the same minimum, and the earlier start has found it


def is_preferred(formulation: Formulation, new: Outcome, known: tuple[Formulation, Outcome]) -> bool:
    """Whether an outcome is better than one that is known, of the same problem or with another goal.

    The cheapest that converged, motions that the steps resolve first.
    """
    old = known[1]
    ranks = _rank(formulation, new), _rank(*known)
    if ranks[0] != ranks[1]:
        return ranks[0] < ranks[1]
    if new.result.status is not Status.CONVERGED:
        return is_better(new.result, old.result)
    cost, least = new.result.record.cost, old.result.record.cost
    return cost < least - SAME_COST * abs(least)


def status_of(formulation: Formulation, outcome: Outcome) -> Status:
    """Status of an outcome; `under_resolved` where it converged to what is no motion any more."""
    result = outcome.result
    if result.status is not Status.CONVERGED:
        return result.status
    is_resolved = describe_coarse_turn(formulation, formulation.motion_of(result.iterate)) is None
    return Status.CONVERGED if is_resolved else Status.UNDER_RESOLVED


def with_end(formulation: Formulation, outcome: Outcome) -> Outcome:
    """Outcome that says so where it ends beside the goal; at another root it has not converged."""
    result = outcome.result
    if result.status is not Status.CONVERGED:
        return outcome
    motion = formulation.motion_of(result.iterate)
    missed = miss_of_end(with_robot_of(formulation, motion), motion.qs)
    if missed is None:
        return outcome
    status = Status.OTHER_ROOT if missed.is_other_root else result.status
    return replace(outcome, result=replace(result, status=status, advice=f"{result.advice}; {missed.words}"))


def is_better(new: SolverResult, old: SolverResult) -> bool:
    """Whether one of two results that have not converged says more: another root, then `infeasible`."""
    if Status.OTHER_ROOT in (new.status, old.status):
        return old.status is not Status.OTHER_ROOT
    if old.status is Status.INFEASIBLE:
        return False
    return new.record.residual < old.record.residual


def _rank(formulation: Formulation, outcome: Outcome) -> int:
    return {Status.CONVERGED: 0, Status.UNDER_RESOLVED: 1}.get(status_of(formulation, outcome), 2)
