r"""Lengths of steps: found, as part of the state that one more control sets, or given.

With h the step length in units of the mean one that was guessed, and a stage parameter e that is 1 in the
first step of a phase that takes time and 0 elsewhere,

.. math:: h_{k+1} = h_k + e_k w_k, \qquad \Delta t_k = \Delta t_{guess}\, (h_k + e_k w_k), \qquad h_0 = 1.

So all steps of a phase are as long as each other, and the programme stays one of stages: no solver has to
know. Where e is 0 nothing depends on the control w. Half its square is added to the cost there, which is zero
at the optimum. Bounds keep the length of every phase positive, at its first step: the others repeat it.

Where there are several phases, or obstacles move, the state has a clock, too, the time in units of the
guessed duration,

.. math:: \theta_{k+1} = \theta_k + (h_k + e_k w_k) / N, \qquad \theta_0 = 0,

and times at the ends of phases have bounds. Equal ones give a time: that of the end, where the duration is
given. Where all lengths are given and differ, they are parameters of the stages, and states hold none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.features.changing_constraints import fill_lengths
from mbocp.formulation.features.clock import STEP_SHARE
from mbocp.formulation.features.feature import Feature, StepRequests, infinite_bounds
from mbocp.formulation.layout import Block, StateLayout
from mbocp.formulation.motion import Motion
from mbocp.formulation.steps import StepSymbols
from mbocp.mechanics.motion_rates import spacings
from mbocp.problem import Problem
from mbocp.robot import Label

_BEGINS_PHASE = "begins_phase"  # the stage parameter e
_STRETCH, _SPACING = "stretch", "spacing"  # given length, and way between middles, by the mean length


@dataclass(frozen=True)
class StepLengths(Feature):
    """Lengths of steps that are found with the motion.

    Attributes
    ----------
    has_clock : bool
        Whether states hold the time, too, as they do where there are several lengths or obstacles move.
    has_jerks : bool
        Whether something looks at the length of the step before.
    """

    has_clock: bool = False
    has_jerks: bool = False

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> StepLengths | None:
        """Return it where lengths are free."""
        if not problem.timeline.has_free_lengths:
            return None
        has_clock = problem.timeline.has_free_times or asked.has_movers
        return cls(has_clock, "jerk" in asked.remembers)

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """Length, and time."""
        names = ("h", "t") if self.has_clock else ("h",)
        return tuple(Block(name, 1, is_remembered=False) for name in names)

    def controls(self, nu: int) -> Mapping[str, int]:
        """The change of the length."""
        return {"lengths": 1}

    @property
    def parameters(self) -> Mapping[str, int]:
        """The share of a step in the duration."""
        return {STEP_SHARE: 1} if self.has_clock else {}

    @property
    def stage_parameters(self) -> Mapping[str, int]:
        """Whether a step begins a phase."""
        return {_BEGINS_PHASE: 1}

    @property
    def asks_for_first(self) -> bool:
        """Whether it has to know which step has no spacing."""
        return self.has_clock and self.has_jerks

    @property
    def state_key(self) -> Mapping[str, Any]:
        """That lengths are free, and whether there is a clock; given ones keep their key."""
        return {"has_free_lengths": True, **({"has_clock": True} if self.has_clock else {})}

    def enter(self, at: StepSymbols) -> StepSymbols:
        """Take length and time of the step from the state before it."""
        dt, h0, stretched = at.given["dt"], self._before(at, "h"), self._stretch(at)
        length = stretched * dt
        if not self.has_clock:
            moment = None if at.moment is None else stretched * at.moment
            return replace(at, dt=length, spacing=length, moment=moment)
        moment = self._before(at, "t") * dt / at.given[STEP_SHARE] + at.tau * length
        # From the middle of the step before to the middle of this one; the length of the first step itself.
        between = at.has_before * (h0 + stretched) / 2.0 + (1.0 - at.has_before) * stretched
        return replace(at, dt=length, spacing=between * dt, moment=moment)

    def _before(self, at: StepSymbols, name: str) -> ca.SX:
        return at.at0[at.space.layout.states[name]]

    def _stretch(self, at: StepSymbols) -> ca.SX:
        """h0 + e w; a row of the step makes it equal to h1, but explicit steps know h0 alone."""
        return self._before(at, "h") + at.given[_BEGINS_PHASE] * at.named_inputs["lengths"]

    def own_rows(self, at: StepSymbols) -> Sequence[ca.SX]:
        """h0 + e w - h1 and t0 + (h0 + e w)/N - t1: how long steps are from here on."""
        length, places = self._stretch(at), at.space.layout.states
        rows = [length - at.at1[places["h"]]]
        if self.has_clock:
            passed = (1 - at.is_impact) * at.given[STEP_SHARE] * length
            rows.append(self._before(at, "t") + passed - at.at1[places["t"]])
        return rows

    def idle_cost(self, at: StepSymbols) -> ca.SX:
        """Half the square of changes within a phase."""
        return (1.0 - at.given[_BEGINS_PHASE]) * at.named_inputs["lengths"] ** 2 / 2.0

    def numbers(self, problem: Problem) -> Mapping[str, Array]:
        """1/N."""
        return {STEP_SHARE: np.array([1.0 / problem.timeline.num_timed_steps])}

    def stage_numbers(self, problem: Problem) -> Mapping[str, Array]:
        """Which steps begin a phase."""
        return {_BEGINS_PHASE: begins_phase(problem.num_steps, _first_steps(problem))[:, None]}

    def first(self, problem: Problem) -> Mapping[str, Array]:
        """The guessed length; the time is zero."""
        return {"h": np.ones(1)}

    def state_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Of lengths at the first nodes of phases, and of times at their last; in the units of the guess."""
        timeline = problem.timeline
        lengths, times = (infinite_bounds(problem.num_steps, 1) for _ in range(2))
        for phase, begins in zip(timeline.phases, _first_steps(problem), strict=True):
            (shortest, longest), end = timeline.sides_of(phase), timeline.end_of(phase)
            ends, guessed = phase.last - 1, phase.steps * problem.dt
            lengths[0][begins], lengths[1][begins] = shortest / guessed, longest / guessed
            if not timeline.has_free_times:  # one phase: its length is bounded already
                continue
            if end.earliest > 0.0:
                times[0][ends] = end.earliest / problem.duration
            times[1][ends] = end.latest / problem.duration
        return {"h": lengths, "t": times} if self.has_clock else {"h": lengths}

    def control_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """None."""
        return {"lengths": infinite_bounds(1, 1)}

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """What they say."""
        return ("length", "time") if self.has_clock else ("length",)

    def state_words(self, problem: Problem) -> Mapping[str, str]:
        """Keys of the problem that bound them."""
        of_length = "least length of a phase" if self.has_clock else "bound of horizon.duration"
        return {"h": of_length, "t": "bound of via.time or horizon.duration"}

    def control_words(self, problem: Problem) -> Sequence[str]:
        """What it does."""
        return ("limit of a length",)

    def states_of(self, problem: Problem, motion: Motion) -> Mapping[str, Array]:
        """Lengths of the motion's phases, taken into their bounds, and times."""
        h = _phase_lengths(problem, motion.dts)
        goes = ~problem.timeline.is_impact
        times = np.append(0.0, np.cumsum(goes * h[1:]) / problem.timeline.num_timed_steps)
        return {"h": h[:, None], **({"t": times[:, None]} if self.has_clock else {})}

    def controls_of(self, problem: Problem, motion: Motion) -> Mapping[str, Array]:
        """Changes of the length from phase to phase."""
        return {"lengths": length_controls(problem, motion.dts)}

    def read(self, problem: Problem, at: StateLayout, xs: Array, us: Array, motion: Motion) -> Motion:
        """Lengths of the steps."""
        return replace(motion, dts=lengths_of_states(problem, at, xs))


