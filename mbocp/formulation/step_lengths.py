r"""Steps of free length: the length is part of the state, and one more control sets it.

With h the step length in units of its guess, and a stage parameter e that is 1 in the first step of a phase
and 0 elsewhere,

.. math:: h_{k+1} = h_k + e_k w_k, \qquad \Delta t_k = \Delta t_{guess}\, (h_k + e_k w_k), \qquad h_0 = 1.

So all steps of a phase are as long as each other, and the programme stays one of stages: no solver has to
know. Where e is 0 nothing depends on the control w. Half its square is added to the cost there, which is zero
at the optimum. Bounds keep h_1 positive, and the rows above the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.layout import StateLayout
from mbocp.problem import Problem
from mbocp.programme import Iterate

__all__ = [
    "begins_phase",
    "given_lengths",
    "length_bounds",
    "lengths_of_states",
    "solved_lengths",
    "with_lengths",
    "without_lengths",
]


def begins_phase(num_steps: int, starts: Sequence[int] = (0,)) -> Array:
    """Parameter e of every step, shape (N,), from the first steps of the phases."""
    e = np.zeros(num_steps)
    e[list(starts)] = 1.0
    return e


def length_bounds(problem: Problem) -> tuple[Array, Array]:
    """Lower and upper bounds of h, shape (nh,)."""
    if problem.duration_range is None:
        return np.zeros(0), np.zeros(0)
    lower, upper = problem.duration_range
    return np.array([lower / problem.duration]), np.array([upper / problem.duration])


def given_lengths(problem: Problem) -> Array:
    """Step lengths [s] of a problem, or their guess, shape (N,)."""
    return np.full(problem.num_steps, problem.dt)


def solved_lengths(problem: Problem, at: StateLayout, iterate: Iterate) -> Array:
    """Step lengths [s] of an iterate, shape (N,)."""
    return lengths_of_states(problem, at, iterate.xs)


def lengths_of_states(problem: Problem, at: StateLayout, xs: Array) -> Array:
    """Step lengths [s] that states (N + 1, nx) say, shape (N,)."""
    return problem.dt * xs[1:, at.h][:, 0] if at.nh else given_lengths(problem)


def with_lengths(problem: Problem, at: StateLayout, xs: Array, us: Array, dts: Array) -> tuple[Array, Array]:
    """States and controls with those of the step lengths [s], which are taken into their bounds."""
    if not at.nh:
        return xs, us
    lower, upper = length_bounds(problem)
    h = np.append(1.0, np.clip(dts / problem.dt, lower[0], upper[0]))
    filled = np.array(xs)
    filled[:, at.h] = h[:, None]
    return filled, np.column_stack([us, np.diff(h)])


def without_lengths(at: StateLayout, us: Array) -> Array:
    """Controls of the robot among those of the programme."""
    return us[:, : us.shape[1] - at.nh]
