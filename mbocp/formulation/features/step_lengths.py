r"""Steps of free length: the length is part of the state, and one more control sets it.

With h the step length in units of the mean one that was guessed, and a stage parameter e that is 1 in the
first step of a phase and 0 elsewhere,

.. math:: h_{k+1} = h_k + e_k w_k, \qquad \Delta t_k = \Delta t_{guess}\, (h_k + e_k w_k), \qquad h_0 = 1.

So all steps of a phase are as long as each other, and the programme stays one of stages: no solver has to
know. Where e is 0 nothing depends on the control w. Half its square is added to the cost there, which is zero
at the optimum. Bounds keep the length of every phase positive, at its first step: the others repeat it.

Where there are several phases the state has a clock, too, the time in units of the guessed duration,

.. math:: \theta_{k+1} = \theta_k + (h_k + e_k w_k) / N, \qquad \theta_0 = 0,

and times at the ends of phases have bounds. Equal ones give a time: that of the end, where the duration is
given. Where all lengths are given and differ, they are parameters of the stages, and states hold none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.features.switches import impacts_of
from mbocp.formulation.layout import StateLayout
from mbocp.problem import Problem
from mbocp.problem.timeline.phases import step_lengths
from mbocp.programme import Iterate

__all__ = [
    "LengthBounds",
    "begins_phase",
    "given_lengths",
    "length_bounds",
    "length_controls",
    "lengths_of_states",
    "phase_starts",
    "solved_lengths",
    "spacings",
    "start_of_lengths",
    "with_lengths",
    "without_lengths",
]


def begins_phase(num_steps: int, starts: Sequence[int] = (0,)) -> Array:
    """Parameter e of every step, shape (N,), from the first steps of the phases."""
    e = np.zeros(num_steps)
    e[list(starts)] = 1.0
    return e


def phase_starts(problem: Problem) -> tuple[int, ...]:
    """First steps of the phases of a problem; the first one where lengths are given."""
    return tuple(phase.first for phase in problem.phases) or (0,)


@dataclass(frozen=True, eq=False)
class LengthBounds:
    """Bounds of lengths and times at nodes 1..N; infinite where there is none.

    Attributes
    ----------
    h_lower, h_upper : ndarray, shape (N,)
        Of the length of the step that leads to the node, in units of the guessed one.
    t_lower, t_upper : ndarray, shape (N,)
        Of the time, in units of the guessed duration.
    """

    h_lower: Array
    h_upper: Array
    t_lower: Array
    t_upper: Array


def length_bounds(problem: Problem) -> LengthBounds:
    """Bounds of the lengths of steps and of the times of nodes."""
    N, dt, T = problem.num_steps, problem.dt, problem.duration
    none = np.full(N, np.inf)
    found = LengthBounds(-none, none.copy(), -none, none.copy())
    for phase in problem.phases:
        begins, ends = phase.first, phase.last - 1
        found.h_lower[begins] = phase.shortest / (phase.num_steps * dt)
        found.h_upper[begins] = phase.longest / (phase.num_steps * dt)
        if phase.earliest > 0.0:
            found.t_lower[ends] = phase.earliest / T
        found.t_upper[ends] = phase.latest / T
    return found


def given_lengths(problem: Problem) -> Array:
    """Step lengths [s] of a problem, or their guess, shape (N,)."""
    return step_lengths(problem)


def spacings(lengths: Array) -> Array:
    """From the middle of the step before to that of each step [s], shape (N,); of the first its length."""
    return np.append(lengths[:1], (lengths[:-1] + lengths[1:]) / 2.0)


def solved_lengths(problem: Problem, at: StateLayout, iterate: Iterate) -> Array:
    """Step lengths [s] of an iterate, shape (N,)."""
    return lengths_of_states(problem, at, iterate.xs)


def lengths_of_states(problem: Problem, at: StateLayout, xs: Array) -> Array:
    """Step lengths [s] that states (N + 1, nx) say, shape (N,)."""
    if not at.nh:
        return given_lengths(problem)
    return np.where(impacts_of(problem), 0.0, problem.dt * xs[1:, at.h][:, 0])


def start_of_lengths(at: StateLayout) -> Array:
    """Length and time with which states begin, shape (nh + nt,)."""
    return np.concatenate([np.ones(at.nh), np.zeros(at.nt)])


def with_lengths(problem: Problem, at: StateLayout, xs: Array, us: Array, dts: Array) -> tuple[Array, Array]:
    """States and controls with those of the step lengths [s], which are taken into their bounds."""
    if not at.nh:
        return xs, us
    h = _phase_lengths(problem, dts)
    filled = np.array(xs)
    filled[:, at.h] = h[:, None]
    if at.nt:
        goes = ~impacts_of(problem)
        filled[:, at.t] = np.append(0.0, np.cumsum(goes * h[1:]) / problem.num_timed_steps)[:, None]
    return filled, np.column_stack([us, np.diff(h)])


def length_controls(problem: Problem, at: StateLayout) -> Array:
    """Controls w with which steps have the lengths that were guessed, shape (N, nh)."""
    if not at.nh:
        return np.zeros((problem.num_steps, 0))
    return np.diff(_phase_lengths(problem, given_lengths(problem)))[:, None]


def _phase_lengths(problem: Problem, dts: Array) -> Array:
    """Lengths h of all nodes, shape (N + 1,): the mean of each phase, within bounds."""
    dt, phases, bounds = problem.dt, problem.phases, length_bounds(problem)
    starts, counts = [p.first for p in phases], np.array([p.num_steps for p in phases])
    durations = np.add.reduceat(dts, starts)
    if len(phases) > 1:
        whole = float(durations.sum())
        durations *= min(max(whole, phases[-1].earliest), phases[-1].latest) / whole
    lengths = np.clip(durations / (counts * dt), bounds.h_lower[starts], bounds.h_upper[starts])
    return np.append(1.0, np.repeat(lengths, [p.last - p.first for p in phases]))


def without_lengths(at: StateLayout, us: Array) -> Array:
    """Controls of the robot among those of the programme."""
    return us[:, : us.shape[1] - at.num_more_controls]
