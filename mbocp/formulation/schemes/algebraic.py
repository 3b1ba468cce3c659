"""Unknowns of a step beside states and controls, and their rows: how they are scaled, which are forces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbocp._arrays import Array, BoolArray


@dataclass(frozen=True, eq=False)
class Algebraic:
    """Factors from the programme's rows and unknowns to the reported ones, see `StageKind`.

    Attributes
    ----------
    scale_c, scale_y, scale_m : ndarray, shape (ny,)
        Of the rows that belong to these unknowns, of the unknowns, of the rows' multipliers.
    is_force : ndarray of bool, shape (ny,)
        Unknowns that count in the unit of force.
    is_balance : ndarray of bool, shape (ny,)
        Rows that count in it.
    """

    scale_c: Array
    scale_y: Array
    scale_m: Array
    is_force: BoolArray
    is_balance: BoolArray

    @property
    def size(self) -> int:
        """Number of unknowns, and of rows."""
        return len(self.scale_y)


def impulses(size: int, dt: float) -> Algebraic:
    """Impulses of constraints, whose rows are Phi / dt."""
    return Algebraic(
        scale_c=np.full(size, dt),
        scale_y=np.full(size, 1 / dt),
        scale_m=np.full(size, 1 / dt),
        is_force=np.ones(size, dtype=np.bool_),
        is_balance=np.zeros(size, dtype=np.bool_),
    )
