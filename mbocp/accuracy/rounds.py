r"""Rounds of a search for steps: a solution, the errors of its steps and of its cost, and the steps after it.

Differences of the costs of fewer steps tell the error of the cost, see `mbocp.accuracy.costs`. Where
controls are constant, and for schemes of order four and more, the error is taken to be at least what the
ramps of the controls say, see `mbocp.accuracy.mesh`: differences of costs may cancel. Where controls vary
within steps, steps have shares in it as in what their local errors, weighed with the adjoints, change the
cost by.

Where such controls keep a velocity or a position at its limit, costs are taken to be of order one, and the
last of them is what is known best.

The error is a part of the cost. Where the least cost is zero there is no such part, and what is left of it is
the square of round-off: nothing is asked of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.accuracy.costs import CostLimit, cost_error, cost_limit
from mbocp.accuracy.errors import StepErrors, step_errors
from mbocp.accuracy.mesh import ErrorTargets, Mesh, control_shares
from mbocp.accuracy.solution_accuracy import motion_of
from mbocp.integrators import SCHEMES, cost_order
from mbocp.problem import Problem
from mbocp.problem.coordinates import COORDINATES
from mbocp.solution import Solution
from mbocp.solvers.strategies.in_units import is_no_cost

_AIM_STEP, _AIM_COST = 0.5, 0.6  # of what is asked: errors of the next round are not known exactly
_OF_STATES = ("position", "velocity")
_OF_JOINTS = "lobatto3"  # holds loops, too
_SURE = 1.2  # what the estimate of the cost's error may be wrong by
_CALIBRATED = 20.0  # times what the shares say, where differences of costs say more


@dataclass(frozen=True, eq=False)
class Round:
    """A solution, the errors of its steps, and the error of its cost.

    Attributes
    ----------
    problem, solved : Problem
        With its accuracy, and with its steps.
    solution : Solution
    errors : StepErrors
    costs : tuple of float
        Those with fewer steps and with these, coarse to fine, each with twice as many as before.
    guess_used : str
    limit : CostLimit
        What the costs tend to.
    error : float
        Of the cost, in its unit.
    sure : float
        What that may be wrong by, as a factor.
    """

    problem: Problem
    solved: Problem
    solution: Solution
    errors: StepErrors
    costs: tuple[float, ...]
    guess_used: str
    limit: CostLimit
    error: float
    sure: float = _SURE

    @classmethod
    def of(cls, problem: Problem, solved: Problem, pair: Sequence[Solution], *, deadline: float) -> Round:
        """The finer of two solutions, with what the coarser tells of it."""
        fine, costs = pair[-1], tuple(solution.cost for solution in pair)
        errors = step_errors_of(solved, fine, deadline=deadline)
        unknown = CostLimit(fine.cost, math.inf)
        return cls(problem, solved, fine, errors, costs, pair[0].guess_used, unknown, math.inf)._judge()

    def compare_with(self, coarser: Sequence[Solution], before: Round | None) -> Round:
        """The same with costs of coarser steps, fine to coarse, and beside the round before.

        Steps that are too coarse to be solved leave the order unknown: errors are then as if it were one.
        Where the cost was said to be exact enough before, too, but tended to something else, one is wrong.
        """
        if not coarser:
            return self
        more = [solution.cost if solution.is_stationary else math.nan for solution in coarser]
        found = replace(self, costs=(*more[::-1], *self.costs))._judge()
        if before is None or not before.has_cost:
            return found
        limit = found.limit.beside(before.limit)
        return replace(found, limit=limit, error=max(found.error, limit.unsure))

    def beside_joints(self, others: Sequence[Solution]) -> Round:
        """The same with what costs in joint coordinates tend to, fine to coarse; see `is_told_by_joints`."""
        if not others:
            return self
        costs = [one.cost if one.is_stationary else math.nan for one in others][::-1]
        order = _cost_order(self.problem)
        limit = cost_limit(costs, order, cost_error(costs, order))
        return replace(self, limit=limit, error=limit.error_of(self.solution.cost), sure=1.0)

    def _judge(self) -> Round:
        """With what its costs say of the error, and its controls."""
        has_corners = _has_corners(self.problem, self.solution)
        order = 1 if has_corners else _sure_order(self.problem)
        is_smooth = not (has_corners or is_rough(self.problem))
        error = cost_error(self.costs, order, highest=SCHEMES[self.problem.scheme].order, is_smooth=is_smooth)
        if _sums_up(self.problem):
            error = max(error, float(shares_of(self.problem, self.solved, self.solution, self.errors).sum()))
        limit = CostLimit(self.costs[-1], error) if has_corners else cost_limit(self.costs, order, error)
        return replace(self, error=error, limit=limit)

    @property
    def cost_error(self) -> float:
        """Error of the cost as a part of it; zero where there is no cost."""
        return 0.0 if is_no_cost(self.solution.cost) else self.error / abs(self.solution.cost)

    @property
    def has_cost(self) -> bool:
        """Whether its cost is exact enough."""
        return self.sure * self.cost_error <= accuracy_targets(self.problem)

    @property
    def is_enough(self) -> bool:
        """Whether its steps are, too."""
        return bool(self.errors.largest.max() <= accuracy_targets(self.problem)) and self.has_cost

    def next_mesh(self, mesh: Mesh) -> Mesh:
        """The coarser steps of the next round."""
        asked = accuracy_targets(self.problem)
        wanted = self._targets(_AIM_STEP * asked, _AIM_COST * asked * abs(self.solution.cost))
        found = mesh.next(*self._measures(), wanted)
        is_stuck = len(self.costs) > 2 and found.num_steps <= mesh.num_steps
        return mesh.halve() if is_stuck else found

    def fewest(self, mesh: Mesh, step: float, cost: float) -> Mesh:
        """The fewest steps whose errors are these [rad, m] and, of the cost, in its unit."""
        return mesh.fewest(*self._measures(), self._targets(step, cost))

    def _targets(self, step: float, cost: float) -> ErrorTargets:
        cost = math.inf if is_no_cost(self.solution.cost) else cost
        return ErrorTargets(step, SCHEMES[self.problem.scheme].order, cost, _cost_order(self.problem))

    def _measures(self) -> tuple[Array, Array, Array]:
        """Lengths of steps, their errors and shares in that of the cost; impacts and partings have none."""
        fine, shares = self.solution, shares_of(self.problem, self.solved, self.solution, self.errors)
        goes = np.diff(fine.t) > 0.0
        dts, errors, shares = (x[goes] for x in (np.diff(fine.t), self.errors.largest, shares))
        told = float(shares.sum())
        if not told > 0.0:
            shares, told = dts, float(dts.sum())
        if math.isfinite(self.error):
            most = _CALIBRATED if _sums_up(self.problem) else math.inf
            shares = shares * min(self.error / told, most)
        return dts, errors, shares


def step_errors_of(solved: Problem, solution: Solution, *, deadline: float) -> StepErrors:
    """Errors of the steps of a solution."""
    adjoints = solution.mus if solved.timeline.switches is None else None
    return step_errors(
        solved.with_found(solution.parameters).robot,
        motion_of(solution),
        table=solved.timeline.switches,
        adjoints=adjoints,
        deadline=deadline,
    )


def shares_of(problem: Problem, solved: Problem, solution: Solution, errors: StepErrors) -> Array:
    """Shares of steps in the error of the cost, shape (N,).

    Those of local errors where it is not constant controls that make it.
    """
    if _cost_order(problem) == 1 or problem.controls != "constant":
        found = errors.largest if _cost_order(problem) == 1 else errors.costs
        return np.where(np.isfinite(found), found, 1.0)
    us, dts = solution.us, np.diff(solution.t)
    effort = np.broadcast_to(problem.cost.effort, us.shape[1:])
    weights = np.where(effort > 0.0, effort, 0.0) if np.any(effort) else np.ones(effort.shape)
    shares = np.zeros(len(dts))
    for first, last in [(phase.first, phase.last) for phase in solved.phase] or [(0, len(dts))]:
        own = first + np.flatnonzero(dts[first:last])  # controls may leap where phases end
        shares[own] = control_shares(us[own], dts[own], weights)
    return shares


def accuracy_targets(problem: Problem) -> float:
    """What is asked for [rad, m; part of the cost]; NaN where nothing is."""
    return math.nan if problem.accuracy is None else problem.accuracy


def is_rough(problem: Problem) -> bool:
    """Whether errors of the motion are of the size of those of constant controls, so that they may cancel.

    So they are by the midpoint rule where velocities of what is held alternate.
    """
    return problem.timeline.switches is not None or not COORDINATES[problem.coordinates].has_joint_states


def is_told_by_joints(problem: Problem) -> bool:
    """Whether costs in joint coordinates tell what those of bodies tend to.

    The midpoint rule leaves velocities of bodies across their joints that alternate, and optima make use of
    them. What that changes costs by falls with no order until steps are short: it has other signs with a few
    steps than with many, and is near zero in between.
    """
    return not (COORDINATES[problem.coordinates].has_joint_states or problem.timeline.switches)


def with_joints(problem: Problem) -> Problem:
    """The same in joint coordinates, by a scheme that leaves no such velocities."""
    return problem.with_(coordinates="joint", scheme=_OF_JOINTS)


def _cost_order(problem: Problem) -> int:
    return cost_order(problem.controls, problem.scheme)


def _sure_order(problem: Problem) -> int:
    """Order of which the cost can be sure: one where controls leap at times that are found."""
    leaps = problem.timeline.has_free_lengths and problem.widest_limits.any_finite
    return 1 if leaps else _cost_order(problem)


def _has_corners(problem: Problem, solution: Solution) -> bool:
    """Whether a velocity or position is at its limit while controls vary within steps.

    The motion comes to its limit within some step, early or late as steps happen to lie. Differences of costs
    then have any size and sign: no order is seen in them, and no limit that they tend to.
    """
    if problem.controls == "constant":
        return False
    return any(limit.kind in _OF_STATES for limit in solution.active_limits)


def _sums_up(problem: Problem) -> bool:
    """Whether the shares of the steps are the error of the cost, to leading order."""
    is_ramp = problem.controls == "constant"
    return is_ramp and SCHEMES[problem.scheme].order >= 4 and not problem.inequalities
