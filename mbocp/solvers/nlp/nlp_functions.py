"""The nonlinear programme's functions, out of the compiled functions of the stages.

Values, gradient, Jacobian and Hessian are gathered from what the stage functions give, mapped over all
stages, by one permutation each. Nothing is differentiated here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbocp._arrays import Array, dataclass
from mbocp.programme import StagewiseProgramme
from mbocp.solvers.nlp.nlp_layout import Index, NlpLayout

_INPUTS = ["x", "p", "lam_f", "lam_g"]  # of functions of the Lagrangian


def parameters(programme: StagewiseProgramme) -> Array:
    """Everything about a programme that is a number, for the functions of its shape."""
    return np.concatenate([programme.x_start, programme.theta, programme.rho.ravel(), programme.rho_terminal])


@dataclass(frozen=True)
class _Symbols:
    """Unknowns and parameters of the programme as symbols."""

    w: ca.MX
    p: ca.MX
    x0: ca.MX  # (nx, N)
    x1: ca.MX
    y: ca.MX
    u: ca.MX
    nodes: ca.MX  # (nx, N): x_1 ... x_N
    x_start: ca.MX
    theta: ca.MX
    rho: ca.MX
    rho_end: ca.MX


class NlpFunctions:
    """Functions of w (unknowns) and p (parameters) for a programme's shape and number of steps.

    Parameters
    ----------
    programme : StagewiseProgramme
        Its numbers do not matter, see `parameters`.
    layout : NlpLayout

    Attributes
    ----------
    f, g, jac_g : casadi.Function
        (w, p) -> cost; constraints; constraints and Jacobian.
    """

    def __init__(self, programme: StagewiseProgramme, layout: NlpLayout) -> None:
        self._programme, self.layout = programme, layout
        self._stage = {
            name: programme.functions.function(name)
            for name in ("values", "gradient", "jacobian", "complete")
        }
        self._end = {
            name: programme.end_functions.function(name) for name in ("terminal_values", "terminal_complete")
        }
        if layout.nh:
            self._stage["path"] = programme.functions.function("path")
        if layout.num_guards:
            self._end["guard"] = programme.end_functions.function("guard")
        self.f = self._make("nlp_f", self._cost, ["f"])
        self.g = self._make("nlp_g", lambda at: [self._constraints(at, self._map("values", at)[0])], ["g"])
        self.jac_g = self._make("nlp_jac_g", self._constraints_and_jacobian, ["g", "jac_g_x"])

    def gradient(self, *, has_cost: bool) -> ca.Function:
        """(w, p) -> gradient of the cost, with the cost before it if so wanted."""
        if has_cost:
            return self._make(
                "nlp_grad_f", lambda at: [*self._cost(at), self._gradient(at)], ["f", "grad_f_x"]
            )
        return self._make("nlp_grad_f", lambda at: [self._gradient(at)], ["grad_f_x"])

    def first_order(self) -> ca.Function:
        """(w, p, lam_f, lam_g) -> cost, constraints, gradient of the Lagrangian; nothing in p's direction."""
        at = self._arguments()
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.layout.num_rows)
        g, jacobian = self._constraints_and_jacobian(at)
        slopes = lam_f * self._gradient(at) + ca.mtimes(jacobian.T, lam_g)
        return ca.Function(
            "nlp_grad",
            [at.w, at.p, lam_f, lam_g],
            [*self._cost(at), g, slopes, ca.MX.zeros(at.p.shape)],
            _INPUTS,
            ["f", "g", "grad_gamma_x", "grad_gamma_p"],
        )

    def hessian(self, *, is_upper: bool) -> ca.Function:
        """(w, p, lam_f, lam_g) -> Hessian of the Lagrangian.

        Its upper triangle alone; or all of it, behind the place of a gradient that fatrop never reads, and
        which is zero here.
        """
        at = self._arguments()
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.layout.num_rows)
        m = self.layout.sign * _take(lam_g, self.layout.steps)
        blocks = self._map("complete", at, scale=lam_f, m=m)[4]
        hessian = self._hessian(at, lam_f, lam_g, blocks, is_upper=is_upper)
        if not is_upper:
            hessian = finite_or_zero(hessian)
        outputs, words = [hessian], ["triu_hess_gamma_x_x"]
        if not is_upper:
            outputs, words = [ca.MX.zeros(at.w.shape), hessian], ["grad_gamma_x", "hess_gamma_x_x"]
        return ca.Function("nlp_hess_l", [at.w, at.p, lam_f, lam_g], outputs, _INPUTS, words)

    def _constraints_and_jacobian(self, at: _Symbols) -> list[ca.MX]:
        stages = self._map("jacobian", at)
        return [self._constraints(at, stages[0]), self._jacobian(at, stages[2])]

    def _make(
        self, name: str, body: Callable[[_Symbols], list[ca.MX]], outputs: Sequence[str]
    ) -> ca.Function:
        at = self._arguments()
        return ca.Function(name, [at.w, at.p], body(at), ["x", "p"], list(outputs))

    def _arguments(self) -> _Symbols:
        lay, pro = self.layout, self._programme
        N, nr = lay.num_steps, pro.kind.nr
        sizes = [lay.nx, pro.theta.size, N * nr, pro.rho_terminal.size]
        w, p = ca.MX.sym("x", lay.num_unknowns), ca.MX.sym("p", sum(sizes))
        x_start, theta, rho, rho_end = ca.vertsplit(p, [0, *np.cumsum(sizes).tolist()])
        blocks = ca.reshape(w[: N * lay.block], lay.block, N)
        last = w[N * lay.block :]
        x0 = blocks[: lay.nx, :]
        nodes = ca.horzcat(x0[:, 1:], last)
        u, y = blocks[lay.nx : lay.nx + lay.nu, :], blocks[lay.nx + lay.nu : lay.nx + lay.nu + lay.ny, :]
        x1 = blocks[lay.nx + lay.nu + lay.ny :, :] if lay.is_lifted else nodes
        return _Symbols(w, p, x0, x1, y, u, nodes, x_start, theta, ca.reshape(rho, nr, N), rho_end)

    def _map(
        self, name: str, at: _Symbols, *, scale: ca.MX | None = None, m: ca.MX | None = None
    ) -> list[ca.MX]:
        """Outputs of a stage function at all stages, side by side; the costs scaled."""
        N = self.layout.num_steps
        theta = ca.repmat(self._scale(at.theta, self._programme.theta_weights, scale), 1, N)
        between = [] if m is None else [m]
        return list(
            self._stage[name].map(N).call([at.x0, at.x1, at.y, at.u, *between, theta, at.rho], False, True)
        )

    @staticmethod
    def _scale(numbers: ca.MX, mask: NDArray[np.bool_], scale: ca.MX | None) -> ca.MX:
        if scale is None:
            return numbers
        chosen = ca.DM(mask.astype(float))
        return numbers * (1 + chosen * (scale - 1))

    def _cost(self, at: _Symbols) -> list[ca.MX]:
        psi = self._end["terminal_values"](at.nodes[:, -1], at.rho_end)[0]
        return [ca.sum2(self._map("values", at)[1]) + psi]

    def _constraints(self, at: _Symbols, rows: ca.MX) -> ca.MX:
        lay = self.layout
        c = lay.sign * rows
        of_step = ca.vertcat(at.nodes - at.x1, c) if lay.is_lifted else c
        start = at.x0[:, 0] - at.x_start
        end = [self._end["terminal_values"](at.nodes[:, -1], at.rho_end)[1]]
        if lay.num_guards:
            end.append(self._guard(at)[0])
        inner = of_step[:, 1:]
        if lay.nh:
            h = self._path(at)[0]
            inner, last = ca.vertcat(inner, h[:, :-1]), h[:, -1]
            end.append(last)
        return ca.vertcat(of_step[:, 0], start, ca.vec(inner), *end)

    def _path(self, at: _Symbols, m: ca.MX | None = None) -> list[ca.MX]:
        N, lay = self.layout.num_steps, self.layout
        m = ca.MX.zeros(lay.nh, N) if m is None else m
        theta = ca.repmat(at.theta, 1, N)
        return list(
            self._stage["path"].map(N).call([at.nodes, m, ca.MX.zeros(lay.nu, N), theta], False, True)
        )

    def _guard(self, at: _Symbols, m: ca.MX | None = None) -> list[ca.MX]:
        m = ca.MX.zeros(self.layout.num_guards) if m is None else m
        return list(self._end["guard"].call([at.nodes[:, -1], m, at.rho_end]))

    def _terminal(self, at: _Symbols, eta: ca.MX | None = None, scale: ca.MX | None = None) -> list[ca.MX]:
        eta = ca.MX.zeros(self.layout.ng) if eta is None else eta
        rho = self._scale(at.rho_end, self._programme.terminal_weights, scale)
        return list(self._end["terminal_complete"].call([at.nodes[:, -1], eta, rho]))

    def _gradient(self, at: _Symbols) -> ca.MX:
        lay, N = self.layout, self.layout.num_steps
        entries = _Entries()
        slopes = self._map("gradient", at)[0]
        _, columns = _pattern(self._stage["gradient"].sparsity_out(0))
        positions = lay.zs[:, columns]
        entries.add(positions.ravel(), np.zeros(positions.size, np.int64), slopes.nz[:])
        _, columns = _pattern(self._end["terminal_complete"].sparsity_out(3))
        of_end = self._terminal(at)[3].nz[:]
        entries.add(lay.xs[N][columns], np.zeros(columns.size, np.int64), of_end)
        return entries.gather((lay.num_unknowns, 1), is_dense=True)

    def _jacobian(self, at: _Symbols, blocks: ca.MX) -> ca.MX:
        lay, N = self.layout, self.layout.num_steps
        entries = _Entries()
        rows, columns = _pattern(self._stage["jacobian"].sparsity_out(2))
        values = lay.sign * blocks.nz[:]
        entries.add(lay.steps[:, rows].ravel(), lay.zs[:, columns].ravel(), values)
        if lay.is_lifted:
            entries.constant(lay.gaps.ravel(), lay.xs[1:].ravel(), 1.0)
            entries.constant(lay.gaps.ravel(), lay.x_nexts.ravel(), -1.0)
        entries.constant(lay.start, lay.xs[0], 1.0)
        rows, columns = _pattern(self._end["terminal_complete"].sparsity_out(2))
        entries.add(lay.end[rows], lay.xs[N][columns], self._terminal(at)[2].nz[:])
        if lay.num_guards:
            rows, columns = _pattern(self._end["guard"].sparsity_out(1))
            entries.add(lay.guards[rows], lay.xs[N][columns], self._guard(at)[1].nz[:])
        if lay.nh:
            rows, columns = _pattern(self._stage["path"].sparsity_out(1))
            entries.add(lay.path[:, rows].ravel(), lay.xs[1:, columns].ravel(), self._path(at)[1].nz[:])
        return entries.gather((lay.num_rows, lay.num_unknowns))

    def _hessian(self, at: _Symbols, lam_f: ca.MX, lam_g: ca.MX, blocks: ca.MX, *, is_upper: bool) -> ca.MX:
        lay, N = self.layout, self.layout.num_steps
        entries = _Entries()

        def add(unknowns: Index, pattern: ca.Sparsity, values: ca.MX) -> None:
            rows, columns = _pattern(pattern)
            i, j = unknowns[..., rows].ravel(), unknowns[..., columns].ravel()
            low, high, numbers = np.minimum(i, j), np.maximum(i, j), ca.reshape(values.nz[:], -1, 1)
            entries.add(low, high, numbers)
            if not is_upper:
                apart = np.flatnonzero(low != high)
                entries.add(high[apart], low[apart], numbers.nz[apart.tolist()])

        add(lay.zs, self._stage["complete"].sparsity_out(4), blocks)
        end = self._terminal(at, lam_g[lay.end.tolist()], lam_f)[4]
        add(lay.xs[N], self._end["terminal_complete"].sparsity_out(4), end)
        if lay.num_guards:
            curvature = self._guard(at, lam_g[lay.guards.tolist()])[2]
            add(lay.xs[N], self._end["guard"].sparsity_out(2), curvature)
        if lay.nh:
            curvature = self._path(at, _take(lam_g, lay.path))[2]
            add(lay.xs[1:], self._stage["path"].sparsity_out(2), curvature)
        return entries.gather((lay.num_unknowns, lay.num_unknowns))


