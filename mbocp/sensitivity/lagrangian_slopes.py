"""Derivatives of the Lagrangian and of the optimality conditions in the numbers of a programme."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation import Formulation
from mbocp.programme.compilation import CompiledFunctions
from mbocp.programme.evaluation import call
from mbocp.sensitivity.change import Change
from mbocp.sensitivity.derivative_functions import load_end_functions, load_stage_functions
from mbocp.sensitivity.kkt import Kkt, Optimum, Parts


@dataclass(frozen=True, eq=False)
class ParameterFunctions:
    """The functions of `mbocp.sensitivity.derivative_functions` along a horizon, loaded when they are needed.

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

    def pull(self, kkt: Kkt, adjoint: Parts, change: Change) -> Array:
        """Derivatives in parameters, shape (k,), from an adjoint of the conditions alone."""
        optimum, programme = kkt.optimum, kkt.optimum.programme
        kind, N = programme.kind, programme.num_steps
        xs, ys, us, ms, eta, ws = (part[0] for part in adjoint)
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
            pairs = zip(kkt.of_start, (xs, ys, us, ms), strict=True)
            found += change.start @ sum(part @ own[0] for part, own in pairs)
        return found


def _of_bounds(optimum: Optimum, pulls: Array, change: Change) -> Array:
    """Derivatives in parameters, shape (k,), from the negative of those in the bounds of active limits."""
    if not pulls.any():
        return np.zeros(len(change.start))
    sides = np.where(optimum.ws > 0.0, change.upper, change.lower)
    return -np.einsum("knj,nj->k", sides, pulls)


def _arguments(optimum: Optimum) -> list[Array]:
    """What the functions of a stage take first."""
    programme = optimum.programme
    return [*optimum.points, optimum.iterate.ms, optimum.path, programme.theta, programme.rho]


def _arguments_at_end(optimum: Optimum) -> list[Array]:
    return [optimum.iterate.xs[-1], optimum.iterate.eta, optimum.programme.rho_terminal]
