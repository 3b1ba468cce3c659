"""Which numbers of a model the values of locked joints decide.

The link behind a locked joint is part of the body before it, with an inertia and placements of frames and
further joints that depend on the joint's value. Only entries that do so can be parameters of functions; the
others are the same for every value, to the last bit, so that models differ in the former alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbocp._arrays import Array
from mbocp.robot import joints
from mbocp.symbolic import ModelNumber, all_numbers, values_of, with_values

_SAMPLES = 3  # values of the joints; what depends on them differs between two of them but for an accident
_ROUND_OFF = 1e-13  # of the largest entry of an inertia's moments, or a placement


def decided_by_locks(
    model: pin.Model, locked: Sequence[int], named: Sequence[int], reduced: pin.Model, q: Array
) -> tuple[pin.Model, tuple[ModelNumber, ...]]:
    """Model without the locked joints, and which of its numbers the values of some of them decide.

    Parameters
    ----------
    model : pinocchio.Model
        Before locking.
    locked : sequence of int
        All joints that are locked.
    named : sequence of int
        Those whose values are to make no difference but in these numbers.
    reduced : pinocchio.Model
        After locking.
    q : ndarray, shape (nq,)
        Configuration at which they are locked.

    Returns
    -------
    model : pinocchio.Model
        `reduced`, with all else but these numbers from other values of the joints, which is the same but for
        round-off.
    numbers : tuple of ModelNumber
    """
    others = [pin.buildReducedModel(model, list(locked), at) for at in _elsewhere(model, named, q)]
    numbers = all_numbers(reduced)
    samples = np.array([values_of(other, numbers) for other in others])
    spread, sizes = np.ptp(samples, axis=0), np.abs(samples).max(axis=0)
    varying, start = list[ModelNumber](), 0
    for _, group in groupby(numbers, key=_kind):
        members = list(group)
        here = slice(start, start + len(members))
        largest = sizes[here].max()
        varying += [n for n, s in zip(members, spread[here], strict=True) if s > _ROUND_OFF * largest]
        start = here.stop
    found = tuple(varying)
    return with_values(others[0], found, values_of(reduced, found)), found


def _kind(number: ModelNumber) -> tuple[str, int, int]:
    """Entries whose sizes compare: mass, centre of mass or moments, rotation or translation of one owner."""
    is_inertia = number.of == "inertia"
    part = (number.entry > 0) + (number.entry > 3) if is_inertia else int(number.entry > 8)
    return number.of, number.owner, part


def _elsewhere(model: pin.Model, named: Sequence[int], q: Array) -> list[NDArray[np.float64]]:
    """Configurations with other values of the joints, the same ones each time."""
    rng, found = np.random.default_rng(0), []
    for _ in range(_SAMPLES):
        moved = pin.integrate(model, pin.neutral(model), rng.uniform(-1.0, 1.0, model.nv))
        at = np.array(q)
        for joint in named:
            where = joints.configuration_slice(model, joint)
            at[where] = moved[where]
        found.append(at)
    return found
