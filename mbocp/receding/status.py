"""What became of one step of a receding horizon, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, TypeAlias, cast

from mbocp._arrays import dataclass

if TYPE_CHECKING:
    from mbocp._native._kernel import HorizonStatus as KernelStatus

HorizonState: TypeAlias = Literal[
    "converged", "improved", "out_of_time", "stuck", "not_finite", "bad_input", "moved_on"
]

_WORDS = {
    "converged": "the last Newton step was smaller than the tolerance",
    "improved": "all Newton steps were taken that were asked for",
    "out_of_time": "no time for another Newton step before the limit",
    "stuck": "no Newton step improves cost or constraints",
    "not_finite": "functions are not finite at the prediction",
    "bad_input": "what was given cannot be, so the prediction goes on without it",
    "moved_on": "no Newton step was asked for",
}


@dataclass(frozen=True, slots=True)
class HorizonStatus:
    """What became of a step.

    Attributes
    ----------
    state : {"converged", "improved", "out_of_time", "stuck", "not_finite", "bad_input", "moved_on"}
        Why the step ended.
    iterations : int
        Newton steps taken. With none the prediction is the one before, moved on.
    increment : float
        Norm of the last Newton step in all unknowns.
    step_length : float
        Part of it that was taken.
    violation : float
        Sum of the absolute defects of all steps, end conditions and limits, in the units of the programme.
    barrier : float
        Parameter of the limits' barrier; 0: there are no limits.
    seconds : float
        Time in the kernel [s].
    detail : str
        What was wrong with what was given.
    """

    state: HorizonState
    iterations: int
    increment: float
    step_length: float
    violation: float
    barrier: float
    seconds: float
    detail: str = ""

    @classmethod
    def of(cls, found: KernelStatus, wrong: Sequence[str]) -> HorizonStatus:
        """Return what the kernel says of a step, and what was wrong with what was given."""
        return cls(
            cast(HorizonState, "bad_input" if wrong else found.outcome.name),
            found.iterations,
            found.increment,
            found.length,
            found.violation,
            found.barrier,
            found.seconds,
            "; ".join(wrong),
        )

    @property
    def is_good(self) -> bool:
        """Whether at least one Newton step was taken from the state that was given."""
        return self.iterations > 0 and self.state != "bad_input"

    @property
    def words(self) -> str:
        """The state in a sentence."""
        taken = f"{self.iterations} Newton step{'' if self.iterations == 1 else 's'}"
        told = f": {self.detail}" if self.detail else ""
        return f"{taken}: {_WORDS[self.state]}{told}"

    def __str__(self) -> str:
        return self.words
