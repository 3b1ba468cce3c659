"""Where the unknowns and rows of a stagewise programme are in a nonlinear programme.

Unknowns, node after node: x_0, w_0, x_1, w_1, ..., x_N with w = (u, y). Rows, likewise: what a step demands,
then what a node demands: the given start at the first, path constraints at the others, end condition, its
guard and path constraints at the last.

A solver of optimal control problems (fatrop) wants every step as a gap x_{n+1} - F(x_n, w_n). Explicit
schemes have that form. Others are lifted: the next state is one more piece of w, the gap compares it with
x_{n+1}, and the step's own rows are constraints of the node.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import ProblemError
from mbocp.programme import StagewiseProgramme

Index = NDArray[np.int64]


@dataclass(frozen=True)
class NlpLayout:
    """Positions in a nonlinear programme.

    Attributes
    ----------
    num_steps : int
        N.
    nx, nu, ny : int
        State, control, algebraic unknowns.
    ng, num_guards, nh : int
        End condition, its guards, path constraints at each node but the first.
    rows_are_gaps : bool
        Whether the step's rows are F(x_n, u_n) - x_{n+1}.
    is_lifted : bool
        Whether w holds a copy of the next state.
    """

    num_steps: int
    nx: int
    nu: int
    ny: int
    ng: int
    num_guards: int
    nh: int
    rows_are_gaps: bool
    is_lifted: bool

    @classmethod
    def of(cls, programme: StagewiseProgramme, *, wants_gaps: bool) -> NlpLayout:
        """Layout of a programme; `wants_gaps`: every step as a gap."""
        kind = programme.kind
        return cls(
            num_steps=programme.num_steps,
            nx=kind.nx,
            nu=kind.nu,
            ny=kind.ny,
            ng=programme.ng,
            num_guards=programme.num_guards,
            nh=programme.bounds.nh,
            rows_are_gaps=programme.rows_are_gaps,
            is_lifted=wants_gaps and not programme.rows_are_gaps,
        )

    @property
    def nw(self) -> int:
        """Unknowns of a step beside its state."""
        return self.nu + self.ny + (self.nx if self.is_lifted else 0)

    @property
    def nc(self) -> int:
        """Rows of a step."""
        return self.nx + self.ny

    @property
    def block(self) -> int:
        """Unknowns of a node and the step after it."""
        return self.nx + self.nw

    @property
    def num_unknowns(self) -> int:
        """Length of the vector of unknowns."""
        return self.num_steps * self.block + self.nx

    @property
    def rows_of_node(self) -> tuple[int, ...]:
        """Rows of each node that are no gaps, length N + 1."""
        own = self.nc if self.is_lifted else 0
        first, last = own + self.nx, self.ng + self.num_guards + self.nh
        return (first, *[own + self.nh] * (self.num_steps - 1), last)

    @property
    def num_rows(self) -> int:
        """Number of constraints."""
        return self.num_steps * self.rows_of_step + sum(self.rows_of_node)

    @property
    def rows_of_step(self) -> int:
        """Rows that join a node to the next."""
        return self.nx if self.is_lifted else self.nc

    @cached_property
    def xs(self) -> Index:
        """Unknowns of the states, shape (N + 1, nx)."""
        return self._starts(self.num_steps + 1)[:, None] + np.arange(self.nx)

    @cached_property
    def us(self) -> Index:
        """Unknowns of the controls, shape (N, nu)."""
        return self._starts(self.num_steps)[:, None] + self.nx + np.arange(self.nu)

    @cached_property
    def ys(self) -> Index:
        """Algebraic unknowns, shape (N, ny)."""
        return self._starts(self.num_steps)[:, None] + self.nx + self.nu + np.arange(self.ny)

    @cached_property
    def x_nexts(self) -> Index:
        """Unknowns that a step's rows take for its end, shape (N, nx)."""
        if not self.is_lifted:
            return self.xs[1:]
        return self._starts(self.num_steps)[:, None] + self.nx + self.nu + self.ny + np.arange(self.nx)

    @cached_property
    def zs(self) -> Index:
        """Unknowns of each step in the order of its derivatives (x1, y, x0, u)."""
        return np.hstack([self.x_nexts, self.ys, self.xs[:-1], self.us])

    @cached_property
    def _row_starts(self) -> Index:
        """First row of each node, length N + 1."""
        sizes = [self.rows_of_step + rows for rows in self.rows_of_node[:-1]]
        return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)

    @cached_property
    def gaps(self) -> Index:
        """Rows that join nodes, shape (N, rows_of_step)."""
        return self._row_starts[:-1, None] + np.arange(self.rows_of_step)

    @cached_property
    def steps(self) -> Index:
        """Rows of the steps' own equations, shape (N, nc)."""
        if not self.is_lifted:
            return self.gaps
        return self._row_starts[:-1, None] + self.rows_of_step + np.arange(self.nc)

    @cached_property
    def start(self) -> Index:
        """Rows of the given start, shape (nx,)."""
        return np.arange(self.nx) + self.rows_of_step + (self.nc if self.is_lifted else 0)

    @cached_property
    def end(self) -> Index:
        """Rows of the end condition, shape (ng,)."""
        return self._row_starts[-1] + np.arange(self.ng, dtype=np.int64)

    @cached_property
    def guards(self) -> Index:
        """Rows of the guards, shape (num_guards,)."""
        return self._row_starts[-1] + self.ng + np.arange(self.num_guards, dtype=np.int64)

    @cached_property
    def path(self) -> Index:
        """Rows of the path constraints at the nodes 1..N, shape (N, nh)."""
        own = self.rows_of_step + (self.nc if self.is_lifted else 0)
        inner = self._row_starts[1:-1, None] + own
        last = self._row_starts[-1:, None] + self.ng + self.num_guards
        return np.vstack([inner, last]) + np.arange(self.nh)

    @property
    def sign(self) -> float:
        """Factor from the step's rows to those here: gaps are x_{n+1} - F."""
        return -1.0 if self.rows_are_gaps else 1.0

    def _starts(self, count: int) -> Index:
        return np.arange(count, dtype=np.int64) * self.block


