r"""Steps that an accuracy asks for: solve, estimate, refine where it is needed.

Each round solves with some steps, and again with each of them halved. The difference of the costs tells the
error of the finer, by Richardson: :math:`|J_h - J_{h/2}| / (2^q - 1)`, with the order q of the cost: of
controls that are constant in each step two at most, of linear ones four, and of controls with a value at each
stage that of the scheme. Where controls are constant, and for schemes of order four and more, the error is
taken to be at least what the ramps of the controls say, see `mbocp.accuracy.mesh`: differences of costs may
cancel. Where controls vary within steps, steps have shares in it as in the local errors. Local
errors are those of `mbocp.accuracy.errors`. Where either is too large, `mbocp.accuracy.mesh` says which steps
would do, and the next round begins from the interpolated motion. Lengths of steps are parameters, and
functions are those of one step: after the first solve nothing is compiled.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from mbocp._arrays import Array
from mbocp.accuracy.errors import local_errors
from mbocp.accuracy.mesh import Wanted, control_shares
from mbocp.accuracy.meshes import MOST_STEPS, Mesh, first_mesh
from mbocp.accuracy.of_solution import motion_of, with_accuracy
from mbocp.integrators import SCHEMES, cost_order
from mbocp.problem import Problem
from mbocp.solution import Phase, Solution
from mbocp.solution.later import retold
from mbocp.solvers import Status

__all__ = ["refined"]

Work: TypeAlias = Callable[[Problem, Solution | None], Solution]

_ROUNDS = 8
_MORE = 4  # times as many steps where the first do not lead to a motion
_AIM_STEP, _AIM_COST = 0.5, 0.6  # of what is asked: errors of the next round are not known exactly
_SURE = 1.2  # what the estimate of the cost's error may be wrong by
_CALIBRATED = 20.0  # times what the shares say, where differences of costs say more


def refined(
    problem: Problem, warm_start: Solution | None, work: Work, deadline: float = math.inf
) -> Solution:
    """Solution with as many steps as the accuracy of a problem asks for.

    Parameters
    ----------
    problem : Problem
        With `accuracy`.
    warm_start : Solution, optional
    work : callable
        Solves a problem, from a solution or from the problem's guess.
    deadline : float
        Time of `time.perf_counter` after which no round begins.

    Returns
    -------
    Solution
        `Solution.accuracy` has what was asked for and what was reached. Where it was not reached within the
        rounds, the time or the most steps, the status is `under_resolved`.
    """
    begun, rounds, failed, taken = time.perf_counter(), list[_Round](), None, 0
    mesh, before = first_mesh(problem), warm_start
    for _ in range(_ROUNDS):
        pair = _pair(problem, mesh, before, work)
        taken += sum(solution.iterations for solution in pair)
        if pair[-1].is_stationary:
            rounds.append(_Round.of(problem, *pair, deadline=deadline))
            if rounds[-1].is_enough(problem):
                break
            mesh, before = rounds[-1].next_mesh(problem, mesh), rounds[-1].solution
        else:
            failed = pair[-1]
            if rounds or failed.status in (Status.INTERRUPTED, Status.TIME_LIMIT):
                break
            mesh, before = mesh.even(_MORE), None
        if 2 * mesh.num_steps > MOST_STEPS or time.perf_counter() > deadline:
            break
    if not rounds and failed is not None:
        return failed
    solution = _told(problem, rounds, failed, deadline)
    more, spent = taken - solution.iterations, time.perf_counter() - begun - solution.wall_time_s
    phases = (Phase("coarser steps", more, spent), *solution.phases)
    wall_time_s = solution.wall_time_s + spent
    return retold(solution, iterations=taken, phases=phases, wall_time_s=wall_time_s)


@dataclass(frozen=True, eq=False)
class _Round:
    """A solution, its local errors (N,) [rad, m], and the error of its cost as a share of it."""

    solution: Solution
    errors: Array
    cost_error: float
    guess_used: str

    @classmethod
    def of(cls, problem: Problem, coarse: Solution, fine: Solution, *, deadline: float) -> _Round:
        errors = local_errors(problem.robot, motion_of(fine), deadline=deadline)
        away = abs(coarse.cost - fine.cost) / (2.0 ** _sure_order(problem) - 1.0)
        if _sums_up(problem):
            away = max(away, float(_shares(problem, fine, errors).sum()))
        share = away / abs(fine.cost) if fine.cost else (math.inf if away else 0.0)
        return cls(fine, errors, share, coarse.guess_used)

    def is_enough(self, problem: Problem) -> bool:
        asked = _asked(problem)
        return bool(self.errors.max() <= asked and _SURE * self.cost_error <= asked)

    def next_mesh(self, problem: Problem, mesh: Mesh) -> Mesh:
        """The coarser steps of the next round."""
        asked, fine, dts = _asked(problem), self.solution, np.diff(self.solution.t)
        shares, error = _shares(problem, fine, self.errors), self.cost_error * abs(fine.cost)
        told = float(shares.sum())
        if not told > 0.0:
            shares, told = dts, float(dts.sum())
        if math.isfinite(error):
            most = _CALIBRATED if _sums_up(problem) else math.inf
            shares = shares * min(error / told, most)
        wanted = Wanted(
            _AIM_STEP * asked,
            SCHEMES[problem.scheme].order,
            _AIM_COST * asked * abs(fine.cost),
            _cost_order(problem),
        )
        return mesh.next(dts, self.errors, shares, wanted)


def _asked(problem: Problem) -> float:
    return math.nan if problem.accuracy is None else problem.accuracy


def _cost_order(problem: Problem) -> int:
    return cost_order(problem.controls, problem.scheme)


def _sure_order(problem: Problem) -> int:
    """Order of which the cost can be sure: one where controls leap at times that are found."""
    leaps = problem.has_free_lengths and problem.widest_limits.any_finite
    return 1 if leaps else _cost_order(problem)


def _sums_up(problem: Problem) -> bool:
    """Whether the shares of the steps are the error of the cost, to leading order."""
    is_ramp = problem.controls == "constant"
    return is_ramp and SCHEMES[problem.scheme].order >= 4 and not problem.inequalities


def _shares(problem: Problem, solution: Solution, errors: Array) -> Array:
    """Shares of the steps in the error of the cost; local errors where constant controls do not make it."""
    if _cost_order(problem) == 1 or problem.controls != "constant":
        return np.where(np.isfinite(errors), errors, 1.0)
    effort = np.broadcast_to(problem.cost.effort, solution.us.shape[1:])
    weights = np.where(effort > 0.0, effort, 0.0) if np.any(effort) else np.ones(effort.shape)
    return control_shares(solution.us, np.diff(solution.t), weights)


def _pair(problem: Problem, mesh: Mesh, before: Solution | None, work: Work) -> list[Solution]:
    """Solutions with steps and with their halves; the first alone if it fails."""
    pair: list[Solution] = []
    for steps in (mesh, mesh.halved()):
        stepped = steps.of(problem)
        found = work(stepped, before)
        if not found.is_stationary and before is not None and found.status is not Status.INTERRUPTED:
            found = work(stepped, None)
        pair.append(found)
        before = found
        if not found.is_stationary:
            break
    return pair


def _told(problem: Problem, rounds: list[_Round], failed: Solution | None, deadline: float) -> Solution:
    """The last solution with what is known of it."""
    last, asked = rounds[-1], _asked(problem)
    solution = with_accuracy(problem, last.solution, deadline)
    accuracy = replace(solution.accuracy, asked=asked, cost_error=last.cost_error, rounds=len(rounds))
    solution = retold(solution, accuracy=accuracy, guess_used=rounds[0].guess_used)
    if last.is_enough(problem):
        return solution
    why = (
        f"with finer ones: {failed.advice}"
        if failed is not None
        else "there are no more rounds, steps or time"
    )
    status = (
        failed.status if failed is not None and failed.status is Status.INTERRUPTED else Status.UNDER_RESOLVED
    )
    words = (
        f"horizon.accuracy = {asked:g} is not reached: with {solution.num_steps} steps one is wrong by "
        f"{last.errors.max():.2g} at most, the cost by {last.cost_error:.2g} of it; {why}"
    )
    return retold(solution, status=status, advice=f"{words}; {solution.advice}")