# Where an entry is not finite, fatrop raises its shift for ever, and looks at no clock: unless the whole
# Jacobian is no number, which ends the solve. A Hessian that is zero leaves the curvature to the shift.


def all_or_none(matrix: ca.MX) -> ca.MX:
    """The matrix; with one entry that is not finite, none of them is a number."""
    return ca.MX(matrix.sparsity(), matrix.nz[:] + ca.if_else(_is_finite(matrix), 0.0, np.nan))


# Of an explicit step: how much it multiplies the distance of two motions. A motion that is resolved is far
# below; fatrop's loop is endless from 250 on in the worst case that is known, where round-off takes the
# curvature at any shift.
_MOST_GROWTH = 100.0


def calm_or_none(jacobian: ca.MX, layout: NlpLayout) -> ca.MX:
    r"""The Jacobian; none of it is a number if an explicit step multiplies distances by more than a hundred.

    The measure is one of the eigenvalues of :math:`A = \partial x_{n+1} / \partial x_n`, whatever the units:

    .. math:: \max\left(\tfrac{|\mathrm{tr} A|}{n_x}, \sqrt{\tfrac{|\mathrm{tr} A^2|}{n_x}}\right)
    """
    rows, columns = layout.gaps[:, : layout.nx, None], layout.xs[:-1, None, :]
    values = ca.vertcat(0.0, jacobian.nz[:])

    def entries(i: Index, j: Index) -> ca.MX:
        """Of many places, one row for each step."""
        places = _places(jacobian.sparsity(), *np.broadcast_arrays(i, j))
        return ca.reshape(values[places.ravel().tolist()], places.shape[1], places.shape[0]).T

    N, nx = layout.num_steps, layout.nx
    i, j = (grid.ravel() for grid in np.indices((nx, nx)))
    every = np.arange(N)[:, None]
    A = entries(rows[every, i, 0], columns[every, 0, j])
    transposed = entries(rows[every, j, 0], columns[every, 0, i])
    diagonal = entries(rows[:, :, 0], columns[:, 0, :])
    growth = ca.fmax(ca.fabs(ca.sum2(diagonal)) / nx, ca.sqrt(ca.fabs(ca.sum2(A * transposed)) / nx))
    is_calm = ca.mmax(growth) <= _MOST_GROWTH
    return ca.MX(jacobian.sparsity(), jacobian.nz[:] + ca.if_else(is_calm, 0.0, np.nan))


