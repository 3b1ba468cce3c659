"""Tables 1 to 7 of the paper, measured again."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from mbocp_papers.layout import PaperTable
from mbocp_papers.numbers import check_number
from mbocp_papers.pendulums.comparison import comparison_table
from mbocp_papers.pendulums.convergence import convergence_table
from mbocp_papers.pendulums.data import COMPARISONS, CONVERGENCES

TITLES: Mapping[int, str] = dict(sorted((t.number, t.title) for t in (*COMPARISONS, *CONVERGENCES)))


def check_table(number: int) -> None:
    """Refuse a number that no table has.

    Raises
    ------
    InvalidValue
    """
    check_number("--table", number, TITLES)


def make_table(
    number: int, *, quick: bool = False, repetitions: int = 5, say: Callable[[str], object] = str
) -> PaperTable:
    """Measure and lay out a table.

    Parameters
    ----------
    number : int
    quick : bool
        Only the two coarsest step sizes, each solved once.
    repetitions : int
        Most runs that a time is the median of.
    say : callable
        Told what is being worked on.
    """
    check_table(number)
    for convergence in CONVERGENCES:
        if convergence.number == number:
            return convergence_table(convergence, say)
    (comparison,) = (c for c in COMPARISONS if c.number == number)
    return comparison_table(comparison, 1 if quick else repetitions, 2 if quick else None, say)
