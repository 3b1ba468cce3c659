r"""What costs with more and more steps tell of the error of the last.

With :math:`d_k = |J_k - J_{k-1}|`, each :math:`J_k` with twice as many steps as the one before, and the
order q of the cost, Richardson's estimate is :math:`d_K / (2^q - 1)`. It holds where costs do fall with that
order: what is light has lower ones until steps resolve it, controls that leap another one, and errors of the
controls and of the motion that have different signs may cancel for some number of steps. So the order that is
seen counts, :math:`2^p = d_{K-1} / d_K`, where it is lower, and the difference before where it is higher than
the order s of the scheme, with which the errors of the motion fall,

.. math:: e = \max\Bigl(\frac{d_K}{2^p - 1},\; \frac{d_{K-1}}{2^s (2^s - 1)}\Bigr), 1 \le p \le q \le s.

Where q is s, an order that is seen to be higher than s + 1 is no order, but a difference that happens to be
small: half of s is taken for the second term then. Where it is not, the controls tell of the lower order.

In the formulations whose errors are known to cancel, and where controls that vary within steps keep a
velocity or a position at its limit, two orders have to be seen. Where they are not alike, the error is taken
to be the larger of the last two differences, of order one of twice the last: errors of two orders that cancel
in one of them do not in the other.

What costs tend to, :math:`J_K + (J_K - J_{K-1}) / (2^q - 1)`, is known better than the error of the last of
them is small: by as much as the limits of the last two pairs differ, over :math:`2^q - 1`, and by a
fiftieth of that error at least. So the error of any other steps is their cost against it, and what it is
unsure by. Where errors are not those of the order q, the last cost takes the place of the limit, and its
error that of what it is unsure by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, dataclass

_LOWEST, _HIGHER = 0.8, 1.0  # orders that are believed: from about one to one above that of the scheme
_ROUND_OFF = 1e-11  # of a cost: differences below it tell nothing
_OF_ITS_ORDER = 1.5  # times what the last difference says: errors beyond are of no order
_LEAST_UNSURE = 0.02  # of the error of the last cost


@dataclass(frozen=True)
class CostLimit:
    """What costs tend to with steps of no length, and what that may be wrong by.

    Attributes
    ----------
    value, unsure : float
        In the unit of the costs.
    """

    value: float
    unsure: float

    def error_of(self, cost: float) -> float:
        """What a cost is wrong by, at most."""
        return abs(cost - self.value) + self.unsure

    def beside(self, other: CostLimit) -> CostLimit:
        """The same, as unsure as the two are apart where not even what they are unsure by covers that."""
        apart = abs(self.value - other.value)
        return self if apart <= self.unsure + other.unsure else replace(self, unsure=max(self.unsure, apart))


def cost_error(
    costs: Sequence[float], order: int, *, highest: int | None = None, is_smooth: bool = True
) -> float:
    """Error of the last of some costs.

    Parameters
    ----------
    costs : sequence of float
        Two at least, coarse to fine, each with twice as many steps as before. NaN: not known.
    order : int
        q, with which they are expected to fall.
    highest : int, optional
        s, with which any part of them falls; q, if it is not said.
    is_smooth : bool
        Whether one order that is seen is enough.

    Returns
    -------
    float
        In the unit of the costs.
    """
    q, s = 2.0**order, 2.0 ** max(order, highest or order)
    differences = np.abs(np.diff(costs))
    last = float(differences[-1])
    if len(differences) < 2:
        return last / (q - 1.0)
    before = float(differences[-2])
    if max(last, before) <= _ROUND_OFF * abs(costs[-1]):
        return max(last, before)
    if not np.isfinite(before):
        return last
    if not is_smooth and not _are_alike(differences, order):
        return max(last, before, 2.0 * last / (q - 1.0))
    ratio = before / last if last else np.inf
    if ratio > 2.0 * s == 2.0 * q:
        s = s**0.5
    return max(last / (min(max(ratio, 2.0), q) - 1.0), before / (s * (s - 1.0)))


def cost_limit(costs: Sequence[float], order: int, error: float) -> CostLimit:
    """What some costs tend to.

    Parameters
    ----------
    costs : sequence of float
        Two at least, coarse to fine, each with twice as many steps as before. NaN: not known.
    order : int
        q, with which they are expected to fall.
    error : float
        Of the last, as `cost_error` and others say.
    """
    factor = 2.0**order - 1.0
    limits = np.asarray(costs[1:]) + np.diff(costs) / factor
    step = abs(float(limits[-1]) - costs[-1])
    if not error <= _OF_ITS_ORDER * step:
        return CostLimit(float(costs[-1]), error)
    before = abs(float(limits[-1] - limits[-2])) / factor if len(limits) > 1 else step
    between = before if np.isfinite(before) else step
    return CostLimit(float(limits[-1]), max(error - step, between, _LEAST_UNSURE * error))


def _are_alike(differences: Array, order: int) -> bool:
    """Whether all orders that are seen are near the one that is expected."""
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = np.log2(np.divide(differences[:-1], differences[1:]))
    return bool(np.isfinite(seen).all() and seen.min() >= _LOWEST and seen.max() <= order + _HIGHER)