@dataclass(frozen=True)
class UnequalLengths(Feature):
    """Each step takes its own length, so that states hold none."""

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> UnequalLengths | None:
        """Return it where a problem says so."""
        return cls() if problem.timeline.has_unequal_lengths else None

    @property
    def stage_parameters(self) -> Mapping[str, int]:
        """Length, and time from the middle of the step before."""
        return {_STRETCH: 1, _SPACING: 1}

    @property
    def stage_key(self) -> Mapping[str, Any]:
        """That there are such parameters."""
        return {"has_unequal_lengths": True}

    def enter(self, at: StepSymbols) -> StepSymbols:
        """Take the lengths as they are given."""
        dt = at.given["dt"]
        return replace(at, dt=at.given[_STRETCH] * dt, spacing=at.given[_SPACING] * dt)

    def stage_numbers(self, problem: Problem) -> Mapping[str, Array]:
        """Lengths by the mean one."""
        lengths = fill_lengths(problem, problem.timeline.lengths())
        return {
            _STRETCH: (lengths / problem.dt)[:, None],
            _SPACING: (spacings(lengths) / problem.dt)[:, None],
        }


def _first_steps(problem: Problem) -> list[int]:
    """Of each phase after its impact, which keeps the length before: middles are half of both steps apart."""
    return [phase.first + phase.leaps for phase in problem.timeline.phases]


def begins_phase(num_steps: int, starts: Sequence[int] = (0,)) -> Array:
    """Return parameter e of every step, shape (N,), from the first steps of the phases."""
    e = np.zeros(num_steps)
    e[list(starts)] = 1.0
    return e


def lengths_of_states(problem: Problem, at: StateLayout, xs: Array) -> Array:
    """Return step lengths [s] that states (N + 1, nx) say, shape (N,)."""
    if "h" not in at.states:
        return problem.timeline.lengths()
    return np.where(problem.timeline.is_impact, 0.0, problem.dt * xs[1:, at.states["h"]][:, 0])


def length_controls(problem: Problem, dts: Array) -> Array:
    """Return controls w with which steps have lengths [s], shape (N, 1)."""
    return np.diff(_phase_lengths(problem, dts))[:, None]


def _phase_lengths(problem: Problem, dts: Array) -> Array:
    """Lengths h of all nodes, shape (N + 1,): the mean of each phase, within bounds."""
    timeline, dt = problem.timeline, problem.dt
    phases, end = timeline.phases, timeline.junctions[-1]
    starts, counts = [p.first for p in phases], np.array([p.steps for p in phases])
    durations = np.add.reduceat(dts, starts)
    if len(phases) > 1:
        whole = float(durations.sum())
        durations *= min(max(whole, end.earliest), end.latest) / whole
    shortest, longest = zip(*(timeline.sides_of(phase) for phase in phases), strict=True)
    lengths = np.clip(durations, shortest, longest) / (counts * dt)
    begins = _first_steps(problem)
    return np.append(np.ones(1 + begins[0]), np.repeat(lengths, np.diff([*begins, problem.num_steps])))
