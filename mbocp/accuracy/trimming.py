"""As few steps as an accuracy needs, once it is reached: errors just below what was asked for.

What the cost tends to is known from the rounds of a search, and so is where errors are. So any other steps
are judged by one solve: their cost against that limit, and what it is unsure by. From the motion that was
found they take a few iterations. Their number is what the errors of the last round ask for; where they come
out otherwise, it is corrected by the ratio.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from mbocp.accuracy.meshes import Mesh
from mbocp.accuracy.rounds import Round, asked_of, step_errors_of
from mbocp.solution import Solution
from mbocp.solvers.strategies.cost_unit import is_no_cost

_Solve: TypeAlias = Callable[[Mesh, Solution], Solution]

_TRIES = 3
_AIM_STEP, _AIM_COST = 0.9, 0.99  # of what is asked
_WORTH, _WORTH_MORE = 0.99, 0.95  # of the steps: fewer, or the first solve and others win nothing
_MOST_CHANGE = 2.0  # of what is aimed at, from one try to the next


def trim(found: Round, mesh: Mesh, solve: _Solve, deadline: float) -> Round:
    """Look for fewer steps that have what was asked for, too; return their round, or the one that is known.

    Parameters
    ----------
    found : Round
        With what was asked for.
    mesh : Mesh
        Its coarser steps.
    solve : callable
        Solves with other steps, from a solution.
    deadline : float
        Time of `time.perf_counter` after which no solve begins.
    """
    asked, best, worth = asked_of(found.problem), found, _WORTH
    most, before = _most(found), None
    step, cost = _AIM_STEP * asked, _AIM_COST * most
    for _ in range(_TRIES):
        fewer = found.fewest(mesh, step, cost) if cost > 0.0 else mesh.halve()
        is_late = time.perf_counter() > deadline
        if is_late or fewer == before or fewer.num_steps > worth * len(best.solution.us):
            break
        solution = solve(fewer, best.solution)
        if not solution.is_stationary:
            break
        one, before = _judge(found, fewer, solution, deadline), fewer
        if one.is_enough:
            best, worth = one, _WORTH_MORE
        away, local = abs(solution.cost - found.limit.value), float(one.errors.largest.max())
        cost *= _correct(_AIM_COST * most, away)
        step *= _correct(_AIM_STEP * asked, local)
    return best


def _most(found: Round) -> float:
    """What a cost may be away from the limit at most, in its unit."""
    cost = found.solution.cost
    return math.inf if is_no_cost(cost) else asked_of(found.problem) * abs(cost) - found.limit.unsure


def _judge(found: Round, mesh: Mesh, solution: Solution, deadline: float) -> Round:
    """A solution with other steps, its cost against what those of the round tend to."""
    solved = mesh.of(found.problem)
    return replace(
        found,
        solved=solved,
        solution=solution,
        errors=step_errors_of(solved, solution, deadline=deadline),
        error=found.limit.error_of(solution.cost),
        sure=1.0,
    )


def _correct(aim: float, came_to: float) -> float:
    """Factor for what is aimed at next, where the last aim came to something else."""
    ratio = aim / came_to if came_to > 0.0 else _MOST_CHANGE
    return float(np.clip(ratio, 1.0 / _MOST_CHANGE, _MOST_CHANGE))
