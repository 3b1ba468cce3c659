"""Where the unknowns and rows of a stagewise programme are in a nonlinear programme.

Unknowns, node after node: x_0, w_0, x_1, w_1, ..., x_N with w = (u, y). Rows, likewise: what a step demands,
then what a node demands: the given start at the first, path constraints at the others, end condition, its
guard and path constraints at the last.

A solver of optimal control problems (fatrop) wants every step as a gap x_{n+1} - F(x_n, w_n). Explicit
schemes have that form. Others are lifted: the next state is one more piece of w, the gap compares it with
x_{n+1}, and the step's own rows are constraints of the node.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

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
        rows: Index = self._row_starts[-1] + np.arange(self.ng, dtype=np.int64)
        return rows

    @cached_property
    def guards(self) -> Index:
        """Rows of the guards, shape (num_guards,)."""
        rows: Index = self._row_starts[-1] + self.ng + np.arange(self.num_guards, dtype=np.int64)
        return rows

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