_FATROP_RELAXES = 1e-8  # relative to a bound, absolute below one
_INSTEAD = 'take "monolithic" or "ipopt"'


def bounds_of(programme: StagewiseProgramme, lay: NlpLayout) -> dict[str, Array]:
    """Bounds of unknowns and rows, under the names of a solver's arguments."""
    given = programme.bounds
    lbx, ubx = np.full(lay.num_unknowns, -np.inf), np.full(lay.num_unknowns, np.inf)
    lbx[lay.xs[1:]], ubx[lay.xs[1:]] = given.x_lower, given.x_upper
    lbx[lay.us], ubx[lay.us] = given.u_lower, given.u_upper
    lbg, ubg = np.zeros(lay.num_rows), np.zeros(lay.num_rows)
    lbg[lay.path], ubg[lay.path] = given.path_lower, given.path_upper
    ubg[lay.guards] = np.inf
    return {"lbx": lbx, "ubx": ubx, "lbg": lbg, "ubg": ubg}


def miss(values: Array, bounds: dict[str, Array], letter: str) -> Array:
    """By how much values miss their bounds, those of the unknowns ("x") or of the rows ("g")."""
    lower, upper = bounds[f"lb{letter}"], bounds[f"ub{letter}"]
    return np.maximum(lower - values, 0.0) + np.maximum(values - upper, 0.0)


def kinds_of_bounds(programme: StagewiseProgramme) -> bytes:
    """Tell one programme from another by which bounds there are, and which of them are equations."""
    bounds = programme.bounds
    is_equation = bounds.lower == bounds.upper
    return b"".join(kinds.tobytes() for kinds in (bounds.lower > -np.inf, bounds.upper < np.inf, is_equation))


def tighten(bounds: dict[str, Array]) -> dict[str, Array]:
    """Bounds less the part by which fatrop relaxes them, so that those given are kept."""
    found: dict[str, Array] = {}
    for letter in "xg":
        lower, upper = _inside(bounds[f"lb{letter}"], bounds[f"ub{letter}"])
        found |= {f"lb{letter}": lower, f"ub{letter}": upper}
    return found


def _inside(lower: Array, upper: Array) -> tuple[Array, Array]:
    is_range = lower < upper
    sides = []
    for bound, sign in ((lower, 1.0), (upper, -1.0)):
        is_relaxed = np.isfinite(bound) & is_range
        by = np.where(is_relaxed, _FATROP_RELAXES * np.maximum(1.0, np.abs(bound)), 0.0)
        sides.append(bound + sign * by)
    return sides[0], sides[1]


def check_fatrop_takes(programme: StagewiseProgramme) -> None:
    """Refuse what fatrop cannot solve, whatever the guess.

    Raises
    ------
    ProblemError
        If there are more equations than unknowns at the last node, which has no controls; or if a range is
        narrower than what fatrop relaxes it by, so that nothing would be left of it.
    """
    bounds, nx = programme.bounds, programme.kind.nx
    of_path = int(np.count_nonzero(bounds.path_lower[-1] == bounds.path_upper[-1]))
    ng = programme.ng
    if ng + of_path > nx:
        raise ProblemError(
            f'solver.method: "fatrop" takes at most {nx} equations at the last node, got {ng} of the '
            f"goal and {of_path} of path constraints; end these before it, or {_INSTEAD}"
        )
    lower, upper = _inside(bounds.lower, bounds.upper)
    narrow = np.argwhere((bounds.lower < bounds.upper) & (lower >= upper))
    if narrow.size:
        node, row = (int(place) for place in narrow[0])
        raise ProblemError(
            f'solver.method: "fatrop" relaxes limits by {_FATROP_RELAXES:g}, and {_name(programme, row)} may '
            f"vary by {bounds.upper[node, row] - bounds.lower[node, row]:.3g} alone; widen the limit, or "
            f"{_INSTEAD}"
        )


def _name(programme: StagewiseProgramme, row: int) -> str:
    """What a row of states, controls and path functions is called."""
    nx, nu = programme.bounds.x_lower.shape[1], programme.bounds.u_lower.shape[1]
    if row < nx:
        return f"entry {row} of the states"
    return f"control {row - nx}" if row < nx + nu else programme.describe_path(row - nx - nu)
