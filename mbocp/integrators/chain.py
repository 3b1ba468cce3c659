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

A large link that is applied several times can be one function, called with several arguments, instead of as
many copies of its operations: see `Chain.resolve`. Where its adjoint depends on no later link, as where its
outputs go to the result alone, one call gives its outputs, slopes and curvature together.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import field
from fractions import Fraction
from itertools import accumulate, pairwise
from typing import NamedTuple

import casadi as ca

from mbocp._arrays import dataclass

_LARGE = 500  # operations of a link's derivatives, from which on a call is worth its copies of numbers


@dataclass(frozen=True, eq=False)
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

    def split(self, *sizes: int) -> list[Affine]:
        """Runs of so many rows, one after another."""
        return [self.take(slice(*ends)) for ends in pairwise(accumulate(sizes, initial=0))]

    def take(self, rows: slice) -> Affine:
        """Some of its rows. By indices it would be a sequence, which CasADi tries to multiply by itself."""
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


class _Derivatives(NamedTuple):
    """A link's outputs, their Jacobian, and the Hessian of w . outputs, in its arguments.

    Attributes
    ----------
    function : casadi.Function
        The link, whose address is a key as long as it is kept.
    first : casadi.Function
        (argument, parameters) -> numbers of outputs and Jacobian that are no constants and differ.
    second : casadi.Function
        (argument, parameters, w) -> those of the Hessian.
    both : casadi.Function
        (argument, parameters, w) -> first, second.
    matrices : casadi.Function
        (first, second) -> outputs, Jacobian, Hessian.
    num_outputs : int
        How many of the first are outputs, and no slopes.
    """

    function: ca.Function
    first: ca.Function
    second: ca.Function
    both: ca.Function
    matrices: ca.Function
    num_outputs: int

    @classmethod
    def of(cls, function: ca.Function, count: int, *, is_merged: bool) -> _Derivatives:
        """Derivatives in the first `count` arguments, joined; common subexpressions may be merged at once."""
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
        written = [out, ca.jacobian(out, a), curvature]
        out, jacobian, curvature = ca.cse(written) if is_merged else written
        outputs = out
        values, first, (out, jacobian) = _distinct("first", [outputs, jacobian])
        bends, second, (curvature,) = _distinct("second", [curvature])
        name = function.name()
        return cls(
            function,
            ca.Function(f"{name}_first", [a, *given], [values]),
            ca.Function(f"{name}_second", [a, *given, w], [bends]),
            ca.Function(f"{name}_both", [a, *given, w], [values, bends]),
            ca.Function(f"{name}_matrices", [first, second], [out, jacobian, curvature]),
            len({e.element_hash() for e in _entries(outputs) if not e.is_constant()}),
        )

    @property
    def is_large(self) -> bool:
        """Whether copies of it take long to compile."""
        return bool(self.both.n_instructions() >= _LARGE)


def _distinct(name: str, matrices: Sequence[ca.SX]) -> tuple[ca.SX, ca.SX, list[ca.SX]]:
    """Entries that are no constants, each once; symbols; and the matrices with symbols in their places."""
    places: dict[int, int] = {}
    values: list[ca.SX] = []
    for matrix in matrices:
        for entry in _entries(matrix):
            if not entry.is_constant() and entry.element_hash() not in places:
                places[entry.element_hash()] = len(values)
                values.append(entry)
    symbols = ca.SX.sym(name, len(values))
    written = []
    for matrix in matrices:
        entries = [e if e.is_constant() else symbols[places[e.element_hash()]] for e in _entries(matrix)]
        written.append(ca.SX(matrix.sparsity(), ca.vertcat(ca.SX.zeros(0, 1), *entries)))
    return ca.vertcat(ca.SX.zeros(0, 1), *values), symbols, written


def _entries(matrix: ca.SX) -> list[ca.SX]:
    return [matrix.nz[i] for i in range(matrix.nnz())]


class _Link(NamedTuple):
    """A link where it is applied.

    Attributes
    ----------
    derivatives : _Derivatives
    argument : Affine
    given : tuple of casadi.SX
        Parameters.
    first : casadi.SX
        Numbers of its outputs and slopes, or symbols that stand for them.
    jacobian : casadi.SX
        Of its outputs in its argument.
    is_symbolic : bool
    """

    derivatives: _Derivatives
    argument: Affine
    given: tuple[ca.SX, ...]
    first: ca.SX
    jacobian: ca.SX
    is_symbolic: bool


class _Curvature(NamedTuple):
    """Symbols that stand for the curvature of a link, and the adjoint of its outputs."""

    link: _Link
    second: ca.SX
    adjoint: ca.SX


