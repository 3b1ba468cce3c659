r"""Heat of motors: what their controls have been above the limits of their root mean squares.

With the limit L of a control and the length dt of a step, the state adds up

.. math:: e_{k+1} = e_k + \delta t \left( \frac{1}{L^2} \int_0^1 u(s)^2 \, ds - 1 \right), \qquad e_0 = 0,

and e_N <= 0 says that the integral of u^2 is at most L^2 times the duration, whether that is given or found.
The integral is that of the polynomial of the step, exact as in `mbocp.solution.loads_of`. Impacts take no
time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.features.feature import Feature, StepRequests, infinite_bounds
from mbocp.formulation.layout import Block
from mbocp.formulation.motion import Passage
from mbocp.integrators import control_squares, shares_of
from mbocp.problem import Problem
from mbocp.robot import Label

_HEAT = "heat"
_HEATING = "heating"  # the stage parameters 1 / L^2


@dataclass(frozen=True)
class Heat(Feature):
    """Controls whose root mean square has a limit.

    Attributes
    ----------
    entries : tuple of int
    shares : tuple of float
        Where in a step controls have values; empty where they are constant.
    """

    entries: tuple[int, ...]
    shares: tuple[float, ...] = ()

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> Heat | None:
        """Return those of the limits."""
        entries = tuple(np.flatnonzero(problem.limits.finite("rms")).tolist())
        return cls(entries, shares_of(problem.controls, problem.scheme)) if entries else None

    def blocks(self, ns: int, nu: int) -> tuple[Block, ...]:
        """One entry for each [s, in units of the duration]."""
        return (Block(_HEAT, len(self.entries), has_unit=True, adds_up=True),)

    @property
    def stage_parameters(self) -> Mapping[str, int]:
        """How much squares of controls count."""
        return {_HEATING: len(self.entries)}

    @property
    def state_key(self) -> Mapping[str, Any]:
        """Which controls they are of."""
        return {_HEAT: list(self.entries)}

    def next_value(self, name: str, step: Passage) -> Any:
        """What was before, and the excess of the square in the time of the step."""
        values, squares = self._values(step), control_squares(self.shares)
        square = sum(
            float(squares[i, j]) * one * other
            for i, one in enumerate(values)
            for j, other in enumerate(values)
        )
        return step.before[name] + step.dt * (step.given[_HEATING] * square - 1.0) / step.units[name]

    def _values(self, step: Passage) -> list[Any]:
        """Controls with a limit, at each share of the step."""
        own, places, count = step.controls["own"], list(self.entries), max(len(self.shares), 1)
        is_number = isinstance(own, np.ndarray)
        nu = (own.shape[1] if is_number else own.numel()) // count
        at = [slice(i * nu, (i + 1) * nu) for i in range(count)]
        blocks = [own[:, part] if is_number else own[part] for part in at]
        if step.begin is not None:
            blocks[0] = step.begin
        return [block[:, places] if is_number else (step.units_of_u * block)[places] for block in blocks]

    def stage_numbers(self, problem: Problem) -> Mapping[str, Array]:
        """1 / L^2 in every step."""
        limits = problem.limits.rms_upper[list(self.entries)]
        return {_HEATING: np.broadcast_to(limits**-2.0, (problem.num_steps, len(limits)))}

    def units(self, problem: Problem) -> Mapping[str, float]:
        """The duration, or the guess of it."""
        return {_HEAT: problem.duration}

    def state_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """At the end."""
        lower, upper = infinite_bounds(problem.num_steps, len(self.entries))
        upper[-1] = 0.0
        return {_HEAT: (lower, upper)}

    def row_words(self, problem: Problem, speeds: tuple[Label, ...]) -> Sequence[str]:
        """Of which control."""
        return [f"mean square of control {problem.robot.u_labels[i].name}" for i in self.entries]

    def state_words(self, problem: Problem) -> Mapping[str, str]:
        """The key of the problem that bounds it."""
        return {_HEAT: "limit of limits.effort_rms"}
