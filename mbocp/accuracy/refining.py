r"""Steps that an accuracy asks for: solve, estimate, refine where it is needed.

Each round solves with some steps, and again with each of them halved. The difference of the costs tells the
error of the finer, see `mbocp.accuracy.costs`. Where controls are constant, and for schemes of order four and
more, the error is taken to be at least what the ramps of the controls say, see `mbocp.accuracy.mesh`:
differences of costs may cancel. Where controls vary within steps, steps have shares in it as in the local
errors. Local errors are those of `mbocp.accuracy.errors`. Where either is too large, `mbocp.accuracy.mesh`
says which steps would do, and the next round begins from the interpolated motion. Where both seem to be small
enough, coarser steps are solved, too, and the order is the one that is seen. Lengths of steps are parameters,
and functions are those of one step: after the first solve nothing is compiled.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from mbocp._arrays import Array
from mbocp.accuracy.costs import cost_error
from mbocp.accuracy.errors import local_errors
from mbocp.accuracy.mesh import Wanted, control_shares
from mbocp.accuracy.meshes import MOST_STEPS, Mesh, first_mesh
from mbocp.accuracy.of_solution import motion_of, with_accuracy
from mbocp.integrators import SCHEMES, cost_order
from mbocp.problem import Problem
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.named_phase import phase_nodes
from mbocp.solution import Phase, Solution
from mbocp.solution.later import retold
from mbocp.solvers import Status

__all__ = ["refined"]

Work: TypeAlias = Callable[[Problem, Solution | None], Solution]

_ROUNDS = 8
_MORE = 4  # times as many steps where the first do not lead to a motion
_AIM_STEP, _AIM_COST = 0.5, 0.6  # of what is asked: errors of the next round are not known exactly
_SURE = 1.2  # what the estimate of the cost's error may be wrong by
_CHECKS, _CHECKS_ROUGH = 1, 2  # solves with fewer steps, by which orders are seen
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
            found = _Round.of(problem, mesh.halved().of(problem), pair, deadline=deadline)
            checks = _coarser(problem, mesh, found.solution, work) if found.is_enough(problem) else []
            taken += sum(solution.iterations for solution in checks)
            rounds.append(found.seen_with(problem, checks))
            if rounds[-1].is_enough(problem):
                break
            if checks and checks[-1].status in (Status.INTERRUPTED, Status.TIME_LIMIT):
                failed = checks[-1]
                break
            mesh, before = rounds[-1].next_mesh(problem, mesh), found.solution
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
    """A solution, its local errors (N,) [rad, m], and the error of its cost as a share of it.

    `solved` is the problem with its steps. `costs` are those with fewer steps and with these, coarse to fine,
    each with twice as many as before.
    """

    solved: Problem
    solution: Solution
    errors: Array
    costs: tuple[float, ...]
    guess_used: str
    cost_error: float = math.inf

    @classmethod
    def of(cls, problem: Problem, solved: Problem, pair: Sequence[Solution], *, deadline: float) -> _Round:
        fine, costs = pair[-1], tuple(solution.cost for solution in pair)
        errors = local_errors(solved.robot, motion_of(fine), table=solved.switches, deadline=deadline)
        found = cls(solved, fine, errors, costs, pair[0].guess_used)
        return replace(found, cost_error=found._told(problem))

    def seen_with(self, problem: Problem, coarser: Sequence[Solution]) -> _Round:
        """The same with costs of coarser steps, fine to coarse.

        Steps that are too coarse to be solved leave the order unknown: errors are then as if it were one.
        """
        if not coarser:
            return self
        more = [solution.cost if solution.is_stationary else math.nan for solution in coarser]
        found = replace(self, costs=(*more[::-1], *self.costs))
        return replace(found, cost_error=found._told(problem))

    def _told(self, problem: Problem) -> float:
        """What its costs say of the error, and its controls."""
        away = cost_error(
            self.costs,
            _sure_order(problem),
            highest=SCHEMES[problem.scheme].order,
            is_smooth=not _is_rough(problem),
        )
        if _sums_up(problem):
            away = max(away, float(self._shares(problem).sum()))
        cost = self.solution.cost
        return away / abs(cost) if cost else (math.inf if away else 0.0)

    def _shares(self, problem: Problem) -> Array:
        """Shares of steps in the error of the cost; local errors where constant controls do not make it."""
        if _cost_order(problem) == 1 or problem.controls != "constant":
            return np.where(np.isfinite(self.errors), self.errors, 1.0)
        us, dts = self.solution.us, np.diff(self.solution.t)
        effort = np.broadcast_to(problem.cost.effort, us.shape[1:])
        weights = np.where(effort > 0.0, effort, 0.0) if np.any(effort) else np.ones(effort.shape)
        found = np.zeros(len(dts))
        for first, last in phase_nodes(self.solved.phase).values() or [(0, len(dts))]:
            own = first + np.flatnonzero(dts[first:last])  # controls may leap where phases end
            found[own] = control_shares(us[own], dts[own], weights)
        return found

    def is_enough(self, problem: Problem) -> bool:
        asked = _asked(problem)
        return bool(self.errors.max() <= asked and _SURE * self.cost_error <= asked)

    def next_mesh(self, problem: Problem, mesh: Mesh) -> Mesh:
        """The coarser steps of the next round."""
        asked, fine = _asked(problem), self.solution
        goes = np.diff(fine.t) > 0.0  # impacts and partings do not
        dts, errors, shares = (x[goes] for x in (np.diff(fine.t), self.errors, self._shares(problem)))
        error = self.cost_error * abs(fine.cost)
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
        found = mesh.next(dts, errors, shares, wanted)
        is_stuck = len(self.costs) > 2 and found.num_steps <= mesh.num_steps
        return mesh.halved() if is_stuck else found


def _asked(problem: Problem) -> float:
    return math.nan if problem.accuracy is None else problem.accuracy


def _cost_order(problem: Problem) -> int:
    return cost_order(problem.controls, problem.scheme)


def _sure_order(problem: Problem) -> int:
    """Order of which the cost can be sure: one where controls leap at times that are found."""
    leaps = problem.has_free_lengths and problem.widest_limits.any_finite
    return 1 if leaps else _cost_order(problem)


def _is_rough(problem: Problem) -> bool:
    """Whether errors of the motion are of the size of those of constant controls, so that they may cancel.

    So they are by the midpoint rule where velocities of what is held alternate.
    """
    return problem.switches is not None or not COORDINATES[problem.coordinates].has_joint_states


def _sums_up(problem: Problem) -> bool:
    """Whether the shares of the steps are the error of the cost, to leading order."""
    is_ramp = problem.controls == "constant"
    return is_ramp and SCHEMES[problem.scheme].order >= 4 and not problem.inequalities


def _coarser(problem: Problem, mesh: Mesh, fine: Solution, work: Work) -> list[Solution]:
    """Solutions with fewer steps, by which orders are seen, fine to coarse."""
    found = list[Solution]()
    for _ in range(_CHECKS_ROUGH if _is_rough(problem) else _CHECKS):
        mesh = mesh.coarser()
        found.append(work(mesh.of(problem), fine))
        if not found[-1].is_stationary:
            break
    return found


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
    solution = with_accuracy(last.solved, last.solution, deadline)
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
