"""The objective and its gradient, written anew."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from tests.checker.system import Array, System
from tests.checker.task import Task

__all__ = ["Sample", "end_cost", "rate_cost", "running_cost"]


class Sample(NamedTuple):
    """A point at which a step evaluates the running cost, and its derivatives in x_{n-1}, x_n and u."""

    weight: float  # of the length of the step
    q: Array
    v: Array
    before: Array
    after: Array
    by_u: Array


def running_cost(system: System, task: Task, q: Array, v: Array, u: Array) -> tuple[float, Array, Array]:
    """Integrand, and its gradients in (q, v) and in u."""
    value = 0.5 * u @ (task.effort * u) + 0.5 * v @ (task.velocity * v)
    d_q, d_v, d_u = np.zeros(system.nv), task.velocity * v, task.effort * u
    if task.tracking.any():
        e = system.away(task.q_target, q)
        value += 0.5 * e @ (task.tracking * e)
        d_q = d_q + _slope(system, task.q_target, q).T @ (task.tracking * e)
    if task.potential:
        value += task.potential * system.potential(q)
        d_q = d_q + task.potential * system.potential_gradient(q)
    return float(value), np.concatenate([d_q, d_v]), d_u


def rate_cost(task: Task, us: Array) -> tuple[float, Array]:
    """Cost of the controls' changes, and its gradient."""
    changes = np.diff(us, axis=0)
    pushed = task.control_rate * changes / task.dt
    gradient = np.zeros_like(us)
    gradient[1:] += pushed
    gradient[:-1] -= pushed
    return float(0.5 * np.sum(changes * pushed)), gradient


def end_cost(system: System, task: Task, q: Array, v: Array) -> tuple[float, Array]:
    """Terminal cost on (q, v), and its gradient."""
    e, weights = system.away(task.q_goal, q), task.terminal[: system.nv]
    d = v - task.v_goal
    pushed = task.terminal[system.nv :] * d
    value = 0.5 * e @ (weights * e) + 0.5 * d @ pushed
    return float(value), np.concatenate([_slope(system, task.q_goal, q).T @ (weights * e), pushed])


def _slope(system: System, q0: Array, q1: Array) -> Any:
    return pin.dDifference(system.model, q0, q1, pin.ArgumentPosition.ARG1)
