r"""Derivatives of a composition, link by link.

A step of a Runge-Kutta method evaluates the same few functions several times, at linear combinations of what
came before. Differentiated as one graph, its Hessian repeats every stage for every direction. Here each link
gives its own sparse derivatives, and the chain rule joins them:

.. math::
    \frac{da_k}{d\xi} &= L_k + \sum_{j<k} L_{kj} \frac{\partial\varphi_j}{\partial a_j} \frac{da_j}{d\xi} \\
    \nabla^2 (m \cdot F) &= \sum_k \frac{da_k}{d\xi}^T \nabla^2 (\bar o_k \cdot \varphi_k)(a_k)
        \frac{da_k}{d\xi}

with the arguments :math:`a_k` of the links, linear in :math:`\xi` and in the links' outputs, and the adjoints
:math:`\bar o_k` of these. For a step of eighteen unknowns this is an eighth of the operations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca

__all__ = ["Affine", "Chain"]


@dataclass(frozen=True)
class Affine:
    """A vector that is an affine function of the unknowns and of the links' outputs.

    Attributes
    ----------
    value : casadi.SX
        Its value.
    parts : dict of int to casadi.SX
        Matrix of each source: 0 is the vector of unknowns, k the output of link k.
    """

    value: ca.SX
    parts: dict[int, ca.SX]

    def __add__(self, other: Affine | ca.SX | float) -> Affine:
        if not isinstance(other, Affine):
            return Affine(self.value + other, self.parts)
        parts = dict(self.parts)
        for source, matrix in other.parts.items():
            parts[source] = parts[source] + matrix if source in parts else matrix
        return Affine(self.value + other.value, parts)

    def __sub__(self, other: Affine) -> Affine:
        return self + (-1.0) * other

    def __rmul__(self, factor: ca.SX | float) -> Affine:
        return Affine(factor * self.value, {k: factor * matrix for k, matrix in self.parts.items()})

    def __getitem__(self, rows: slice) -> Affine:
        return Affine(self.value[rows], {k: matrix[rows, :] for k, matrix in self.parts.items()})

    @staticmethod
    def join(pieces: Sequence[Affine]) -> Affine:
        """One below the other."""
        sources = sorted({source for piece in pieces for source in piece.parts})
        parts = {}
        for source in sources:
            width = next(piece.parts[source].shape[1] for piece in pieces if source in piece.parts)
            rows = [p.parts.get(source, ca.SX(p.value.numel(), width)) for p in pieces]
            parts[source] = ca.vertcat(*rows)
        return Affine(ca.vertcat(*[piece.value for piece in pieces]), parts)


@dataclass
class Chain:
    """Links from unknowns to a result.

    Parameters
    ----------
    unknowns : casadi.SX
        xi, in whose direction derivatives are taken; may be numbers.
    """

    unknowns: ca.SX
    _arguments: list[Affine] = field(default_factory=list)
    _jacobians: list[ca.SX] = field(default_factory=list)
    _calls: list[tuple[ca.Function, list[ca.SX]]] = field(default_factory=list)
    _slopes: list[ca.SX] = field(default_factory=list)  # of the sources
    _derived: dict[int, tuple[ca.Function, ca.Function, ca.Function]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._slopes.append(ca.SX.eye(self.unknowns.numel()))

    def root(self) -> Affine:
        """The unknowns themselves."""
        return Affine(self.unknowns, {0: ca.SX.eye(self.unknowns.numel())})

    def apply(
        self, function: ca.Function, arguments: Sequence[Affine], parameters: Sequence[ca.SX] = ()
    ) -> list[Affine]:
        """Outputs of `function` (*arguments, *parameters); nothing is differentiated in the parameters."""
        joined = Affine.join(arguments)
        values, jacobian, _ = self._derivatives(function, len(arguments))
        argument, given = joined.value, list(parameters)
        out = values.call([argument, *given])[0]
        slope = self._slope(joined)
        local = jacobian.call([argument, *given])[0]
        self._arguments.append(joined)
        self._jacobians.append(local)
        self._calls.append((function, given))
        self._slopes.append(local @ slope)
        size, source = out.numel(), len(self._slopes) - 1
        whole = Affine(out, {source: ca.SX.eye(size)})
        pieces, start = [], 0
        for i in range(function.n_out()):
            rows = function.numel_out(i)
            pieces.append(whole[start : start + rows])
            start += rows
        return pieces

    def jacobian(self, result: Affine) -> ca.SX:
        """Derivative of a result in the unknowns."""
        return self._slope(result)

    def hessian(self, result: Affine, m: ca.SX) -> ca.SX:
        """Second derivative of m . result in the unknowns."""
        adjoints: list[ca.SX] = [ca.SX(slope.shape[0], 1) for slope in self._slopes]
        self._push(result, m, adjoints)
        size = self.unknowns.numel()
        total = ca.SX(size, size)
        for k in reversed(range(len(self._arguments))):
            function, given = self._calls[k]
            argument, adjoint = self._arguments[k], adjoints[k + 1]
            count = function.n_in() - len(given)
            curvature = self._derivatives(function, count)[2].call([argument.value, *given, adjoint])[0]
            slope = self._slope(argument)
            total += slope.T @ (curvature @ slope)
            self._push(argument, self._jacobians[k].T @ adjoint, adjoints)
        return total

    def _slope(self, vector: Affine) -> ca.SX:
        total = ca.SX(vector.value.numel(), self.unknowns.numel())
        for source, matrix in vector.parts.items():
            total += matrix @ self._slopes[source]
        return total

    @staticmethod
    def _push(vector: Affine, adjoint: ca.SX, adjoints: list[ca.SX]) -> None:
        for source, matrix in vector.parts.items():
            if source:
                adjoints[source] = adjoints[source] + matrix.T @ adjoint

    def _derivatives(self, function: ca.Function, count: int) -> tuple[ca.Function, ca.Function, ca.Function]:
        """Outputs joined, their Jacobian, and the Hessian of w . outputs, in the first `count` arguments."""
        key = function.__hash__()
        if key not in self._derived:
            sizes = [function.numel_in(i) for i in range(function.n_in())]
            given = [ca.SX.sym(f"p{i}", size) for i, size in enumerate(sizes[count:])]
            a = ca.SX.sym("a", sum(sizes[:count]))
            pieces, start = [], 0
            for size in sizes[:count]:
                pieces.append(a[start : start + size])
                start += size
            out = ca.vertcat(*function.call([*pieces, *given]))
            w = ca.SX.sym("w", out.numel())
            curvature, _ = ca.hessian(ca.dot(w, out), a)
            self._derived[key] = (
                ca.Function("values", [a, *given], [out]),
                ca.Function("jacobian", [a, *given], [ca.jacobian(out, a)]),
                ca.Function("curvature", [a, *given, w], [curvature]),
            )
        return self._derived[key]
