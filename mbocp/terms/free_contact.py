r"""A foot that the ground pushes where it stands, and that may leave: contact without a schedule.

With the force :math:`f` of the ground in a step, by the weight, of which :math:`f_n` points up, the height
:math:`h` of the foot at the node after it, by a length, its velocity :math:`w` along the ground there, by
:math:`\sqrt{g l}`, and a bound :math:`\gamma` of that, which is an unknown:

.. math::
    h \ge 0, \quad |w_1| + |w_2| \le \gamma, \quad f_n h \le \epsilon, \quad
    \mu' f_n \gamma + f_t \cdot w \le \epsilon

The force stays in a pyramid, :math:`|f_1|, |f_2| \le \mu' f_n`, so that no product is negative. Where the
last is zero, a foot that slides is braked as hard as the pyramid allows: the law of maximal dissipation
of Coulomb. Products that are at most a small :math:`\epsilon`, and not zero, leave solvers an inside.

References
----------
Posa, Cantu, Tedrake, "A direct method for trajectory optimization of rigid bodies through contact", 2014.
Scholtes, "Convergence properties of a regularization scheme for mathematical programs with complementarity
constraints", 2001.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import casadi as ca

from mbocp._arrays import dataclass
from mbocp.terms.bounded import Structure
from mbocp.terms.point import Point

FACETS = 4  # of the pyramid of forces, along x and y
SLIP = "slip"  # the block of the bounds gamma
_OF_WRENCH = 6  # force along the normal and two tangents, torque about them


@dataclass(frozen=True)
class FreeContactTerm(Structure):
    """The structure of such a contact.

    Attributes
    ----------
    frame : int
        Index of the frame whose origin is the foot.
    of_rows : tuple of int
        Rows of constraints that exert its force.
    place : int
        Of its bound among those of all feet.
    """

    frame: int
    of_rows: tuple[int, ...]
    place: int

    kind: ClassVar[str] = "free_contact"
    has_velocity: ClassVar[bool] = True
    remembers: ClassVar[tuple[str, ...]] = ("reaction", SLIP)
    rows: ClassVar[int] = 7

    @property
    def sizes(self) -> dict[str, int]:
        """Size of each: forces by the multipliers and the weight, by columns; mu', height, units."""
        return {"map": _OF_WRENCH * len(self.of_rows), "friction": 1, "height": 1, "length": 1, "speed": 1}

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Height, four rows of the bound less speeds, and both products."""
        lam = at.remembered["reaction"][list(self.of_rows)]
        wrench = ca.reshape(p["map"], _OF_WRENCH, len(self.of_rows)) @ lam
        slip, normal, along = at.remembered[SLIP][self.place], wrench[0], wrench[1:3]
        jacobian = at.mechanics.frame_translation_jacobian(self.frame, at.q)
        w = (jacobian[:2, :] @ at.v) / p["speed"]
        height = (at.mechanics.frame_position(self.frame, at.q)[2] - p["height"]) / p["length"]
        room = [slip + a * w[0] + b * w[1] for a in (-1, 1) for b in (-1, 1)]
        lost = p["friction"] * normal * slip + ca.dot(along, w)
        return ca.vertcat(height, *room, normal * height, lost)
