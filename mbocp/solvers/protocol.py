"""What `run` asks of a solver and of its state."""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from mbocp.programme import StagewiseProgramme
from mbocp.programme.iterate import Iterate
from mbocp.solvers.records import Status

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelProgramme


class Measures(Protocol):
    """What is measured at an iterate, in the reported scaling."""

    @property
    def residual(self) -> float:
        """Norm of `primal` and `dual`."""

    @property
    def primal(self) -> float:
        """Of constraints and end condition."""

    @property
    def dual(self) -> float:
        """Of the stationarity conditions."""

    @property
    def cost(self) -> float:
        """Of the trajectory."""

    @property
    def worst(self) -> float:
        """Largest defect of a row."""

    @property
    def worst_stage(self) -> int:
        """Where that is; -1: the end condition."""

    @property
    def worst_row(self) -> int:
        """Which row of it; beyond a stage's own: its limits."""

    @property
    def complementarity(self) -> float:
        """Norm of the products of limits' multipliers and distances, a part of `dual`."""


class SolverState(Protocol):
    """Where a solver stands."""

    @property
    def native(self) -> KernelProgramme:
        """Kernel programme that holds the iterate."""

    @property
    def evaluation(self) -> Measures:
        """Residuals and cost at the iterate."""

    @property
    def iteration(self) -> int:
        """Steps taken."""

    @property
    def increment(self) -> float:
        """Norm of the last step."""

    @property
    def next_increment(self) -> float:
        """Norm that the next one would have, where the last one tells; infinite otherwise."""

    @property
    def step_length(self) -> float:
        """Fraction of it that was taken."""

    @property
    def regularisation(self) -> float:
        """Shift of the Hessian in the last step."""

    @property
    def at_minimum(self) -> bool:
        """Whether the inertia was a minimum's when it was last looked at."""

    @property
    def failed_stage(self) -> int:
        """In which step, counted from 0; num_steps: the end condition."""


State = TypeVar("State", bound=SolverState)


class Solver(Protocol, Generic[State]):
    """A method as three steps on an explicit state."""

    @property
    def name(self) -> str:
        """What it is called in output."""

    @property
    def tolerance(self) -> float:
        """Of residual and increment."""

    def init(self, programme: StagewiseProgramme, iterate: Iterate) -> State:
        """State at an iterate."""

    def step(self, state: State) -> State:
        """One iteration further."""

    def terminate(self, state: State) -> Status | None:
        """How it ended, or None to go on."""
