"""Motions that prove a task feasible: they satisfy the discrete equations to round-off."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from tests.checker.explicit import ExplicitStep
from tests.checker.implicit import ImplicitStep
from tests.checker.system import Array, System

__all__ = ["Witness", "along_bend", "along_geodesic", "along_loops", "rollout"]

_STEPS, _SMALL = 12, 1e-11


@dataclass(frozen=True, eq=False)
class Witness:
    """A feasible motion."""

    qs: Array
    vs: Array
    us: Array


def _profile(steps: int) -> Array:
    """Speeds at the nodes that add up to 1 over the steps of every scheme: zero at both ends."""
    shape = np.sin(np.pi * np.arange(steps + 1) / steps) ** 2
    shape[0] = shape[-1] = 0.0
    return np.asarray(shape / shape.sum())


def _controls(step: ImplicitStep, qs: Array, vs: Array) -> Array:
    """Controls of a motion of a system that has a motor for each direction that is free."""
    system, us = step.system, []
    for n in range(1, len(qs)):
        x0, x1 = np.concatenate([qs[n - 1], vs[n - 1]]), np.concatenate([qs[n], vs[n]])
        q, v = step.at(x0, x1)
        needed = pin.rnea(system.model, system.data, q, v, (vs[n] - vs[n - 1]) / step.dt).copy()
        needed -= system.applied(q, v, np.zeros(system.nu))
        matrix = np.hstack([system.actuation(q), -system.Phi_q(q).T])
        found, *_ = np.linalg.lstsq(matrix, needed, rcond=None)
        us.append(found[: system.nu])
    return np.array(us)


def along_geodesic(step: ImplicitStep, q0: Array, q1: Array, steps: int) -> Witness:
    """Rest to rest, straight ahead."""
    system = step.system
    delta = system.away(q0, q1)
    speeds = _profile(steps) / step.dt
    vs = speeds[:, None] * delta
    qs = [q0]
    for n in range(1, steps + 1):
        v = (1 - step.tau) * vs[n - 1] + step.tau * vs[n]
        qs.append(system.step(qs[-1], step.dt * v))
    return Witness(np.array(qs), vs, _controls(step, np.array(qs), vs))


def along_bend(step: ImplicitStep, q0: Array, delta: Array, aside: Array, steps: int) -> Witness:
    """Rest to rest by SE1 or the midpoint rule: ahead, and aside by so much in the middle."""
    system, travelled = step.system, _profile(steps)
    shape = travelled * np.cos(np.pi * np.arange(steps + 1) / steps)
    shape /= np.cumsum(shape).max()
    vs = (travelled[:, None] * delta + shape[:, None] * aside) / step.dt
    qs = [q0]
    for n in range(1, steps + 1):
        v = (1 - step.tau) * vs[n - 1] + step.tau * vs[n]
        qs.append(system.step(qs[-1], step.dt * v))
    return Witness(np.array(qs), vs, _controls(step, np.array(qs), vs))


def closed(system: System, q: Array, dofs: list[int], aim: Array) -> Array | None:
    """Configuration near q that closes the loops, with the components `dofs` of it as in `aim`."""
    for _ in range(30):
        rows, jacobian = system.closure(q)
        residual = np.concatenate([rows, system.away(aim, q)[dofs]])
        if np.abs(residual).max() < _SMALL * 0.01:
            return q
        along = pin.dDifference(system.model, aim, q, pin.ArgumentPosition.ARG1)[dofs]
        dv, *_ = np.linalg.lstsq(np.vstack([jacobian, along]), -residual, rcond=None)
        if np.abs(dv).max() > 1.5:
            return None
        q = system.step(q, dv)
    return q if np.abs(residual).max() < _SMALL else None


def along_loops(step: ImplicitStep, q0: Array, dofs: list[int], change: Array, steps: int) -> Witness | None:
    """Rest to rest by SE1: the components `dofs` straight ahead, the others where the loops close."""
    system, delta = step.system, np.zeros(step.system.nv)
    delta[dofs] = change
    travelled = np.cumsum(_profile(steps))
    qs = [q0]
    for n in range(1, steps + 1):
        aim = system.step(q0, travelled[n] * delta)
        q = qs[-1] if n == steps else closed(system, qs[-1], dofs, aim)
        if q is None:
            return None
        qs.append(q)
    moved = [system.away(a, b) / step.dt for a, b in itertools.pairwise(qs)]
    vs = np.array([np.zeros(system.nv), *moved])
    return Witness(np.array(qs), vs, _controls(step, np.array(qs), vs))


def rollout(step: ImplicitStep | ExplicitStep, q0: Array, v0: Array, us: Array) -> Witness | None:
    """Forward simulation with given controls; None where it does not stay tame."""
    system = step.system
    is_explicit = isinstance(step, ExplicitStep)
    speeds = np.zeros(system.ns) if system.drives else v0
    xs = [np.concatenate([q0, speeds])]
    lam = np.zeros(0 if is_explicit else system.nc)
    for u in us:
        x0 = xs[-1]
        if is_explicit:
            x1 = step.after(x0, u)
        else:
            found = _implicit(step, x0, lam, u)
            if found is None:
                return None
            x1, lam = found
        if not np.isfinite(x1).all() or np.abs(x1[system.nq :]).max() * step.dt > 0.5:
            return None
        xs.append(x1)
    qs, speeds = np.array(xs)[:, : system.nq], np.array(xs)[:, system.nq :]
    if system.drives:
        vs = [step.velocity(q, s, u) for q, s, u in zip(qs, speeds, [*us, us[-1]], strict=True)]
        return Witness(qs, np.array(vs), us)
    return Witness(qs, speeds, us)


def _implicit(step: ImplicitStep, x0: Array, lam: Array, u: Array) -> tuple[Array, Array] | None:
    """Newton's method on one step, from where it would go without forces."""
    system, nv = step.system, step.system.nv
    x1 = np.concatenate([system.step(x0[: system.nq], step.dt * x0[system.nq :]), x0[system.nq :]])
    for _ in range(_STEPS):
        at = step.linearise(x0, x1, lam, u)
        matrix = np.hstack([at.after, at.lam])
        found = np.linalg.solve(matrix, -at.rows)
        x1, lam = step.move(x1, found[: step.nx]), lam + found[step.nx :]
        if np.abs(found[: 2 * nv]).max() < _SMALL * (1 + np.abs(x1).max()):
            return x1, lam
        if np.abs(found).max() > 1e12:
            return None
    return None
