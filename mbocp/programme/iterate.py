"""An iterate of a stagewise programme: primal unknowns and multipliers, in the programme's own scaling."""

from __future__ import annotations

from dataclasses import field, replace
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, dataclass, frozen_array
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
    is_rest : bool
        Whether it is the rest of a motion that was optimal, whose limits' multipliers are nearly its own.
    """

    xs: Array
    ys: Array
    us: Array
    ms: Array
    eta: Array
    bounds: BoundMultipliers | None = None
    is_rest: bool = False

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


@dataclass(frozen=True, eq=False)
class IterateRecord:
    """An iterate, and what its numbers are.

    Attributes
    ----------
    iterate : Iterate
    names : tuple of str
        Of the columns of `iterate.bounds.path`.
    meaning : str
        Digest of what its unknowns and multipliers are, but for those of path constraints; "": nobody says.
    room : ndarray, shape (num_pairs,)
        Of each pair of things that keep apart what its row keeps beyond the margin [m]; -1: it has no row.
    limits_within : str
        Letters of the limits that hold within steps, too.
    q_end : ndarray, shape (nq,)
        Configuration at which conditions of the end were chosen; empty: that of the goal.
    q_start : ndarray, shape (nq,)
        Start that a solve of a robot that is found began with; empty: that of the problem.
    first : ndarray, shape (parameters,)
        Of what is found of the robot the values that a solve began with, and chose its conditions by.
    """

    iterate: Iterate
    names: tuple[str, ...]
    meaning: str = ""
    room: Array = field(default_factory=lambda: np.zeros(0))
    limits_within: str = ""
    q_end: Array = field(default_factory=lambda: np.zeros(0))
    q_start: Array = field(default_factory=lambda: np.zeros(0))
    first: Array = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(cls, iterate: Iterate, programme: StagewiseProgramme) -> IterateRecord:
        """An iterate of a programme."""
        return cls(iterate, () if iterate.bounds is None else programme.path_names)

    def between(self, nodes: Array) -> IterateRecord:
        """The same with other nodes, each at a place in numbers of its own, shape (M + 1,).

        What belongs to nodes is linear between them, what belongs to steps between their middles.
        """
        iterate, bounds, middles = self.iterate, self.iterate.bounds, (nodes[:-1] + nodes[1:] - 1.0) / 2.0
        if bounds is not None:
            us, path = (_rows_at(rows, middles) for rows in (bounds.us, bounds.path))
            bounds = replace(bounds, xs=_rows_at(bounds.xs, nodes), us=us, path=path)
        ys, us, ms = (_rows_at(rows, middles) for rows in (iterate.ys, iterate.us, iterate.ms))
        xs = _rows_at(iterate.xs, nodes)
        return replace(self, iterate=replace(iterate, xs=xs, ys=ys, us=us, ms=ms, bounds=bounds))

    def fits(self, programme: StagewiseProgramme) -> bool:
        """Whether a programme has unknowns and multipliers of the same shapes, but for path constraints."""
        shapes = programme.shapes
        is_plain = all(getattr(self.iterate, name).shape == shape for name, shape in shapes.items())
        bounds = self.iterate.bounds
        if bounds is None or not is_plain:
            return is_plain
        at_steps = bounds.path.shape == (programme.num_steps, len(self.names))
        of_bounds = bounds.xs.shape == shapes["xs"] and bounds.us.shape == shapes["us"]
        return at_steps and of_bounds and bounds.guard.shape == (programme.num_guards,)

    def into(self, programme: StagewiseProgramme) -> Iterate:
        """The same for a programme with other path constraints.

        Rows that both have, by their names, keep their multipliers; new ones begin without, and so do rows
        that share a name, unless all names are the same.
        """
        iterate, wanted = self.iterate, programme.path_names
        if iterate.bounds is None or wanted == self.names:
            return iterate
        known = _places(self.names)
        path = np.zeros((programme.num_steps, programme.bounds.nh))
        for name, place in _places(wanted).items():
            if name in known:
                path[:, place] = iterate.bounds.path[:, known[name]]
        return replace(iterate, bounds=replace(iterate.bounds, path=path))


def _rows_at(rows: Array, places: Array) -> Array:
    """Rows at places in numbers of them, linear between two; beyond the first or the last that one."""
    left = np.clip(np.floor(places).astype(int), 0, max(len(rows) - 2, 0))
    share = np.clip(places - left, 0.0, 1.0)[:, None]
    right = np.minimum(left + 1, len(rows) - 1)
    found: Array = np.where(share == 1.0, rows[right], rows[left] + share * (rows[right] - rows[left]))
    return found


def _places(names: tuple[str, ...]) -> dict[str, int]:
    """Column of each name that there is once."""
    found, several = {}, set()
    for place, name in enumerate(names):
        if name in found:
            several.add(name)
        found[name] = place
    return {name: place for name, place in found.items() if name not in several}
