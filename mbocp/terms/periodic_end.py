"""Conditions on a free start: constraints hold there, and the end of a periodic motion is its image.

They are functions of the last state, which remembers the move of the start:
`mbocp.formulation.features.moved_start`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, field
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.mechanics.held_frames import HeldFrame, write_held_jacobian, write_held_rows
from mbocp.terms.point import Point, Sizes


@dataclass(frozen=True)
class StartState:
    r"""The start :math:`(\bar q \exp(E_q w), \bar v + E_v w)` as the end knows it.

    Attributes
    ----------
    sizes : Sizes
        Of the configurations.
    free : tuple of int
        Free directions of (q, v), those of w.
    z, v : ndarray, shapes (nz,) and (nv,)
        The given start.
    """

    sizes: Sizes
    free: tuple[int, ...]
    z: Array = field(compare=False)
    v: Array = field(compare=False)

    @property
    def remembers(self) -> tuple[str, ...]:
        """The move w, where anything is free."""
        return ("start",) if self.free else ()

    def parameters(self, prefix: str) -> dict[str, int]:
        """The given start."""
        return {f"{prefix}.z": self.sizes.nz, f"{prefix}.v": self.sizes.nv}

    def numbers(self, prefix: str) -> dict[str, Array]:
        """Its values."""
        return {f"{prefix}.z": np.asarray(self.z), f"{prefix}.v": np.asarray(self.v)}

    def expression(self, at: Point, p: Mapping[str, ca.SX], prefix: str) -> tuple[ca.SX, ca.SX]:
        """Coordinates and velocity, shapes (nz,) and (nv,)."""
        nv = self.sizes.nv
        move = ca.SX.zeros(2 * nv)
        for k, i in enumerate(self.free):
            move[i] = at.remembered["start"][k]
        return at.mechanics.integrate(p[f"{prefix}.z"], move[:nv]), p[f"{prefix}.v"] + move[nv:]


@dataclass(frozen=True)
class KeptRows:
    """Rows of constraints by number.

    Attributes
    ----------
    own : tuple of int
        Of the robot's constraints.
    held : tuple of int
        Of the held frames, all of them one after the other.
    """

    own: tuple[int, ...] = ()
    held: tuple[int, ...] = ()

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.own) + len(self.held)


@dataclass(frozen=True)
class _OfStart:
    """What conditions at the end share that look at the start of the motion."""

    start: StartState

    is_cost: ClassVar[bool] = False
    weights: ClassVar[tuple[str, ...]] = ()

    @property
    def remembers(self) -> tuple[str, ...]:
        """See `StartState`."""
        return self.start.remembers


@dataclass(frozen=True)
class StartEnd(_OfStart):
    r"""Constraints at the free start, :math:`\Phi(q_0) = 0` and :math:`\Phi_q v_0 = 0`.

    Attributes
    ----------
    start : StartState
    places, rates : KeptRows
        Which rows are conditions on the configuration, and which on the velocity.
    held : tuple of HeldFrame
        Frames whose rows are counted.
    """

    places: KeptRows
    rates: KeptRows
    held: tuple[HeldFrame, ...] = ()

    @property
    def rows(self) -> int:
        """Number of conditions."""
        return self.places.count + self.rates.count

    @property
    def signature(self) -> dict[str, Any]:
        """What its functions depend on."""
        kept = [asdict(rows) for rows in (self.places, self.rates)]
        held = [frame.signature for frame in self.held]
        return {"term": "start", "free": self.start.free, "kept": kept, "held": held}

    def parameters(self) -> dict[str, int]:
        """The given start."""
        return self.start.parameters("start")

    def numbers(self) -> dict[str, Array]:
        """Its values."""
        return self.start.numbers("start")

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Rows that are zero where the start keeps the constraints."""
        (z, v), own = self.start.expression(at, p, "start"), at.mechanics
        places = own.constraints(z)[list(self.places.own), 0]
        held = write_held_rows(self.held, own, z, z)[list(self.places.held), 0]
        rates = (own.constraint_jacobian(z) @ v)[list(self.rates.own), 0]
        held_rates = (write_held_jacobian(self.held, own, z) @ v)[list(self.rates.held), 0]
        return ca.vertcat(places, held, rates, held_rates)


@dataclass(frozen=True)
class PeriodicEnd(_OfStart):
    r"""End less image of the start: :math:`D_q (q_N \ominus S(q_0))` and :math:`D_v (v^+ - A v_0)`.

    Attributes
    ----------
    start : StartState
    D_q, D_v : ndarray, shapes (any, nv)
        Which directions are compared: all, or those that constraints leave.
    A_z, A : ndarray, shapes (nz, nz) and (nv, nv)
        The symmetry in coordinates and velocities.
    moved : ndarray, shape (nz,)
        How far the image is moved.
    rows_q, rows_v : int
        Rows of the projections.
    frame_id : int
        Frame whose origin comes to rest by an impact before velocities are compared; -1: none does.
    axes : tuple of int
        Axes of the world along which it can move.
    """

    rows_q: int
    rows_v: int
    frame_id: int
    axes: tuple[int, ...]
    D_q: Array = field(compare=False)
    D_v: Array = field(compare=False)
    A_z: Array = field(compare=False)
    A: Array = field(compare=False)
    moved: Array = field(compare=False)

    @property
    def rows(self) -> int:
        """Number of conditions."""
        return self.rows_q + self.rows_v

    @property
    def signature(self) -> dict[str, Any]:
        """What its functions depend on."""
        shape = {name: getattr(self, name) for name in ("rows_q", "rows_v", "frame_id", "axes")}
        return {"term": "periodic", "free": self.start.free, **shape}

    def parameters(self) -> dict[str, int]:
        """The given start, the symmetry and the projections, matrices by columns."""
        own = {f"periodic.{name}": value.size for name, value in self._values.items()}
        return {**self.start.parameters("periodic"), **own}

    def numbers(self) -> dict[str, Array]:
        """Value of each parameter."""
        own = {f"periodic.{name}": value.ravel(order="F") for name, value in self._values.items()}
        return {**self.start.numbers("periodic"), **own}

    @property
    def _values(self) -> dict[str, Array]:
        return {name: np.asarray(getattr(self, name)) for name in ("D_q", "D_v", "A_z", "A", "moved")}

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Rows that are zero in a cycle."""
        z, v = self.start.expression(at, p, "periodic")
        named = self._values
        D_q, D_v, A_z, A = (
            ca.reshape(p[f"periodic.{n}"], *named[n].shape) for n in ("D_q", "D_v", "A_z", "A")
        )
        between = at.mechanics.end_difference(A_z @ z + p["periodic.moved"], at.q)
        return ca.vertcat(D_q @ between, D_v @ (self._after_impact(at) - A @ v))

    def _after_impact(self, at: Point) -> ca.SX:
        """Velocity after the impact; M (v+ - v) = J'L and J v+ = 0 as one system."""
        if self.frame_id < 0:
            return at.v
        mechanics = at.mechanics
        J = mechanics.frame_translation_jacobian(self.frame_id, at.q)[list(self.axes), :]
        W = ca.ldl_solve(J.T, *ca.ldl(mechanics.mass_matrix(at.q)))
        impulse = ca.solve(J @ W, J @ at.v)
        return at.v - W @ impulse
