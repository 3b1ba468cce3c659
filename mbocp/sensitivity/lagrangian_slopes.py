r"""Derivatives of the Lagrangian and of the optimality conditions in a programme's numbers.

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
from functools import cache, cached_property
from itertools import accumulate
from pathlib import Path

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation import Formulation
from mbocp.formulation.signature import FunctionSignature
from mbocp.formulation.stage import build_end_functions, build_functions
from mbocp.mechanics import Mechanics
from mbocp.programme.compilation import CompiledFunctions, load_functions
from mbocp.programme.evaluation import call
from mbocp.programme.tapes import as_operations
from mbocp.sensitivity.change import Change
from mbocp.sensitivity.kkt import Kkt, Optimum, Parts, Solved


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


@dataclass(frozen=True, eq=False)
class ParameterFunctions:
    """The functions of `mbocp.sensitivity.lagrangian_slopes` along a horizon, loaded when they are needed.

    Attributes
    ----------
    formulation : Formulation
    """

    formulation: Formulation

    @cached_property
    def of_stage(self) -> CompiledFunctions:
        """Those of a step."""
        return load_stage_functions(self.formulation)

    @cached_property
    def of_end(self) -> CompiledFunctions:
        """Those of the end."""
        return load_end_functions(self.formulation)

    def gradient(self, optimum: Optimum, change: Change) -> Array:
        """Derivatives of the optimal cost in parameters, shape (k,), by the envelope theorem."""
        programme, kind = optimum.programme, optimum.programme.kind
        found = _of_bounds(optimum, optimum.ws, change)
        if change.start.any() or change.is_in_steps:
            theta, rho, start = call(self.of_stage, "slope", len(optimum.ws), _arguments(optimum))
            found += change.start @ start.dense(kind.ndx)[0]
            found += change.theta @ theta.dense(programme.theta.size).sum(axis=0)
            found += change.rho @ rho.dense(kind.nr).ravel()
        if change.rho_terminal.any():
            (end,) = call(self.of_end, "end_slope", 1, _arguments_at_end(optimum))
            found += change.rho_terminal @ end.dense(programme.rho_terminal.size)[0]
        return found

    def push(self, kkt: Kkt, change: Change) -> Parts:
        """Derivatives of the optimality conditions in parameters."""
        optimum, programme = kkt.optimum, kkt.optimum.programme
        kind, N, count = programme.kind, programme.num_steps, len(change.start)
        found = Parts.zeros(programme, count)
        sides = np.where(optimum.ws > 0.0, change.upper, change.lower)
        found.ws[:] -= sides
        first, before = kind.ndx + kind.ny, 2 * kind.ndx + kind.ny
        for k in range(count):
            if change.theta[k].any() or change.rho[k].any():
                given = [*_arguments(optimum), change.theta[k], change.rho[k]]
                slopes, c, h = call(self.of_stage, "push", N, given)
                z = slopes.dense(before + kind.nu)
                found.xs[k] += z[:, : kind.ndx]
                found.xs[k, :-1] += z[1:, first:before]
                found.ys[k] += z[:, kind.ndx : first]
                found.us[k] += z[:, before:]
                found.ms[k] += c.dense(first)
                found.ws[k, :, kind.nx + kind.nu :] += h.dense(programme.bounds.nh)
            if change.rho_terminal[k].any():
                given = [*_arguments_at_end(optimum), change.rho_terminal[k]]
                slopes, g = call(self.of_end, "end_push", 1, given)
                found.xs[k, -1] += slopes.dense(kind.ndx)[0]
                found.eta[k] += g.dense(programme.ng)[0]
        if change.start.any():
            for own, part in zip(found[:4], kkt.of_start, strict=True):
                own[:, 0] += change.start @ part
        return found

    def pull(self, optimum: Optimum, adjoint: Solved, change: Change) -> Array:
        """Derivatives in parameters, shape (k,), from an adjoint of the conditions alone."""
        programme = optimum.programme
        kind, N = programme.kind, programme.num_steps
        xs, ys, us, ms, eta, ws = (part[0] for part in adjoint.parts)
        found = _of_bounds(optimum, ws, change)
        if change.is_in_steps:
            before = np.vstack([np.zeros((1, kind.ndx)), xs[:-1]])
            bars = [np.hstack([xs, ys, before, us]), ms, ws[:, kind.nx + kind.nu :]]
            theta, rho = call(self.of_stage, "pull", N, [*_arguments(optimum), *bars])
            found += change.theta @ theta.dense(programme.theta.size).sum(axis=0)
            found += change.rho @ rho.dense(kind.nr).ravel()
        if change.rho_terminal.any():
            (end,) = call(self.of_end, "end_pull", 1, [*_arguments_at_end(optimum), xs[-1], eta])
            found += change.rho_terminal @ end.dense(programme.rho_terminal.size)[0]
        if change.start.any():
            found += change.start @ adjoint.of_start[0]
        return found


def _of_bounds(optimum: Optimum, pulls: Array, change: Change) -> Array:
    """Derivatives in parameters, shape (k,), from the negative of those in the bounds of active limits."""
    if not (change.is_in_bounds and pulls.any()):
        return np.zeros(len(change.start))
    sides = np.where(optimum.ws > 0.0, change.upper, change.lower)
    return -np.einsum("knj,nj->k", sides, pulls)


def _arguments(optimum: Optimum) -> list[Array]:
    """What the functions of a stage take first."""
    programme = optimum.programme
    return [*optimum.points, optimum.iterate.ms, optimum.path, programme.theta, programme.rho]


def _arguments_at_end(optimum: Optimum) -> list[Array]:
    return [optimum.iterate.xs[-1], optimum.iterate.eta, optimum.programme.rho_terminal]
