"""When a hybrid ends its gradient phase."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Switch:
    """When a hybrid goes over to Newton's method, step 2 of section 5.3; 0 switches a criterion off.

    Attributes
    ----------
    residual : float
        Once r_u is smaller.
    cost : float
        Once the cost is below this part of the guess's.
    iterations : int
        After so many steps.
    """

    residual: float = 10.0
    cost: float = 0.5
    iterations: int = 25
