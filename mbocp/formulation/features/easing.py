"""Problems whose cost is effort alone, and the weight on velocities that makes them easier.

Where nothing but effort costs, light links spin for next to nothing, and there are many minima. With a weight
on velocities there are few, and a motion that is followed while the weight fades leads to a good one of the
many. The functions of such problems know that weight as a parameter, zero, so that nothing compiles twice.
"""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array
from mbocp.problem import Problem
from mbocp.problem.weights import typical_force, velocity_weight
from mbocp.terms.cost import RunningTerm
from mbocp.terms.kinds import Effort, Velocity


def ease_terms(problem: Problem, terms: tuple[RunningTerm, ...]) -> tuple[RunningTerm, ...]:
    """Terms of the running cost that the functions have: the weight of velocities, too, where it may ease.

    Natural coordinates are left out, whose guess is an optimum in joint coordinates, and what has limits;
    robots whose drives prescribe velocities are weighed already.
    """
    is_effort_alone = terms == (Effort(),) and bool(np.any(problem.cost.effort))
    is_free = not (problem.is_bounded or problem.duration_range is not None or problem.robot.drives)
    return (*terms, Velocity()) if is_effort_alone and is_free and problem.coordinates == "joint" else terms


def choose_easing_weights(problem: Problem, terms: tuple[RunningTerm, ...]) -> Array | None:
    """Weights on velocities that may ease a problem, shape (nv,): those of `"auto"`, for its effort.

    None where the problem has weights of its own, or its functions know none.
    """
    if terms != (Effort(), Velocity()) or np.any(problem.cost.velocity):
        return None
    goal, duration = problem.goal, problem.duration
    ends = (problem.q_start, problem.v_start, goal.q, goal.q_active)
    weights = velocity_weight(problem.robot, typical_force(problem.robot, *ends, duration), duration)
    efforts = np.asarray(problem.cost.effort)
    return float(efforts[efforts > 0.0].mean()) * weights
