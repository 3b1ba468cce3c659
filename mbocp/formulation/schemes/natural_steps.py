"""Steps of the tau family in natural coordinates."""

from __future__ import annotations

from dataclasses import dataclass

from mbocp.formulation.schemes.implicit_steps import implicit_derivatives
from mbocp.formulation.steps import EquationSteps, StepDerivatives, StepSymbols
from mbocp.integrators import TAU
from mbocp.mechanics import Mechanics, natural_mechanics
from mbocp.robot import Robot

__all__ = ["NaturalSteps"]

_OPERATIONS = 400  # of "complete" by coordinate: they grow with the number of bodies


@dataclass(frozen=True)
class NaturalSteps(EquationSteps):
    """Equations between two states of the bodies; see `Steps`."""

    coordinates = "natural"
    takes_numbers = False
    remedy = "Lock joints"

    @property
    def tau(self) -> float:
        """Where in a step its running cost is evaluated."""
        return TAU[self.scheme]

    def operations(self, nv: int) -> float:
        """Bodies know their neighbours alone."""
        return float(_OPERATIONS * nv)

    def mechanics(self, robot: Robot) -> Mechanics:
        """Equations of motion of the bodies."""
        return natural_mechanics(robot)

    def num_algebraic(self, mechanics: Mechanics) -> int:
        """One impulse for each constraint, those of rigid bodies and joints included."""
        return mechanics.nc

    def derivatives(self, symbols: StepSymbols) -> StepDerivatives:
        """Rows and cost of a step, with exact first and second derivatives."""
        return implicit_derivatives(self.scheme, symbols)
