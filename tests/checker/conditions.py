"""The optimality conditions of a discretised problem as one sparse system, rebuilt from the motion alone."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import sparse

from tests.checker.clearance import clearance_bounds
from tests.checker.costs import end_cost, rate_cost, running_cost
from tests.checker.explicit import ExplicitStep
from tests.checker.following import follow_bounds, follow_equations, follow_missed
from tests.checker.frames import bound_values
from tests.checker.further import ENDS, WITHIN, Bound, equations, further_bounds, length_slopes, points_missed
from tests.checker.gauss import GAUSS, GaussStep
from tests.checker.implicit import TAU, ImplicitStep
from tests.checker.natural import NaturalSteps
from tests.checker.system import Array, System
from tests.checker.task import Task

__all__ = ["Bound", "Conditions", "Layout", "Motion", "joint_conditions", "natural_conditions", "step_of"]

_INACTIVE = 1e-12  # relative, of singular values
_FORMS = ("line", "kept", "orientation")  # that others may write in other functions of the same zeros


@dataclass(frozen=True, eq=False)
class Motion:
    """What is to be judged: numbers of a solution, and the multipliers that it claims for its limits."""

    qs: Array
    vs: Array
    us: Array
    cost: float = np.nan
    lam_us: Array = field(default_factory=lambda: np.zeros(0))
    lam_vs: Array = field(default_factory=lambda: np.zeros(0))
    lam_qs: Array = field(default_factory=lambda: np.zeros(0))
    lam_path: Array = field(default_factory=lambda: np.zeros(0))
    path_names: tuple[str, ...] = ()  # of the columns of lam_path
    duration: float = np.nan
    dts: Array = field(default_factory=lambda: np.zeros(0))  # of the steps, where lengths are found
    raised: float = 0.0  # [m] by which margins were raised at most, to be kept between nodes

    def claimed(self, name: str, n: int) -> float:
        """Multiplier of a path constraint or rate in step n; 0 where nothing is claimed of that name."""
        if name not in self.path_names or not self.lam_path.size:
            return 0.0
        return float(self.lam_path[n - 1, self.path_names.index(name)])


@dataclass(frozen=True)
class Layout:
    """Unknowns of step n: state x_n, multipliers, control u_{n-1}."""

    nx: int
    nc: int
    nu: int
    steps: int
    lengths: int = 0  # of runs of steps, the last unknowns

    @property
    def width(self) -> int:
        return self.nx + self.nc + self.nu

    @property
    def size(self) -> int:
        return self.width * self.steps + self.lengths

    def x(self, n: int) -> slice:
        return slice((n - 1) * self.width, (n - 1) * self.width + self.nx)

    def lam(self, n: int) -> slice:
        at = self.x(n).stop
        return slice(at, at + self.nc)

    def u(self, n: int) -> slice:
        at = self.lam(n).stop
        return slice(at, at + self.nu)

    def kinds(self, nv: int) -> Array:
        """0 for configurations, 1 for speeds, 2 for multipliers, 3 for controls, 4 for lengths."""
        one = [0] * nv + [1] * (self.nx - nv) + [2] * self.nc + [3] * self.nu
        return np.concatenate([np.tile(one, self.steps), [4] * self.lengths])


@dataclass(eq=False)
class Conditions:
    """Equations K dw = 0 of the steps and the end, gradient of the cost, inequalities; and what is violated.

    Attributes
    ----------
    residual : float
        Largest violation of a step, relative to what cancels in it.
    end : float
        Largest distance from an exact goal, relative to the motion.
    """

    layout: Layout
    K: sparse.csr_matrix
    gradient: Array
    cost: float
    residual: float
    constraint: float
    end: float
    bounds: list[Bound]
    kinds: Array
    scales: Array


def step_of(system: System, task: Task) -> ImplicitStep | ExplicitStep:
    kind = ImplicitStep if task.scheme in TAU else GaussStep if task.scheme in GAUSS else ExplicitStep
    return kind(system, task.scheme, task.dt)


class _Rows:
    """Rows of a sparse matrix, block by block."""

    def __init__(self) -> None:
        self.i: list[Array] = []
        self.j: list[Array] = []
        self.values: list[Array] = []
        self.count = 0

    def add(self, *blocks: tuple[slice, Array]) -> None:
        height = blocks[0][1].shape[0]
        for columns, block in blocks:
            width = columns.stop - columns.start
            self.i.append(np.repeat(np.arange(self.count, self.count + height), width))
            self.j.append(np.tile(np.arange(columns.start, columns.stop), height))
            self.values.append(np.asarray(block).ravel())
        self.count += height

    def matrix(self, width: int) -> sparse.csr_matrix:
        if not self.count:
            return sparse.csr_matrix((0, width))
        return sparse.csr_matrix(
            (np.concatenate(self.values), (np.concatenate(self.i), np.concatenate(self.j))),
            shape=(self.count, width),
        )


def _states(system: System, task: Task, motion: Motion) -> Array:
    """x_n; with drives the speeds that they leave."""
    if not system.drives or task.scheme in TAU:
        return np.hstack([motion.qs, motion.vs])
    speeds = [
        np.linalg.lstsq(system.speed_maps(q)[0], v - system.speed_maps(q)[1] @ u, rcond=None)[0]
        for q, v, u in zip(motion.qs, motion.vs, [*motion.us, motion.us[-1]], strict=True)
    ]
    return np.hstack([motion.qs, speeds])


def _largest(values: Array, floor: float) -> Array:
    return np.maximum(np.abs(values).max(axis=0), floor)


def _scales(layout: Layout, nv: int, task: Task, speeds: Array, us: Array, lams: Array) -> Array:
    """Size of each unknown: how far it moves on the way."""
    v = _largest(speeds, 1e-3 * max(float(np.abs(speeds).max()), 1e-300))
    u = _largest(us, 1e-3 * max(float(np.abs(us).max()), 1e-300))
    q = np.full(nv, 1.0)
    moved = v[:nv] * task.duration if v.size == nv else q
    q = np.minimum(q, moved) if v.size == nv else q
    lam = _largest(lams, 1e-3 * max(float(np.abs(lams).max(initial=0.0)), 1.0)) if layout.nc else np.zeros(0)
    many = np.tile(np.concatenate([q, v, lam, u]), layout.steps)
    return np.concatenate([many, [task.duration / max(layout.lengths, 1)] * layout.lengths])


def joint_conditions(system: System, task: Task, motion: Motion) -> Conditions:
    """For all schemes in joint coordinates."""
    N, phases = task.num_steps, task.phases
    dts = motion.dts if task.stops else np.full(N, task.dt)
    steps = [step_of(system, replace(task, duration=N * dt)) for dt in dts]
    xs = _states(system, task, motion)
    is_explicit = isinstance(steps[0], ExplicitStep)
    layout = Layout(steps[0].nx, 0 if is_explicit else system.nc, system.nu, N, len(phases))
    rows, gradient, cost = _Rows(), np.zeros(layout.size), 0.0
    by_length = [np.zeros(0)] * N
    for k, phase in enumerate(phases):
        by_length, slope = length_slopes(system, task, motion, xs, steps, phase, by_length, step_of)
        gradient[layout.size - len(phases) + k] = slope
    lams, violations, sizes, constraint = [], [], [], 0.0
    nv = system.nv
    of_step = {n: layout.size - len(phases) + k for k, phase in enumerate(phases) for n in phase}
    for n in range(1, N + 1):
        x0, x1, u, step, dt = xs[n - 1], xs[n], motion.us[n - 1], steps[n - 1], float(dts[n - 1])
        lam = step.multipliers(x0, x1, u)
        lams.append(lam)
        at = step.linearise(x0, x1, lam, u)
        violations.append(at.rows)
        sizes.append(at.sizes)
        parts = [(layout.x(n), at.after), (layout.u(n), at.u)]
        parts += [(layout.x(n - 1), at.before)] if n > 1 else []
        parts += [(layout.lam(n), at.lam)] if layout.nc else []
        parts += [(slice(of_step[n], of_step[n] + 1), by_length[n - 1][:, None])] if phases else []
        rows.add(*parts)
        for sample in step.samples(x0, x1, u):
            value, d_x, d_u = running_cost(system, task, sample.q, sample.v, u)
            length = dt * sample.weight
            cost += length * value
            gradient[layout.x(n)] += length * sample.after.T @ d_x
            gradient[layout.u(n)] += length * (d_u + sample.by_u.T @ d_x)
            if n > 1:
                gradient[layout.x(n - 1)] += length * sample.before.T @ d_x
    if system.num_rows and not is_explicit:  # explicit schemes project accelerations, and drift
        constraint = max(float(np.abs(system.closure(q)[0]).max()) for q in motion.qs)
    cost += _more_costs(system, task, motion, layout, gradient, is_explicit=is_explicit)
    end, end_rows = _end(system, task, motion, layout.nx, xs[-1, system.nq :], is_explicit=is_explicit)
    if len(end_rows):
        rows.add((layout.x(N), end_rows))
    for node, block in equations(system, task, motion):
        rows.add((layout.x(node), block))
    for node, block in follow_equations(system, task, motion):
        rows.add((layout.x(node), block))
    end = max(end, points_missed(system, task, motion), follow_missed(system, task, motion))
    if task.duration_range is not None:
        cost += task.time * task.duration
    elif phases:
        rows.add((slice(layout.size - len(phases), layout.size), np.ones((1, len(phases)))))
        end = max(end, abs(float(dts.sum()) / task.duration - 1.0))
    all_rows, all_sizes = np.array(violations), np.array(sizes)
    relative = np.abs(all_rows) / _block_sizes(all_sizes, nv, layout)
    return Conditions(
        layout=layout,
        K=rows.matrix(layout.size),
        gradient=gradient,
        cost=cost,
        residual=float(relative.max()),
        constraint=constraint,
        end=end,
        bounds=[
            *_bounds(system, task, motion, layout, xs),
            *further_bounds(system, task, motion, layout),
            *clearance_bounds(system, task, motion, layout),
            *follow_bounds(system, task, motion, layout),
        ],
        kinds=layout.kinds(nv),
        scales=_scales(layout, nv, task, xs[:, system.nq :], motion.us, np.array(lams)),
    )


def _block_sizes(sizes: Array, nv: int, layout: Layout) -> Array:
    """Largest of the terms of one kind: kinematics, momentum, constraints."""
    out = np.empty(sizes.shape[1])
    for at in (slice(0, nv), slice(nv, layout.nx), slice(layout.nx, None)):
        if out[at].size:
            out[at] = max(float(sizes[:, at].max()), 1e-300)
    return out


def _more_costs(
    system: System, task: Task, motion: Motion, layout: Layout, gradient: Array, *, is_explicit: bool
) -> float:
    """Control rate and terminal cost."""
    cost, N = 0.0, task.num_steps
    if task.control_rate.any():
        value, slopes = rate_cost(task, motion.us)
        cost += value
        for n in range(1, N + 1):
            gradient[layout.u(n)] += slopes[n - 1]
    if task.terminal.any():
        value, slope = end_cost(system, task, motion.qs[-1], motion.vs[-1])
        cost += value
        gradient[layout.x(N)] += slope
    return cost


def _tangent(system: System, q: Array) -> Array:
    """Orthonormal basis of the motions that the loops allow, shape (nv, free)."""
    if not system.num_rows:
        return np.eye(system.nv)
    _, values, right = np.linalg.svd(system.closure(q)[1])
    rank = int(np.sum(values > 1e-9 * values[0]))
    return right[rank:].T


def _end(
    system: System, task: Task, motion: Motion, nx: int, speeds: Array, *, is_explicit: bool
) -> tuple[float, Array]:
    """Distance from the exact goal, and the rows of its condition on x_N."""
    nv, q, v = system.nv, motion.qs[-1], motion.vs[-1]
    if task.terminal.any():
        return 0.0, np.zeros((0, nx))
    away, basis = system.away(task.q_goal, q), _tangent(system, task.q_goal)
    if task.q_active.all():
        rows = [np.hstack([basis.T, np.zeros((basis.shape[1], nx - nv))])]
        # explicit schemes may drift off the loops, and end beside a goal on them
        away = basis.T @ away if is_explicit else away
    else:
        rows, away = [np.eye(nx)[:nv][task.q_active]], away[task.q_active]
    end = float(np.abs(away).max(initial=0.0))
    if task.v_active.any():
        if is_explicit and system.drives:  # all speeds that are states end at rest
            moving, on_v = speeds, np.eye(nx)[nv:]
        else:
            chosen = basis.T if task.v_active.all() else np.eye(nv)[task.v_active]
            moving = chosen @ (v - task.v_goal)
            on_v = np.hstack([np.zeros((len(chosen), nx - nv)), chosen])
        rows.append(on_v)
        end = max(end, float(np.abs(moving).max()) / max(float(np.abs(motion.vs).max()), 1e-300))
    return end, np.vstack(rows)


def _bounds(system: System, task: Task, motion: Motion, layout: Layout, xs: Array):  # type: ignore[no-untyped-def]
    for n in range(1, task.num_steps + 1):
        yield from _box(
            "u", n, task.u_limits, motion.us[n - 1], layout.u(n).start, _claimed(motion.lam_us, n - 1)
        )
        offset = layout.x(n).start
        if np.isfinite(task.v_limits).any() and layout.nx > system.nv:
            values = motion.vs[n] if not system.drives else xs[n][system.nq :]
            limits = task.v_limits if not system.drives else task.v_limits[:, : values.size]
            yield from _box("v", n, limits, values, offset + system.nv, _claimed(motion.lam_vs, n))
        if np.isfinite(task.q_limits).any():
            for joint in system.model.joints[1:]:
                if joint.nq == joint.nv == 1:
                    i, k = joint.idx_q, joint.idx_v
                    claimed = motion.lam_qs[n, i : i + 1] if motion.lam_qs.size else np.zeros(1)
                    yield from _box(
                        "q", n, task.q_limits[:, i : i + 1], motion.qs[n, i : i + 1], offset + k, claimed
                    )
        at = 0
        own = [k for k, name in enumerate(motion.path_names) if not name.endswith((WITHIN, *ENDS))]
        of_paths = motion.lam_path[:, own] if motion.lam_path.ndim == 2 else motion.lam_path
        claims = of_paths if _are_of_paths(task, of_paths) else np.zeros(0)
        for bound in task.path:
            if n not in bound.nodes(task.num_steps):
                at += bound.lower.size
                continue
            values, slopes = bound_values(system, bound, motion.qs[n], motion.vs[n])
            columns = np.arange(offset, offset + 2 * system.nv)
            for row, (value, slope) in enumerate(zip(values, slopes, strict=True)):
                claimed = float(claims[n - 1, at]) if claims.size else 0.0
                at += 1
                if bound.lower[row] == bound.upper[row]:
                    continue  # an equation
                name = f"{bound.kind} {bound.frame}[{n}]"
                scale = max(abs(bound.lower[row]) if np.isfinite(bound.lower[row]) else 0.0, 1.0)
                if np.isfinite(bound.upper[row]):
                    yield Bound(name, value - bound.upper[row], scale, columns, slope, max(claimed, 0.0))
                if np.isfinite(bound.lower[row]):
                    yield Bound(name, bound.lower[row] - value, scale, columns, -slope, max(-claimed, 0.0))


def _are_of_paths(task: Task, claims: Array) -> bool:
    """Whether the columns are those of the path bounds and of nothing else."""
    if any(bound.kind in _FORMS for bound in task.path):
        return False
    return claims.ndim == 2 and claims.shape[1] == sum(bound.lower.size for bound in task.path)


def _claimed(array: Array, row: int) -> Array:
    return array[row] if array.size else np.zeros(0)


def _box(name: str, n: int, limits: Array, values: Array, first: int, claimed: Array):  # type: ignore[no-untyped-def]
    for i in range(values.size):
        lower, upper = limits[0, i], limits[1, i]
        lam = float(claimed[i]) if claimed.size else 0.0
        scale = max((abs(b) for b in (lower, upper) if np.isfinite(b)), default=1.0)
        if np.isfinite(upper):
            yield Bound(
                f"{name}{i}[{n}]", values[i] - upper, scale, np.array([first + i]), np.ones(1), max(lam, 0.0)
            )
        if np.isfinite(lower):
            yield Bound(
                f"{name}{i}[{n}]",
                lower - values[i],
                scale,
                np.array([first + i]),
                -np.ones(1),
                max(-lam, 0.0),
            )


def natural_conditions(system: System, task: Task, motion: Motion) -> Conditions:
    """For SE1 in natural coordinates; positions alone are the unknowns of the states."""
    steps, N, nv, dt = NaturalSteps(system, task.dt), task.num_steps, system.nv, task.dt
    layout = Layout(nv, system.nc, system.nu, N)
    places = [steps.bodies(q) for q in motion.qs]
    zs, Ts = np.array([p[0] for p in places]), [p[1] for p in places]
    ws = np.vstack([(Ts[0] @ task.v_start)[None], np.diff(zs, axis=0) / dt])
    rows, gradient, cost = _Rows(), np.zeros(layout.size), 0.0
    lams, violations, sizes, constraint = [], [], [], 0.0
    for n in range(1, N + 1):
        u, q = motion.us[n - 1], motion.qs[n]
        lam = np.zeros(system.nc)
        missing, size = steps.row(n, zs, ws[n - 1], q, lam, u)
        if system.nc:
            J = system.Phi_q(q)
            lam = np.linalg.lstsq(J.T, -missing / dt, rcond=None)[0]
            missing, size = steps.row(n, zs, ws[n - 1], q, lam, u)
        lams.append(lam)
        here, before, earlier = steps.linearise(n, zs, Ts, ws[n - 1], q, lam, u)
        parts = [(layout.x(n), here), (layout.u(n), -dt * system.actuation(q))]
        parts += [(layout.x(n - 1), before)] if n > 1 else []
        parts += [(layout.x(n - 2), earlier)] if n > 2 else []
        parts += [(layout.lam(n), dt * system.Phi_q(q).T)] if system.nc else []
        rows.add(*parts)
        if system.nc:
            rows.add((layout.x(n), system.Phi_q(q)))
        violations.append(missing)
        sizes.append(size)
        value, _, d_u = running_cost(system, task, q, np.zeros(nv), u)
        cost += dt * value
        gradient[layout.u(n)] += dt * d_u
    if system.num_rows:
        constraint = max(float(np.abs(system.closure(q)[0]).max()) for q in motion.qs)
    end, on_end = _natural_end(system, task, steps, zs, Ts, ws, motion)
    for columns, block in on_end:
        rows.add(*((layout.x(n), b) for n, b in zip(columns, block, strict=True)))
    largest = max(float(np.array(sizes).max()), 1e-300)
    return Conditions(
        layout=layout,
        K=rows.matrix(layout.size),
        gradient=gradient,
        cost=cost,
        residual=float(np.abs(np.array(violations)).max()) / largest,
        constraint=constraint,
        end=end,
        bounds=list(_bounds(system, task, motion, layout, np.zeros((N + 1, 0)))),
        kinds=layout.kinds(nv),
        scales=_natural_scales(layout, nv, motion, np.array(lams)),
    )


def _natural_scales(layout: Layout, nv: int, motion: Motion, lams: Array) -> Array:
    u = _largest(motion.us, 1e-3 * max(float(np.abs(motion.us).max()), 1e-300))
    lam = _largest(lams, 1e-3 * max(float(np.abs(lams).max(initial=0.0)), 1.0)) if layout.nc else np.zeros(0)
    return np.tile(np.concatenate([np.ones(nv), lam, u]), layout.steps)


def _natural_end(system, task, steps, zs, Ts, ws, motion):  # type: ignore[no-untyped-def]
    """q_N = q_d and T(q_d)' M w_N = 0, as far as the loops leave it free."""
    nv, N = system.nv, task.num_steps
    basis = _tangent(system, task.q_goal)
    away = system.away(task.q_goal, motion.qs[N])
    for joint in system.model.joints[1:]:  # bodies do not know how often a joint has turned
        if joint.nq == 1 and joint.shortname().startswith("JointModelR"):
            away[joint.idx_v] -= 2 * np.pi * np.round(away[joint.idx_v] / (2 * np.pi))
    away = away[task.q_active]
    rows = []
    if task.q_active.any():
        on_q = basis.T if task.q_active.all() else np.eye(nv)[task.q_active]
        rows.append(((N,), (on_q,)))
    M = (
        np.column_stack([steps.momentum(c) for c in Ts[N].T]),
        np.column_stack([steps.momentum(c) for c in Ts[N - 1].T]),
    )
    rows.append(((N, N - 1), (basis.T @ Ts[N].T @ M[0] / task.dt, -basis.T @ Ts[N].T @ M[1] / task.dt)))
    # Nothing moves in the last step. A half-turn in it would meet the condition of the scheme, too.
    left = system.away(motion.qs[N - 1], motion.qs[N]) / task.dt
    speed = max(float(np.abs(np.diff(motion.qs, axis=0)).max()) / task.dt, 1e-300)
    return max(float(np.abs(away).max(initial=0.0)), float(np.abs(left).max()) / speed), rows
