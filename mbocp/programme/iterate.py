"""An iterate of a stagewise programme: primal unknowns and multipliers, in the programme's own scaling."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp.exceptions import DimensionMismatch

if TYPE_CHECKING:
    from mbocp._native._kernel import Programme as KernelProgramme
    from mbocp.programme.stagewise import StagewiseProgramme


@dataclass(frozen=True)
class BoundMultipliers:
    """Multipliers of inequalities, positive where an upper bound is active.

    Attributes
    ----------
    xs : ndarray, shape (N + 1, nx)
        Of the bounds on states.
    us : ndarray, shape (N, nu)
        Of the bounds on controls.
    path : ndarray, shape (N, nh)
        Of the path functions at the nodes 1..N.
    guard : ndarray, shape (num_guards,)
        Of what guards the end condition.
    """

    xs: Array
    us: Array
    path: Array
    guard: Array

    def __post_init__(self) -> None:
        for name in ("xs", "us", "path", "guard"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))


@dataclass(frozen=True)
class Iterate:
    """Unknowns of a programme with stages of one size.

    Attributes
    ----------
    xs : ndarray, shape (N + 1, nx)
        States.
    ys : ndarray, shape (N, ny)
        Algebraic unknowns of each step.
    us : ndarray, shape (N, nu)
        Controls.
    ms : ndarray, shape (N, ndx + ny)
        Multipliers of each step's rows.
    eta : ndarray, shape (ng,)
        Multiplier of the end condition.
    bounds : BoundMultipliers, optional
        Of inequalities, where a solver keeps them.
    """

    xs: Array
    ys: Array
    us: Array
    ms: Array
    eta: Array
    bounds: BoundMultipliers | None = None

    def __post_init__(self) -> None:
        for name in ("xs", "ys", "us", "ms", "eta"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))

    def check(self, programme: StagewiseProgramme) -> None:
        """Raise DimensionMismatch unless the shapes are those of `programme`."""
        for name, shape in programme.shapes.items():
            got = getattr(self, name).shape
            if got != shape:
                raise DimensionMismatch(f"iterate.{name}", got=got, expected=shape)

    def load_into(self, native: KernelProgramme) -> None:
        """Write the iterate into a kernel programme."""
        native.x, native.y, native.u = self.xs.ravel(), self.ys.ravel(), self.us.ravel()
        native.m, native.eta = self.ms.ravel(), self.eta

    @classmethod
    def read_from(
        cls, native: KernelProgramme, programme: StagewiseProgramme, bounds: BoundMultipliers | None = None
    ) -> Iterate:
        """Copy the iterate of a kernel programme, without the multipliers of its limits."""
        N, kind = programme.num_steps, programme.kind
        return cls(
            xs=native.x.reshape(N + 1, kind.nx),
            ys=native.y.reshape(N, kind.ny),
            us=native.u.reshape(N, kind.nu),
            ms=native.m.reshape(N, kind.ndx + kind.ny),
            eta=native.eta,
            bounds=bounds,
        )


def zero_multipliers(programme: StagewiseProgramme, xs: Array, ys: Array, us: Array) -> Iterate:
    """Iterate with mu = zeta = eta = 0, the start of the paper's monolithic runs."""
    kind = programme.kind
    return Iterate(
        xs=xs,
        ys=ys,
        us=us,
        ms=np.zeros((programme.num_steps, kind.ndx + kind.ny)),
        eta=np.zeros(programme.ng),
    )
