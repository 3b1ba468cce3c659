r"""Values of the controls within a step: the first controls of the programme.

Which there are is for `mbocp.integrators.controls` to say. A step has k values of each control, one block
after the other. Values at the stages of the method belong to their step alone. Continuous controls begin a
step with the value that the state remembers of the step before, so that only the first step has a first
block of its own:

.. math:: u_0 = e\, w_0 + (1 - e)\, r, \qquad u_1 = w_1, \qquad r^+ = u_1,

with e = 1 in the first step and 0 in all others. Where e is 0 nothing depends on the first block, and half
its square is added to the cost, which is zero at the optimum.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.features.feature import Feature, StepRequests
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.motion import Motion
from mbocp.formulation.steps import HAS_BEFORE, StepSymbols, within
from mbocp.integrators import control_means, shares_of

if TYPE_CHECKING:
    from mbocp.problem import Problem

_SHARE = 0.01  # of a step, in which the limit of the rate leads from the control before the start


@dataclass(frozen=True)
class ControlValues(Feature):
    """Controls of the robot; every problem has them.

    Attributes
    ----------
    shares : tuple of float
        Where in a step they have values; empty where they are constant.
    is_continuous : bool
        Whether the first value of a step is the last of the step before, which states remember.
    """

    shares: tuple[float, ...] = ()
    is_continuous: bool = False

    @classmethod
    def of(cls, problem: Problem, asked: StepRequests) -> ControlValues:
        """Return those of the scheme and of what a problem says of its controls."""
        return cls(shares_of(problem.controls, problem.scheme), problem.controls == "linear")

    @property
    def count(self) -> int:
        """Values of each control in a step."""
        return max(len(self.shares), 1)

    def controls(self, nu: int) -> Mapping[str, int]:
        """All values, one block after the other."""
        return {"own": nu * self.count}

    @property
    def asks_for_first(self) -> bool:
        """Whether the first step begins otherwise."""
        return self.is_continuous

    @property
    def unknowns_key(self) -> Mapping[str, Any]:
        """Where values are; linear controls are remembered, too."""
        return {"shares": self.shares} if self.shares else {}

    def enter(self, at: StepSymbols) -> StepSymbols:
        """Make controls of the robot of the values."""
        if not self.shares:
            return at
        own, nu = at.named_inputs["own"], at.mechanics.nu
        values = [own[i * nu : (i + 1) * nu] for i in range(self.count)]
        if self.is_continuous:
            before = at.at0[at.space.layout.states["control"]]
            values[0] = (1 - at.has_before) * values[0] + at.has_before * before
        begin = values[0] if self.is_continuous else None
        u = within(self.shares, values, 1.0)
        return replace(at, u=u, values=tuple(values), shares=self.shares, begin=begin)

    def idle_cost(self, at: StepSymbols) -> ca.SX:
        """Half the square of a first value that is that of the step before."""
        if not self.is_continuous:
            return ca.SX(0)
        return at.given[HAS_BEFORE] * ca.sumsqr(at.named_inputs["own"][: at.mechanics.nu]) / 2.0

    def control_bounds(self, problem: Problem) -> Mapping[str, tuple[Array, Array]]:
        """Bounds of all values.

        The end of a step is the begin of the next one where controls are continuous: both their limits hold.
        """
        lower, upper = problem.limits_along()["u"]
        if not self.shares:
            return {"own": (lower, upper)}
        sides = []
        for bounds, free, narrower in ((lower, -np.inf, np.maximum), (upper, np.inf, np.minimum)):
            rows = np.array(np.broadcast_to(bounds, (problem.num_steps, bounds.shape[1])))
            blocks = [rows] * self.count
            if self.is_continuous:
                ends, begins = rows.copy(), np.full_like(rows, free)
                ends[:-1] = narrower(rows[:-1], rows[1:])
                begins[0] = rows[0]
                blocks = [begins, ends]
            sides.append(np.hstack(blocks))
        if self.is_continuous:
            _begin(problem, *sides)
        return {"own": (sides[0], sides[1])}

    def control_words(self, problem: Problem) -> Sequence[str]:
        """Names of the robot's controls, and where in a step they are limited."""
        places = tuple(f" at {share:.3g} of the step" for share in self.shares) or ("",)
        labels = problem.robot.u_labels
        return [f"limit of control {label.name}{place}" for place in places for label in labels]

    def controls_of(self, problem: Problem, motion: Motion) -> Mapping[str, Array]:
        """Values within the steps, which are filled in where a motion has none of this kind."""
        if not self.shares:
            return {"own": motion.us}
        values = motion.values
        found = np.array(values if values.shape[1] == self.count else self._fill(motion))
        if self.is_continuous:
            found[1:, 0] = 0.0
        return {"own": found.reshape(len(found), -1)}

    def _fill(self, motion: Motion) -> Array:
        """Values (N, k, nu) of a guess: its means, interpolated between the middles of the steps."""
        ends = np.cumsum(motion.dts)
        middles = ends - motion.dts / 2.0
        times = (ends - motion.dts)[:, None] + np.outer(motion.dts, self.shares)
        columns = [np.interp(times.ravel(), middles, mean) for mean in motion.us.T]
        return np.reshape(np.column_stack(columns), (len(ends), self.count, motion.us.shape[1]))

    def constant(self, us: Array) -> Array:
        """Return controls of the programme with which all values in a step are those of `us`, (N, k nu)."""
        values = np.tile(us, (1, self.count))
        if self.is_continuous:
            values[1:, : us.shape[1]] = 0.0
        return values

    def read(self, problem: Problem, at: StateLayout, xs: Array, us: Array, motion: Motion) -> Motion:
        """Means over the steps, and the values."""
        own = us[:, : at.num_own]
        if not self.shares:
            return replace(motion, us=own)
        values = np.array(own.reshape(len(us), self.count, -1))
        if self.is_continuous:
            values[1:, 0] = values[:-1, -1]
        means: Array = np.einsum("k,nku->nu", control_means(self.shares), values)
        return replace(motion, us=means, values=values, shares=self.shares)

    def pull_back(self, us: Array, values: Array) -> Array:
        """From derivatives of a scalar in what `read` returns to those in the values, shape (N, k nu)."""
        if not self.shares:
            return us
        found: Array = np.array(values) + np.einsum("k,nu->nku", control_means(self.shares), us)
        if self.is_continuous:
            found[:-1, -1] += found[1:, 0]
            found[1:, 0] = 0.0
        return found.reshape(len(found), -1)

    def sum_up(self, multipliers: Array) -> Array:
        """Return multipliers of limits of the robot's controls, (N, nu), from those of all values."""
        if not self.shares:
            return multipliers
        return multipliers.reshape(len(multipliers), self.count, -1).sum(axis=1)


def _begin(problem: Problem, lower: Array, upper: Array) -> None:
    """Narrow the first value to those that limits of rates lead to from the controls before it."""
    u, own = problem.u_before, slice(0, problem.robot.nu)
    if u is not None:
        bounds = problem.limits_of_ends[0]
        spare = _SHARE * problem.dt * np.minimum(-bounds.du_lower, bounds.du_upper)
        lower[0, own] = np.maximum(lower[0, own], u - spare)
        upper[0, own] = np.minimum(upper[0, own], u + spare)