def _places(sparsity: ca.Sparsity, rows: Index, columns: Index) -> Index:
    """Numbers of the nonzeros at some places, from one on; zero where there is none."""
    from scipy import sparse  # slow to import, and wanted only by solvers of others

    numbers = sparse.csc_matrix(
        (np.arange(1, sparsity.nnz() + 1), np.array(sparsity.row()), np.array(sparsity.colind())),
        shape=sparsity.shape,
    )
    return np.asarray(numbers.tocsr()[rows.ravel(), columns.ravel()]).reshape(rows.shape)


def finite_or_zero(matrix: ca.MX) -> ca.MX:
    """The matrix; with one entry that is not finite, zero."""
    return ca.MX(matrix.sparsity(), ca.if_else(_is_finite(matrix), matrix.nz[:], 0.0))


def _is_finite(matrix: ca.MX) -> ca.MX:
    return ca.fabs(ca.sum1(ca.reshape(matrix.nz[:], -1, 1))) < ca.inf


def _take(vector: ca.MX, rows: Index) -> ca.MX:
    """Entries of a vector as a matrix, one column for each row of `rows`."""
    return ca.reshape(vector.nz[rows.ravel().tolist()], rows.shape[1], rows.shape[0])


def _pattern(sparsity: ca.Sparsity) -> tuple[Index, Index]:
    """Rows and columns of the nonzeros, in their order."""
    rows, columns = sparsity.get_triplet()
    return np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64)


