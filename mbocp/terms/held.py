r"""What holds where a constraint is taken on: positions that coincide, velocities that it allows.

.. math:: \Phi(q_n) = 0 \;\text{where frames coincide}, \qquad J(q_n)\,v_n = 0 \;\text{without an impact}.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from mbocp.mechanics.held_frames import HeldFrame, held_jacobian, held_rows
from mbocp.terms.point import Point


@dataclass(frozen=True)
class ContactConditionTerm:
    """The structure of such rows, as `mbocp.terms.PathTerm` is that of a path constraint.

    Attributes
    ----------
    frame : HeldFrame
    kept : tuple of int
        Those of its rows that act.
    has_place, has_rate : bool
        Whether positions coincide and velocities are allowed.
    """

    frame: HeldFrame
    kept: tuple[int, ...]
    has_place: bool
    has_rate: bool

    remembers: ClassVar[tuple[str, ...]] = ()

    @property
    def has_velocity(self) -> bool:
        """Whether it depends on the velocity."""
        return self.has_rate

    @property
    def signature(self) -> dict[str, Any]:
        """What its function depends on."""
        said = {"kept": self.kept, "has_place": self.has_place, "has_rate": self.has_rate}
        return {"term": "meeting", "frame": self.frame.signature, **said}

    @property
    def rows(self) -> int:
        """Number of its values."""
        return len(self.kept) * (self.has_place + self.has_rate)

    @property
    def sizes(self) -> dict[str, int]:
        """No parameters."""
        return {}

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Rows of positions, and of velocities below them."""
        kept, found = list(self.kept), [ca.SX.zeros(0, 1)]
        if self.has_place:
            found.append(held_rows((self.frame,), at.mechanics, at.q, at.q)[kept])
        if self.has_rate:
            found.append((held_jacobian((self.frame,), at.mechanics, at.q) @ at.v)[kept])
        return ca.vertcat(*found)
