r"""Runge-Kutta methods for positions and momenta: Gauss collocation, Lobatto IIIA with IIIB, Radau IIA.

Each is a table: nodes c, matrix a and weights b of the method for positions. Momenta take

.. math:: \hat a_{ij} = b_j (1 - a_{ji} / b_i),

with which the pair is symplectic; for Gauss methods that is a itself ([Hairer2006]_, theorem VI.4.6). The
coefficients are those of tables II.1.1, II.1.2 and of section II.1.4 there.

Radau IIA methods take a for momenta, too: they are L-stable, so that what is stiff and damped settles within
a step, and lose energy instead of keeping it. Their last stage is the node after the step.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from types import MappingProxyType

from mbocp._arrays import dataclass


@dataclass(frozen=True)
class Pair:
    """Coefficients of a pair.

    Attributes
    ----------
    order : int
        Order of convergence.
    a : tuple of tuple of float
        Row i has the coefficients of the rates in the position of stage i.
    b : tuple of float
        Weights of the stages.
    holds_constraints : bool
        Whether its first and last stages are the nodes, so that constraints hold there.
    is_symplectic : bool
        Whether momenta take the coefficients with which the pair is symplectic; else those of positions.
    """

    order: int
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    holds_constraints: bool
    is_symplectic: bool = True

    @property
    def a_hat(self) -> tuple[tuple[float, ...], ...]:
        """Coefficients of the momenta."""
        if not self.is_symplectic:
            return self.a
        stages = range(self.num_stages)
        a, b = self.a, self.b
        return tuple(tuple(_exact(b[j] * (1.0 - a[j][i] / b[i])) for j in stages) for i in stages)

    @property
    def c(self) -> tuple[float, ...]:
        """Nodes: the sums of the rows of `a`."""
        return tuple(sum(row) for row in self.a)

    @property
    def num_stages(self) -> int:
        """Number of stages."""
        return len(self.b)


def _exact(coefficient: float) -> float:
    """Zero where it is zero but for round-off."""
    return coefficient if abs(coefficient) > 1e-15 else 0.0


_R3, _R6, _R15 = sqrt(3.0), sqrt(6.0), sqrt(15.0)

PAIRS: Mapping[str, Pair] = MappingProxyType(
    {
        "gauss1": Pair(2, ((1 / 2,),), (1.0,), holds_constraints=False),
        "gauss2": Pair(
            4, ((1 / 4, 1 / 4 - _R3 / 6), (1 / 4 + _R3 / 6, 1 / 4)), (1 / 2, 1 / 2), holds_constraints=False
        ),
        "gauss3": Pair(
            6,
            (
                (5 / 36, 2 / 9 - _R15 / 15, 5 / 36 - _R15 / 30),
                (5 / 36 + _R15 / 24, 2 / 9, 5 / 36 - _R15 / 24),
                (5 / 36 + _R15 / 30, 2 / 9 + _R15 / 15, 5 / 36),
            ),
            (5 / 18, 4 / 9, 5 / 18),
            holds_constraints=False,
        ),
        "lobatto2": Pair(2, ((0.0, 0.0), (1 / 2, 1 / 2)), (1 / 2, 1 / 2), holds_constraints=True),
        "lobatto3": Pair(
            4,
            ((0.0, 0.0, 0.0), (5 / 24, 1 / 3, -1 / 24), (1 / 6, 2 / 3, 1 / 6)),
            (1 / 6, 2 / 3, 1 / 6),
            holds_constraints=True,
        ),
        "radau2": Pair(
            3,
            ((5 / 12, -1 / 12), (3 / 4, 1 / 4)),
            (3 / 4, 1 / 4),
            holds_constraints=False,
            is_symplectic=False,
        ),
        "radau3": Pair(
            5,
            (
                ((88 - 7 * _R6) / 360, (296 - 169 * _R6) / 1800, (-2 + 3 * _R6) / 225),
                ((296 + 169 * _R6) / 1800, (88 + 7 * _R6) / 360, (-2 - 3 * _R6) / 225),
                ((16 - _R6) / 36, (16 + _R6) / 36, 1 / 9),
            ),
            ((16 - _R6) / 36, (16 + _R6) / 36, 1 / 9),
            holds_constraints=False,
            is_symplectic=False,
        ),
    }
)
