"""What a problem says of the controls before its start and after its end, to which limits of rates hold."""

from __future__ import annotations

from dataclasses import field
from typing import Literal

import numpy as np

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp.problem._checks import check_choice

ControlRule = Literal["rest", "given", "free"]
RULES: tuple[ControlRule, ...] = ("rest", "given", "free")


@dataclass(frozen=True, eq=False)
class EndControl:
    """Controls before the start, or after the end.

    Attributes
    ----------
    rule : {"rest", "given", "free"}
        ``rest``: those that hold the robot, where it is at rest and no others do; see
        `mbocp.problem.goals.end_conditions.controls_at`.
    value : ndarray, shape (nu,)
        Those that are given [N, N m, and the units of drives].
    """

    rule: ControlRule = "rest"
    value: Array = field(default_factory=lambda: frozen_array(np.zeros(0)))

    def __post_init__(self) -> None:
        check_choice("u", self.rule, RULES)
        object.__setattr__(self, "value", frozen_array(self.value, shape=(None,), name="u"))
