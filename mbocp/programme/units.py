r"""Units in which the numbers of a programme are of ordinary size.

A robot of other masses moves in the same way under controls that are as much larger. So forces have a unit
that changes no motion: with controls, algebraic unknowns and the momentum balance counted in a unit of force
:math:`F`, and the cost in a unit :math:`1/\kappa`,

.. math:: u = F u', \qquad y = F y', \qquad c_p = F c_p', \qquad l' = \kappa\, l, \qquad
          m' = \kappa\, m, \qquad m_p' = \kappa F\, m_p,

an arm of a ton and a kilometre (1e8 N m) is to a solver what one of a kilogram and a metre is. Both units are
powers of two, so that nothing is lost on the way there and back.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mbocp._arrays import BoolArray, frozen_mask


@dataclass(frozen=True)
class Units:
    """Units for a programme, and the entries that count in them.

    Attributes
    ----------
    force : float
        F [N, N m].
    cost : float
        kappa, what costs are multiplied with.
    theta, terminal : ndarray of bool
        Entries of the programme's parameters that hold F, or with which the end condition's rows of momenta
        are multiplied.
    x, u, y, rows, end_rows : ndarray of bool
        Entries of states, controls, algebraic unknowns, rows of a step and of the end condition that are
        forces or momenta.
    """

    force: float
    cost: float
    theta: BoolArray = field(compare=False)
    terminal: BoolArray = field(compare=False)
    x: BoolArray = field(compare=False)
    u: BoolArray = field(compare=False)
    y: BoolArray = field(compare=False)
    rows: BoolArray = field(compare=False)
    end_rows: BoolArray = field(compare=False)

    def __post_init__(self) -> None:
        for name in ("theta", "terminal", "x", "u", "y", "rows", "end_rows"):
            mask = np.asarray(getattr(self, name))
            object.__setattr__(self, name, frozen_mask(mask, size=mask.size))

    @property
    def are_users(self) -> bool:
        """Whether nothing is counted otherwise than by the user."""
        return self.force == 1.0 and self.cost == 1.0
