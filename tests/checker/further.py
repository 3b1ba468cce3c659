"""What problems may ask beside limits and a goal: points on the way, spans, rates, a duration to be found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from tests.checker.costs import rate_cost, running_cost
from tests.checker.differences import derivative
from tests.checker.frames import bound_values, pose_left, pose_values
from tests.checker.system import Array, System
from tests.checker.task import Point, Task

if TYPE_CHECKING:
    from tests.checker.conditions import Layout, Motion

__all__ = ["Bound", "equations", "further_bounds", "length_slopes", "points_missed"]


WITHIN, *ENDS = (
    " within steps",
    " at begins of steps",
    " at ends of steps",
)  # of names of limits that hold there
_WHERE = {
    "middle": ("velocity of ", WITHIN),
    "begin": ("acceleration of ", ENDS[0]),
    "end": ("acceleration of ", ENDS[1]),
}
_SHORTEST = 1e-3  # of the mean length of steps, at the least duration: those of a run are no shorter


@dataclass(frozen=True, eq=False)
class Bound:
    """One side of one inequality at one place: value <= 0, its gradient, its multiplier (NaN: not told)."""

    name: str
    value: float
    scale: float
    columns: Array
    gradient: Array
    claimed: float


def equations(system: System, task: Task, motion: Motion) -> Iterator[tuple[int, Array]]:
    """Node, and rows on its state (q, v): of points on the way, and of bounds that are equal."""
    for point in task.points:
        yield point.node, _point(system, point, motion.qs[point.node], motion.vs[point.node])[1]
    for bound in task.path:
        equal = np.isfinite(bound.lower) & (bound.lower == bound.upper)
        if equal.any():
            for n in bound.nodes(task.num_steps):
                yield n, bound_values(system, bound, motion.qs[n], motion.vs[n])[1][equal]


def points_missed(system: System, task: Task, motion: Motion) -> float:
    """Largest distance of the motion from its points [m, rad], of velocities relative to the largest."""
    fastest = max(float(np.abs(motion.vs).max()), 1e-300)
    worst = 0.0
    for point in task.points:
        values, rows = _point(system, point, motion.qs[point.node], motion.vs[point.node])
        is_rate = np.abs(rows[:, system.nv :]).max(axis=1, initial=0.0) > 0.0
        worst = max(worst, float(np.abs(np.where(is_rate, values / fastest, values)).max(initial=0.0)))
    for bound in task.path:
        equal = np.isfinite(bound.lower) & (bound.lower == bound.upper)
        for n in bound.nodes(task.num_steps) if equal.any() else ():
            values, _ = bound_values(system, bound, motion.qs[n], motion.vs[n])
            worst = max(worst, float(np.abs(values - bound.lower)[equal].max()))
    return worst


def _point(system: System, point: Point, q: Array, v: Array) -> tuple[Array, Array]:
    """Equations of a point and their derivatives in (q, v)."""
    nv, one = system.nv, np.eye(system.nv)
    zero = np.zeros((nv, nv))
    values = [system.away(point.q, q)[point.q_active], (v - point.v)[point.v_active]]
    rows = [np.hstack([one, zero])[point.q_active], np.hstack([zero, one])[point.v_active]]
    for pose in point.frames:
        left, slope = pose_values(system, pose, q)
        values.append(left)
        rows.append(np.hstack([slope, np.zeros_like(slope)]))
    return np.concatenate(values), np.vstack(rows)


# Inequalities


def further_bounds(system: System, task: Task, motion: Motion, layout: Layout) -> Iterator[Bound]:
    """Tolerances of points, rates, and the bounds of a duration that is found."""
    for place, point in enumerate(p for p in task.points if p.node < task.num_steps):
        yield from _tolerances(system, point, motion, layout, f"{place + 1}: ")
    for point in task.points:
        if point.node == task.num_steps:
            yield from _tolerances(system, point, motion, layout, "goal: ")
    yield from _rates(system, task, motion, layout)
    yield from _within(system, task, motion, layout)
    yield from _times(task, motion, layout)


def _times(task: Task, motion: Motion, layout: Layout) -> Iterator[Bound]:
    """Bounds of times that are found, and of the lengths between them."""
    phases = len(task.phases)
    lengths = layout.size - phases + np.arange(phases)
    if task.duration_range is not None:
        lower, upper = task.duration_range
        yield Bound("duration", task.duration - upper, upper, lengths, np.ones(phases), np.nan)
        yield Bound("duration", lower - task.duration, upper, lengths, -np.ones(phases), np.nan)
    least = task.duration if task.duration_range is None else task.duration_range[0]
    for k, phase in enumerate(task.phases if task.stops else ()):
        length = float(motion.dts[phase.start - 1 : phase.stop - 1].sum())
        shortest = _SHORTEST * least / task.num_steps * len(phase)
        yield Bound(f"length {k}", shortest - length, least, lengths[k : k + 1], -np.ones(1), np.nan)
    for k, stop in enumerate(task.stops, start=1):
        time = float(motion.dts[: stop.node].sum())
        if np.isfinite(stop.latest):
            yield Bound(f"time {k}", time - stop.latest, stop.latest, lengths[:k], np.ones(k), np.nan)
        if stop.earliest > 0.0:
            yield Bound(f"time {k}", stop.earliest - time, stop.earliest, lengths[:k], -np.ones(k), np.nan)


def _tolerances(system: System, point: Point, motion: Motion, layout: Layout, prefix: str) -> Iterator[Bound]:
    n = point.node
    columns = layout.x(n).start + np.arange(system.nv)
    for pose in point.frames:
        away, moved, angle, turned = pose_left(system, pose, motion.qs[n])
        for i, value, slope in (
            zip(np.flatnonzero(np.isfinite(pose.position)), away, moved, strict=True) if pose.box else ()
        ):
            name = f"{prefix}{'xyz'[i]} of {pose.frame}"
            claimed = motion.claimed(name, n)
            yield Bound(name, value - pose.box, 1.0, columns, slope, max(claimed, 0.0))
            yield Bound(name, -value - pose.box, 1.0, columns, -slope, max(-claimed, 0.0))
        if pose.cone:
            name, size = f"{prefix}angle of {pose.frame}", float(np.linalg.norm(angle))
            slope = angle @ turned / size if size > 1e-12 else np.zeros(system.nv)
            yield Bound(name, size - pose.cone, 1.0, columns, slope, max(motion.claimed(name, n), 0.0))


def _rates(system: System, task: Task, motion: Motion, layout: Layout) -> Iterator[Bound]:
    dt, nv, N = task.dt, system.nv, task.num_steps
    v = motion.vs
    a = np.vstack([np.zeros((1, nv)), np.diff(v, axis=0) / dt])  # a_0 = 0
    joints, motors = _names(system)
    at = [layout.x(n).start + nv + np.arange(nv) for n in range(1, N + 1)]  # of v_1, ..., v_N
    for n in range(1, N + 1):
        if task.acceleration is not None:
            places = [(at[n - 1], 1.0 / dt), *([(at[n - 2], -1.0 / dt)] if n > 1 else [])]
            rates = _Rates("acceleration", n, joints, task.acceleration, 1)
            yield from rates.bounds(a[n], places, task, motion, layout)
        if task.jerk is not None:
            weights = (1.0, -2.0, 1.0) if n > 1 else (2.0,)  # a_1/(dt/2) in the first step
            places = [(at[n - 1 - k], w / dt**2) for k, w in enumerate(weights) if n - 1 - k >= 0]
            rates = _Rates("jerk", n, joints, task.jerk, 2)
            yield from rates.bounds(
                (a[n] - a[n - 1]) / (dt if n > 1 else dt / 2), places, task, motion, layout
            )
        if task.jerk is not None and n == N and task.ends_at_rest:
            places = [(at[n - 1], -2.0 / dt**2), *([(at[n - 2], 2.0 / dt**2)] if n > 1 else [])]
            rates = _Rates("jerk", n, joints, task.jerk, 2, " at the end")
            yield from rates.bounds(-a[n] / (dt / 2), places, task, motion, layout)
        if task.effort_rate is not None and n > 1:
            u, before = (layout.u(k).start + np.arange(system.nu) for k in (n, n - 1))
            rate = (motion.us[n - 1] - motion.us[n - 2]) / dt
            rates = _Rates("effort_rate", n, motors, task.effort_rate, 1)
            yield from rates.bounds(rate, [(u, 1.0 / dt), (before, -1.0 / dt)], task, motion, layout)
        if task.power is not None:
            moved = system.selection.T  # a motor's velocity, shape (nu, nv)
            u, speed = motion.us[n - 1], moved @ v[n]
            for i, motor in enumerate(motors):
                columns = np.concatenate([[layout.u(n).start + i], at[n - 1]])
                slope = np.concatenate([[speed[i]], u[i] * moved[i]])
                claimed, limits = motion.claimed(f"power of {motor}", n), task.power[:, i]
                yield from _two_sided(f"power[{n}]", limits, u[i] * speed[i], columns, slope, claimed)


def _within(system: System, task: Task, motion: Motion, layout: Layout) -> Iterator[Bound]:
    """Limits that are claimed to hold within steps: of speeds and accelerations of their cubics."""
    told = {
        where: [k for k, name in enumerate(motion.path_names) if name.startswith(of) and name.endswith(end)]
        for where, (of, end) in _WHERE.items()
    }
    model, nv = system.model, system.nv
    for n in range(1, task.num_steps + 1) if any(told.values()) else ():
        before, after, dt = motion.qs[n - 1], motion.qs[n], float(motion.dts[n - 1])
        by_before, by_after = pin.dDifference(model, before, after)
        way, v0, v1 = pin.difference(model, before, after), motion.vs[n - 1], motion.vs[n]
        still, one = np.zeros((nv, nv)), np.eye(nv)
        # By the state after the step, by that before it, and by a length of the step.
        of_way = np.hstack([by_after, still, by_before, still, np.zeros((nv, 1))])
        of_v0, of_v1, of_dt = (
            np.hstack([*blocks, np.zeros((nv, 1))])
            for blocks in (
                (still, still, still, one),
                (still, one, still, still),
                (still, still, still, still),
            )
        )
        of_dt[:, -1] = 1.0
        b, of_b = (
            3.0 * way / dt - v0 - v1,
            3.0 * of_way / dt - of_v0 - of_v1 - 3.0 * way[:, None] / dt**2 * of_dt,
        )
        values = {"middle": (b, of_b)}
        for name, change, slope in (("begin", b - v0, of_b - of_v0), ("end", v1 - b, of_v1 - of_b)):
            values[name] = 2.0 * change / dt, 2.0 * slope / dt - 2.0 * change[:, None] / dt**2 * of_dt
        yield from _bounds_within(task, motion, layout, n, values, told)


def _bounds_within(
    task: Task,
    motion: Motion,
    layout: Layout,
    n: int,
    values: dict[str, tuple[Array, Array]],
    told: dict[str, list[int]],
) -> Iterator[Bound]:
    """Bounds in the step to node n, whose columns come in the order of the limits."""
    size = 2 * len(motion.vs[0])
    columns, keep, factors = [layout.x(n).start + np.arange(size)], [np.arange(size)], [np.ones(size)]
    if n > 1:
        columns.append(layout.x(n - 1).start + np.arange(size))
        keep.append(size + np.arange(size))
        factors.append(np.ones(size))
    for k, phase in enumerate(task.phases):
        if n in phase:
            length = float(motion.dts[phase.start - 1 : phase.stop - 1].sum())
            columns.append(np.array([layout.size - len(task.phases) + k]))
            keep.append(np.array([2 * size]))
            factors.append(np.array([float(motion.dts[n - 1]) / length]))
    places, chosen, weights = (np.concatenate(parts) for parts in (columns, keep, factors))
    for where, (value, slope) in values.items():
        limits = task.v_limits if where == "middle" else task.acceleration
        if not told[where] or limits is None:
            continue
        for column, i in zip(told[where], np.flatnonzero(np.isfinite(limits).any(axis=0)), strict=True):
            claimed = float(motion.lam_path[n - 1, column])
            gradient = slope[i, chosen] * weights
            yield from _two_sided(f"{WITHIN}[{n}]", limits[:, i], value[i], places, gradient, claimed)


def _names(system: System) -> tuple[list[str], list[str]]:
    """Names of the velocities of joints with one each, and of the joints that have motors."""
    joints = list(zip(system.model.names, system.model.joints, strict=True))[1:]
    of_dof = {joint.idx_v: name for name, joint in joints if joint.nv == 1}
    dofs = [int(np.argmax(np.abs(column))) for column in system.selection.T]
    return [of_dof.get(i, "") for i in range(system.nv)], [of_dof.get(i, "") for i in dofs]


@dataclass(frozen=True, eq=False)
class _Rates:
    """Limits of divided differences in one step: each component depends on the same one at some nodes."""

    key: str
    n: int
    names: list[str]
    limits: Array
    order: int  # of the power of 1/dt
    place: str = ""

    def bounds(
        self,
        values: Array,
        places: list[tuple[Array, float]],
        task: Task,
        motion: Motion,
        layout: Layout,
    ) -> Iterator[Bound]:
        for i, value in enumerate(values):
            columns, slope = [columns[i] for columns, _ in places], [weight for _, weight in places]
            if task.duration_range is not None:
                columns.append(layout.size - 1)
                slope.append(-self.order * value / task.duration)
            claimed = motion.claimed(f"{self.key} of {self.names[i]}{self.place}", self.n)
            name = f"{self.key}[{self.n}]{self.place}"
            yield from _two_sided(name, self.limits[:, i], value, np.array(columns), np.array(slope), claimed)


def _two_sided(
    name: str, limits: Array, value: float, columns: Array, slope: Array, claimed: float
) -> Iterator[Bound]:
    lower, upper = limits
    scale = max((abs(b) for b in limits if np.isfinite(b)), default=1.0)
    if np.isfinite(upper):
        yield Bound(name, value - upper, scale, columns, slope, max(claimed, 0.0))
    if np.isfinite(lower):
        yield Bound(name, lower - value, scale, columns, -slope, max(-claimed, 0.0))


# Lengths that are found


def length_slopes(
    system: System,
    task: Task,
    motion: Motion,
    xs: Array,
    steps: list[Any],
    phase: range,
    known: list[Array],
    step_of: Any,
) -> tuple[list[Array], float]:
    """Derivatives of the rows of a run of steps, and of the cost, in its length, by differences of steps.

    `known` has those of the rows of other runs, which stay.
    """
    T = len(phase) * float(steps[phase.start - 1].dt)

    def at(change: Array) -> tuple[Any, Task]:
        dt = T / len(phase) * (1.0 + float(change[0]))
        other = replace(task, duration=dt * task.num_steps)
        return step_of(system, other), other

    lams = {n: steps[n - 1].multipliers(xs[n - 1], xs[n], motion.us[n - 1]) for n in phase}

    def rows_of(n: int) -> Array:
        def rows(change: Array) -> Array:
            step, _ = at(change)
            return np.asarray(step.rows(xs[n - 1], xs[n], lams[n], motion.us[n - 1])[0])

        return derivative(rows, 1)[:, 0] / T

    def cost(change: Array) -> Array:
        step, other = at(change)
        total = task.time * step.dt * len(phase)
        for n in phase:
            u = motion.us[n - 1]
            for weight, q, v in step.places(xs[n - 1], xs[n], u):
                total += step.dt * weight * running_cost(system, task, q, v, u)[0]
        if task.control_rate.any():  # of tasks with one run alone
            total += rate_cost(other, motion.us)[0]
        return np.array([total])

    slopes = [rows_of(n) if n in phase else known[n - 1] for n in range(1, task.num_steps + 1)]
    return slopes, float(derivative(cost, 1)[0, 0]) / T