class _Entries:
    """Entries of a sparse matrix from several vectors of values; those at one place add up."""

    def __init__(self) -> None:
        self._rows: list[Index] = []
        self._columns: list[Index] = []
        self._values: list[ca.MX] = []

    def add(self, rows: Index, columns: Index, values: ca.MX) -> None:
        """Values at places."""
        self._rows.append(np.asarray(rows, dtype=np.int64))
        self._columns.append(np.asarray(columns, dtype=np.int64))
        self._values.append(ca.reshape(values, values.numel(), 1))

    def constant(self, rows: Index, columns: Index, value: float) -> None:
        """One value at places."""
        self.add(rows, columns, ca.MX(ca.DM.ones(len(rows), 1) * value))

    def gather(self, shape: tuple[int, int], *, is_dense: bool = False) -> ca.MX:
        """The matrix, sparse, or with zeros wherever nothing was added."""
        rows, columns = np.concatenate(self._rows), np.concatenate(self._columns)
        sparse = ca.Sparsity.triplet(*shape, rows.tolist(), columns.tolist())
        sparsity = ca.Sparsity.dense(*shape) if is_dense else sparse
        places, size = sparsity.get_nz((rows + columns * sparsity.shape[0]).tolist()), rows.size
        adds = ca.DM.triplet(places, list(range(size)), ca.DM.ones(size), sparsity.nnz(), size)
        return ca.MX(sparsity, ca.densify(adds @ ca.vertcat(*self._values)))
