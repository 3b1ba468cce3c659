"""What an estimator knows after a sample."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp.receding.status import HorizonStatus

_UNSEEN = 0.9  # of the standard deviation without any sample: above, samples say next to nothing


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is known after a sample. Arrays are copies.

    Attributes
    ----------
    status : HorizonStatus
        As of a receding horizon.
    q : ndarray, shape (nq,)
        Configuration at the time of the sample [m, rad, unit quaternion xyzw].
    v : ndarray, shape (nv,)
        Velocity [m/s, rad/s].
    parameters : dict of str to float
        The unknown constants by name.
    """

    status: HorizonStatus
    q: Array
    v: Array
    parameters: dict[str, float]
    _root: Callable[[], Array]
    _unseen: Array

    @cached_property
    def standard_deviations(self) -> Array:
        """Of q along its tangent, of v, and of the constants, shape (2 nv + constants,).

        Worked out when they are first asked for.
        """
        return frozen_array(np.linalg.norm(self._root(), axis=0))

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviations of the constants by name."""
        of_all = self.standard_deviations[2 * self.v.size :]
        return dict(zip(self.parameters, of_all.tolist(), strict=True))

    @property
    def unobserved(self) -> tuple[str, ...]:
        """Constants that the samples so far say next to nothing of: they are what was assumed."""
        pairs = zip(self.deviations.items(), self._unseen, strict=True)
        return tuple(name for (name, deviation), unseen in pairs if deviation > _UNSEEN * unseen)
