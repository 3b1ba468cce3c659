"""Tables of a robot.toml that exert forces between frames: `[[spring]]`, `[[spring_damper]]`."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from mbocp.robot.loading.table_types import Length, PairTable, PositiveNumber


class QuarticSpringTable(PairTable):
    """A spring with a quartic potential."""

    type: Literal["quartic"] = "quartic"
    stiffness: PositiveNumber | None = None
    coefficient: PositiveNumber | None = None
    length: PositiveNumber | None = None

    @model_validator(mode="after")
    def _one_strength(self) -> QuarticSpringTable:
        if (self.stiffness is None) == (self.coefficient is None):
            raise ValueError("give either stiffness k [N/m] or coefficient c [N/m^3]; c = k/(2 length^2)")
        return self


class SpringDamperTable(PairTable):
    """A linear spring and damper."""

    stiffness: Length = 0.0
    damping: Length = 0.0
    length: Length | None = None
