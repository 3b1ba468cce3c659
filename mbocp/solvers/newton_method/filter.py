"""Filter acceptance of trial steps, [Waechter2006]_: progress in feasibility or cost, and no way back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbocp.solvers.tolerances import FEASIBLE_VIOLATION

if TYPE_CHECKING:
    from mbocp.programme.native import Evaluation, Trial

_MARGIN = (
    1e-5  # relative decrease of the violation, or of the cost against the violation, that counts as progress
)
_ARMIJO = 1e-4  # fraction of the predicted decrease of the cost
_SLOPE_POWER, _VIOLATION_POWER = 2.3, 1.1  # switching condition
_ROUND_OFF = 1e-13  # of the cost's own sum


@dataclass(frozen=True)
class Filter:
    """Pairs of violation and cost that no later iterate may be worse than in both.

    Attributes
    ----------
    entries : tuple of (float, float)
        Forbidden corners (violation, cost).
    most_violation : float
        No iterate may violate the constraints by more than this.
    least_violation : float
        Below it a descent direction of the cost has to decrease the cost.
    """

    entries: tuple[tuple[float, float], ...] = ()
    most_violation: float = float("inf")
    least_violation: float = 0.0

    @classmethod
    def start(cls, violation: float) -> Filter:
        """Filter for a first iterate of the given violation."""
        scale = max(1.0, violation)
        return cls(most_violation=10.0 * scale, least_violation=1e-4 * scale)

    def accepts(
        self, before: Evaluation, trial: Trial | Evaluation, slope: float, length: float
    ) -> tuple[bool, bool]:
        """Whether a trial is accepted, and whether for the decrease of its cost (else the filter grows).

        Parameters
        ----------
        before, trial : records with `objective` and `violation`
            The iterate and the moved one.
        slope : float
            Directional derivative of the objective: the cost, with limits and their barrier.
        length : float
            Step length.
        """
        if not trial.finite or trial.violation > self.most_violation:
            return False, False
        if any(trial.violation >= violation and trial.objective >= cost for violation, cost in self.entries):
            return False, False
        slack = _ROUND_OFF * abs(before.objective)
        if self._is_descent(before.violation, slope, length):
            return trial.objective <= before.objective + _ARMIJO * length * slope + slack, True
        both_feasible = before.violation < FEASIBLE_VIOLATION and trial.violation < FEASIBLE_VIOLATION
        return (
            trial.violation <= (1 - _MARGIN) * before.violation
            or trial.objective <= before.objective - _MARGIN * before.violation + slack
            or (both_feasible and trial.objective <= before.objective + 10 * slack)
        ), False

    def accepts_after_relaxation(self, reference: Evaluation, trial: Trial | Evaluation) -> bool:
        """Whether relaxed steps made progress: closer to feasible than where they began."""
        return bool(
            trial.finite
            and trial.violation <= (1 - _MARGIN) * reference.violation
            and not any(
                trial.violation >= violation and trial.objective >= cost for violation, cost in self.entries
            )
        )

    def with_corner(self, before: Evaluation) -> Filter:
        """Filter that also forbids going back to `before`."""
        corner = ((1 - _MARGIN) * before.violation, before.objective - _MARGIN * before.violation)
        return Filter((*self.entries, corner), self.most_violation, self.least_violation)

    def without_corners(self) -> Filter:
        """Filter for another objective: with the same bounds of the violation, and no pairs."""
        return Filter((), self.most_violation, self.least_violation)

    def _is_descent(self, violation: float, slope: float, length: float) -> bool:
        return (
            violation <= self.least_violation
            and slope < 0
            and length * (-slope) ** _SLOPE_POWER > violation**_VIOLATION_POWER
        )
