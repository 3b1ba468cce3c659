r"""Functions of a programme's parameters: what they change in the Lagrangian, exact to the last derivative.

With the Lagrangian of a step, :math:`L = l + m^T c + w^T h`, its unknowns z = (x1, y, x0, u) and its
parameters :math:`\pi` = (theta, rho):

- slope     (x0, x1, y, u, m, w, theta, rho)                   -> dL/dtheta, dL/drho, dL/dx0
- push      (x0, x1, y, u, m, w, theta, rho, dtheta, drho)     -> d(dL/dz), dc, dh along (dtheta, drho)
- pull      (x0, x1, y, u, m, w, theta, rho, z_bar, c_bar, h_bar) -> the transposed of it, in (theta, rho)
- end_slope (x, eta, rho), end_push (x, eta, rho, drho), end_pull (x, eta, rho, x_bar, g_bar): likewise of
  the end, :math:`\psi + \eta^T g`

Derivatives in x are along the retraction, as those of the stage functions are.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cache
from itertools import accumulate
from pathlib import Path

import casadi as ca

from mbocp._arrays import dataclass
from mbocp.formulation import Formulation
from mbocp.formulation.signature import FunctionSignature
from mbocp.formulation.stage import build_end_functions, build_functions
from mbocp.mechanics import Mechanics
from mbocp.programme.compilation import CompiledFunctions, load_functions
from mbocp.programme.tapes import as_operations


def load_stage_functions(formulation: Formulation) -> CompiledFunctions:
    """`slope`, `push` and `pull` of a formulation, from the cache or built now.

    Raises
    ------
    CompilationError
        If they have to be compiled and cannot be.
    """
    signature = formulation.pieces.signature
    return load_functions(
        f"sensitivities {_own_digest()} {signature.stage_text}",
        lambda: _build_stage(signature.steps.mechanics(formulation.problem.robot), signature),
    )


def load_end_functions(formulation: Formulation) -> CompiledFunctions:
    """`end_slope`, `end_push` and `end_pull`, likewise."""
    signature = formulation.pieces.signature
    return load_functions(
        f"sensitivities of the end {_own_digest()} {signature.end_text}",
        lambda: _build_end(signature.steps.mechanics(formulation.problem.robot), signature),
    )


@cache
def _own_digest() -> str:
    return hashlib.sha256(Path(__file__).read_bytes()).hexdigest()


def _build_stage(mechanics: Mechanics, signature: FunctionSignature) -> dict[str, ca.Function]:
    names = ["values", "retract", *(["path_values"] if signature.path else [])]
    found = build_functions(mechanics, signature, names)
    values, retract = found["values"], found["retract"]
    x0, x1, y, u, theta, rho = (ca.MX.sym(f"i{i}", values.size1_in(i)) for i in range(6))
    ndx = retract.size1_in(1)
    z, pi = ca.MX.sym("z", 2 * ndx + y.numel() + u.numel()), ca.MX.sym("pi", theta.numel() + rho.numel())
    d1, dy, d0, du = _split(z, [ndx, y.numel(), ndx, u.numel()])
    of_parameters = [theta.numel(), rho.numel()]
    dtheta, drho = _split(pi, of_parameters)
    at1, at_u, at_theta = retract(x1, d1), u + du, theta + dtheta
    c, cost = values(retract(x0, d0), at1, y + dy, at_u, at_theta, rho + drho)
    h = found["path_values"](at1, at_u, at_theta) if signature.path else ca.MX(0, 1)
    m, w = ca.MX.sym("m", c.numel()), ca.MX.sym("w", h.numel())
    lagrangian = _Lagrangian([x0, x1, y, u, m, w, theta, rho], cost + ca.dot(m, c) + ca.dot(w, h), z, pi)
    slopes = lagrangian.slopes
    start = slopes[ndx + y.numel() : 2 * ndx + y.numel()]
    parts = _split(lagrangian.in_parameters, of_parameters)
    return {
        "slope": lagrangian.function("slope", [], [*parts, start]),
        **lagrangian.directional([slopes, c, h], of_parameters),
    }


def _build_end(mechanics: Mechanics, signature: FunctionSignature) -> dict[str, ca.Function]:
    values = build_end_functions(mechanics, signature)["terminal_values"]
    retract = build_functions(mechanics, signature, ["retract"])["retract"]
    x, rho = ca.MX.sym("x", values.size1_in(0)), ca.MX.sym("rho", values.size1_in(1))
    d, drho = ca.MX.sym("d", retract.size1_in(1)), ca.MX.sym("drho", rho.numel())
    psi, g = values(retract(x, d), rho + drho)
    eta = ca.MX.sym("eta", g.numel())
    lagrangian = _Lagrangian([x, eta, rho], psi + ca.dot(eta, g), d, drho)
    return {
        "end_slope": lagrangian.function("end_slope", [], [lagrangian.in_parameters]),
        **lagrangian.directional([lagrangian.slopes, g], [rho.numel()], "end_"),
    }


@dataclass(frozen=True, eq=False)
class _Lagrangian:
    """A Lagrangian near a point: moved by z along its unknowns, and by pi in its parameters."""

    inputs: Sequence[ca.MX]
    value: ca.MX
    z: ca.MX
    pi: ca.MX

    @property
    def slopes(self) -> ca.MX:
        """Derivative in the unknowns."""
        return ca.gradient(self.value, self.z)

    @property
    def in_parameters(self) -> ca.MX:
        """Derivative in the parameters."""
        return ca.gradient(self.value, self.pi)

    def directional(
        self, rows: Sequence[ca.MX], sizes: Sequence[int], prefix: str = ""
    ) -> dict[str, ca.Function]:
        """`push` and `pull` of rows, for parameters in parts of some sizes."""
        row_sizes = [row.numel() for row in rows]
        along = [ca.MX.sym(f"a{i}", size) for i, size in enumerate(sizes)]
        bars = [ca.MX.sym(f"b{i}", size) for i, size in enumerate(row_sizes)]
        whole = ca.vertcat(*rows)
        pushed = ca.jtimes(whole, self.pi, ca.vertcat(*along))
        pulled = ca.jtimes(whole, self.pi, ca.vertcat(*bars), True)
        return {
            f"{prefix}push": self.function(f"{prefix}push", along, _split(pushed, row_sizes)),
            f"{prefix}pull": self.function(f"{prefix}pull", bars, _split(pulled, sizes)),
        }

    def function(self, name: str, more: Sequence[ca.MX], outputs: Sequence[ca.MX]) -> ca.Function:
        """Function of the inputs and some more, with z and pi zero."""
        given = [*self.inputs, *more]
        near = ca.Function("near", [*given, self.z, self.pi], [ca.densify(output) for output in outputs])
        symbols = [ca.MX.sym(f"i{i}", value.numel()) for i, value in enumerate(given)]
        zeros = [ca.MX.zeros(self.z.numel()), ca.MX.zeros(self.pi.numel())]
        return as_operations(ca.Function(name, symbols, near.call([*symbols, *zeros])))


def _split(vector: ca.MX, sizes: Sequence[int]) -> list[ca.MX]:
    """Parts of a vector of these sizes, in a row."""
    return list(ca.vertsplit(vector, [0, *accumulate(sizes)]))
