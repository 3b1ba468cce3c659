"""How an optimum moves with the numbers of its programme, by the factors of its optimality conditions."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation import Formulation
from mbocp.sensitivity.change import Change
from mbocp.sensitivity.kkt import Kkt, Parts, check_unique
from mbocp.sensitivity.lagrangian_slopes import ParameterFunctions
from mbocp.sensitivity.moving_end import take_end_along
from mbocp.sensitivity.reading import Move, OptimumReader


@dataclass(frozen=True, eq=False)
class OptimumSlopes:
    """Moves of an optimum, forward and adjoint.

    Attributes
    ----------
    formulation : Formulation
    kkt : Kkt
        At the optimum.
    functions : ParameterFunctions
    given : Change
        What parameters make of the programme's numbers.
    """

    formulation: Formulation
    kkt: Kkt
    functions: ParameterFunctions
    given: Change

    @cached_property
    def reader(self) -> OptimumReader:
        """What reads quantities off the optimum."""
        return OptimumReader(self.formulation, self.kkt.optimum)

    @cached_property
    def change(self) -> Change:
        """What is given, with what the motion makes of the numbers."""
        return take_end_along(self.formulation, self.given, self._of_end)

    @cached_property
    def sound_change(self) -> Change:
        """The same, refused where conditions of the end that depend on each other would part.

        Contacts may say of the end what the goal says, too. An adjoint does not tell, but any move does.
        """
        change = self.change
        if self.formulation.problem.timeline.switches is not None and change.rho_terminal.any():
            weights = np.random.default_rng(0).normal(size=(1, len(change.start)))
            self.moves(change.along(weights), np.zeros(1))
        return change

    def _of_end(self, change: Change) -> Array:
        """Derivatives of the last configuration along a change, shape (k, nv)."""
        moves = self.moves(change, np.zeros(len(change.start)))
        return np.stack([self.reader.along(move, ["qs"])["qs"][-1] for move in moves])

    def of_cost(self, change: Change) -> Array:
        """Derivatives of the cost along a change, shape (k,)."""
        return self.functions.gradient(self.kkt.optimum, change)

    def moves(self, change: Change, stretches: Array) -> list[Move]:
        """Moves of the optimum along a change, with the part by which given lengths of steps grow in each."""
        solved, _, free = self.kkt.solve(Parts(*(-part for part in self.functions.push(self.kkt, change))))
        return [
            Move(
                start=change.start[k],
                step=Parts(*(part[k] for part in solved)),
                theta=change.theta[k],
                rho=change.rho[k],
                rho_terminal=change.rho_terminal[k],
                stretch=float(stretch),
                free=None if free is None else Parts(*(part[k] for part in free)),
            )
            for k, stretch in enumerate(stretches)
        ]

    def pull(self, bars: Mapping[str, Array], change: Change) -> tuple[Array, float]:
        """Derivatives along a change of a scalar of the motion, and in the part by which steps grow."""
        xs, us, stretch = self.reader.pull_back(bars)
        zeros = Parts.zeros(self.formulation.programme, 1)
        adjoint = self.kkt.solve(zeros._replace(xs=-xs[None, 1:], us=-us[None]))
        found = self.functions.pull(self.kkt.optimum, adjoint, change)
        if adjoint.free is not None:
            free = self.kkt.of_multipliers(adjoint.free)
            check_unique(found, self.functions.pull(self.kkt.optimum, free, change))
        return found + change.start @ xs[0], stretch