@dataclass
class Chain:
    """Links from unknowns to a result.

    Parameters
    ----------
    unknowns : casadi.SX
        xi, in whose direction derivatives are taken; may be numbers.
    may_call : bool
        Whether large links may become functions that are called. Values, slopes and Hessians then have
        symbols for their numbers until `resolve` puts something in their places.
    """

    unknowns: ca.SX
    may_call: bool = False
    _links: list[_Link] = field(default_factory=list)
    _slopes: list[ca.SX] = field(default_factory=list)  # of the sources
    _curved: list[_Curvature] = field(default_factory=list)
    _derived: dict[int, _Derivatives] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._slopes.append(ca.SX.eye(self.unknowns.numel()))

    def root(self) -> Affine:
        """The unknowns themselves."""
        return Affine(self.unknowns, {0: ca.SX.eye(self.unknowns.numel())})

    def apply(
        self, function: ca.Function, arguments: Sequence[Affine], parameters: Sequence[ca.SX] = ()
    ) -> list[Affine]:
        """Outputs of `function` (*arguments, *parameters); nothing is differentiated in the parameters."""
        joined, given = Affine.join(arguments), tuple(parameters)
        own = self._derivatives(function, len(arguments))
        is_symbolic = self.may_call and own.is_large
        count = own.first.numel_out(0)
        first = ca.SX.sym("first", count) if is_symbolic else own.first.call([joined.value, *given])[0]
        out, jacobian, _ = own.matrices.call([first, ca.SX.zeros(own.second.numel_out(0))])
        self._links.append(_Link(own, joined, given, first, jacobian, is_symbolic))
        self._slopes.append(jacobian @ self._slope(joined))
        size, source = out.numel(), len(self._slopes) - 1
        whole = Affine(out, {source: ca.SX.eye(size)})
        return whole.split(*(function.numel_out(i) for i in range(function.n_out())))

    def jacobian(self, result: Affine) -> ca.SX:
        """Derivative of a result in the unknowns."""
        return self._slope(result)

    def hessian(self, result: Affine, m: ca.SX) -> ca.SX:
        """Second derivative of m . result in the unknowns."""
        adjoints: list[ca.SX] = [ca.SX(slope.shape[0], 1) for slope in self._slopes]
        self._push(result, m, adjoints)
        size = self.unknowns.numel()
        total = ca.SX(size, size)
        for link, adjoint in zip(reversed(self._links), reversed(adjoints), strict=False):
            own = link.derivatives
            if link.is_symbolic:
                second = ca.SX.sym("second", own.second.numel_out(0))
                self._curved.append(_Curvature(link, second, adjoint))
            else:
                second = own.second.call([link.argument.value, *link.given, adjoint])[0]
            curvature = own.matrices.call([link.first, second])[2]
            slope = self._slope(link.argument)
            total += slope.T @ (curvature @ slope)
            self._push(link.argument, link.jacobian.T @ adjoint, adjoints)
        return total

    def resolve(self, expressions: Sequence[ca.SX]) -> list[ca.SX]:
        """Outputs of a function, with the links' numbers in the places of symbols that stand for them.

        Large links that are applied several times are functions that are called, where slopes are asked for
        and one call gives all that is; everything else is written out.
        """
        everything = ca.veccat(*expressions)
        curved = [one for one in self._curved if ca.depends_on(everything, one.second)]
        symbolic = [link for link in self._links if link.is_symbolic]
        called = _calls(symbolic, curved, everything)
        known = _SymbolValues()
        for link in symbolic:
            own, given = link.derivatives, [known.settle(link.argument.value), *link.given]
            bent = [one for one in curved if one.link is link] if id(link) in called else []
            if bent:
                first, second = own.both.call([*given, known.settle(bent[0].adjoint)], False, True)
                known.add(bent[0].second, second)
            else:
                (first,) = own.first.call(given, id(link) not in called, id(link) in called)
            known.add(link.first, first)
        for one in curved:
            if id(one.link) not in called:
                given = [known.settle(one.link.argument.value), *one.link.given, known.settle(one.adjoint)]
                known.add(one.second, one.link.derivatives.second.call(given)[0])
        return [known.settle(expression) for expression in expressions]

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

    def _derivatives(self, function: ca.Function, count: int) -> _Derivatives:
        key = function.__hash__()
        if key not in self._derived:
            self._derived[key] = _Derivatives.of(function, count, is_merged=self.may_call)
        return self._derived[key]


def _calls(links: Sequence[_Link], curved: Sequence[_Curvature], everything: ca.SX) -> set[int]:
    """Links that are functions to call, by their identities."""

    def gives_all(k: int) -> bool:
        link = links[k]
        later = ca.vertcat(*[one.first for one in links[k:]])
        adjoints = [one.adjoint for one in curved if one.link is link]
        asks_slopes = ca.depends_on(everything, link.first[link.derivatives.num_outputs :])
        return asks_slopes and len(adjoints) <= 1 and not any(ca.depends_on(a, later) for a in adjoints)

    found = [link for k, link in enumerate(links) if gives_all(k)]
    times = Counter(id(link.derivatives) for link in found)
    return {id(link) for link in found if times[id(link.derivatives)] > 1}


@dataclass
class _SymbolValues:
    """What symbols stand for, as far as it is known."""

    _symbols: list[ca.SX] = field(default_factory=list)
    _values: list[ca.SX] = field(default_factory=list)

    def add(self, symbols: ca.SX, values: ca.SX) -> None:
        """Let symbols stand for these values."""
        self._symbols.append(symbols)
        self._values.append(values)

    def settle(self, expression: ca.SX) -> ca.SX:
        """Return an expression of known values."""
        return ca.substitute([expression], self._symbols, self._values)[0] if self._symbols else expression


def dense_function(name: str, inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
    """A function whose outputs are dense, as those of all links of a chain are."""
    return ca.Function(name, inputs, [ca.densify(o) for o in outputs])


def add_weighted(row: Sequence[float | Fraction], vectors: Sequence[Affine]) -> Affine:
    """Sum of vectors with the coefficients of a row of a tableau; of none it is zero."""
    terms = [float(a) * k for a, k in zip(row, vectors, strict=True) if a]
    zero = Affine(ca.SX.zeros(vectors[0].value.shape), {})
    return sum(terms[1:], start=terms[0]) if terms else zero
