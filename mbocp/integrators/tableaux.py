"""Explicit Runge-Kutta methods as Butcher tableaux.

Each is a table: nodes c, matrix a and weights b of

    k_i = f(t + c_i h, y + h sum_j a_ij k_j),    y_next = y + h sum_i b_i k_i    (4.1 of [Manara2017]_)
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from types import MappingProxyType

from mbocp._arrays import dataclass


@dataclass(frozen=True)
class Tableau:
    """Coefficients of an explicit Runge-Kutta method.

    Attributes
    ----------
    order : int
        Order of convergence.
    a : tuple of tuple of Fraction
        Row i has the i coefficients of the slopes before stage i.
    b : tuple of Fraction
        Weights of the slopes.
    """

    order: int
    a: tuple[tuple[Fraction, ...], ...]
    b: tuple[Fraction, ...]

    @property
    def c(self) -> tuple[Fraction, ...]:
        """Nodes: the sums of the rows of `a`."""
        return tuple(sum(row, Fraction(0)) for row in self.a)

    @property
    def num_stages(self) -> int:
        """Number of slopes."""
        return len(self.b)


def _tableau(order: int, rows: tuple[str, ...], weights: str) -> Tableau:
    def numbers(text: str) -> tuple[Fraction, ...]:
        return tuple(Fraction(word) for word in text.split())

    return Tableau(order, tuple(numbers(row) for row in rows), numbers(weights))


TABLEAUX: Mapping[str, Tableau] = MappingProxyType(
    {
        "euler": _tableau(1, ("",), "1"),
        "heun": _tableau(2, ("", "1"), "1/2 1/2"),
        "rk4": _tableau(4, ("", "1/2", "0 1/2", "0 0 1"), "1/6 1/3 1/3 1/6"),
        # Fehlberg's six stages with the weights of order five; [Hairer1993]_, table 5.1
        "rkf5": _tableau(
            5,
            (
                "",
                "1/4",
                "3/32 9/32",
                "1932/2197 -7200/2197 7296/2197",
                "439/216 -8 3680/513 -845/4104",
                "-8/27 2 -3544/2565 1859/4104 -11/40",
            ),
            "16/135 0 6656/12825 28561/56430 -9/50 2/55",
        ),
    }
)
LIE_METHODS = ("plain", "baumgarte", "munthe_kaas")
