"""`[goal.excite]`: the motion whose torques tell most about a robot's base parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline
from scipy.optimize import linprog

from mbocp._arrays import Array, IntArray, dataclass
from mbocp._text import quote_all
from mbocp.exceptions import InvalidValue, ProblemError, UnsupportedRobot
from mbocp.identification.dynamics import InverseDynamics, JointMotion
from mbocp.identification.unknown_parameters import BaseParameters, Unknowns, base_of, unknowns_of
from mbocp.job import Job, Strategy
from mbocp.problem import Problem
from mbocp.problem.file.tables import write_tables
from mbocp.problem.problem import problem_from_tables
from mbocp.solution import Solution

_DEGREE = 5  # of splines: jerks are continuous
_AT_REST = 3  # control points at each end that make velocity and acceleration zero there
_ROOM = 0.97  # share of limits that splines use: steps of a scheme are not splines
_TIGHT = 0.95  # share of torque limits up to which they are taken for linear
_GAIN = 1e-3  # of log det per step, below which the search ends
_KEPT = 1e-6  # weight of the effort [1/(N m)^2] beside that of distances from the spline
_NEAR = 1.0
_LEVER = 3.0  # by which dependent joints may be faster than in the first pose, by the speeds of the others


@dataclass(frozen=True, eq=False)
class Information:
    r"""What torques along a motion tell of base parameters: :math:`I = \sum_k Y_k^T \Sigma^{-1} Y_k`.

    Parameters
    ----------
    base : BaseParameters
    matrix : ndarray, shape (rank, rank)
        I, in units of the base parameters.
    """

    base: BaseParameters
    matrix: Array

    @property
    def log_det(self) -> float:
        """Logarithm of its determinant: the larger, the smaller the volume of uncertainty."""
        return _log_det(self.matrix)

    @property
    def condition(self) -> float:
        """Condition number of the weighted regressor, in SI units."""
        return float(np.sqrt(np.linalg.cond(self.matrix)))

    @property
    def sd(self) -> Array:
        """Standard deviations of the base parameters by least squares, shape (rank,)."""
        size = np.sqrt(np.diag(self.matrix))
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(self.matrix / np.outer(size, size)))) / size)

    def __str__(self) -> str:
        """The measures, and each base parameter's standard deviation."""
        rows = (f"{sd:10.3g}  {name}" for sd, name in zip(self.sd, self.base.names, strict=True))
        return "\n".join([f"log det {self.log_det:.2f}, condition number {self.condition:.4g}", *rows])


@dataclass(frozen=True)
class NearSpline:
    """Solve near the spline whose torques tell most about the robot: the D-optimal motion.

    The spline is improved within limits of position, velocity, acceleration and torque; the problem that is
    solved has its distance from the spline as cost, and all that was asked for beside the cost.

    Attributes
    ----------
    once : Strategy
        For that.
    """

    once: Strategy

    def run(self, job: Job) -> Solution:
        """Improve random splines, and solve near the best.

        Raises
        ------
        UnsupportedRobot, ProblemError, InvalidValue
            For motors elsewhere than in the independent joints, phases, via points, a free duration, ends
            that are not at rest, and where nothing limits how fast the robot moves.
        """
        asked = job.problem.excite
        assert asked is not None
        search = _Search(job.problem, asked.torque_noise, asked.friction, asked.knots)
        rng, found = np.random.default_rng(asked.seed), []
        for _ in range(asked.starts):
            found.append(search.climb(search.begin(rng), asked.rounds))
            if job.is_late:
                break
        near = search.problem_near(max(found, key=lambda pair: pair[0])[1])
        return self.once.run(replace(job, asked=near, problem=near).anew())


def information(
    solution: Solution, *, torque_noise: ArrayLike = 0.05, friction: str = "both", rate: float = 100.0
) -> Information:
    """Say what torques along a motion tell, measured so often a second [1/s]; see `mbocp.excite`."""
    if not rate > 0.0:
        raise InvalidValue("rate", rate, "a positive number [1/s]")
    dynamics = InverseDynamics(solution.load_robot())
    unknowns = unknowns_of(dynamics, friction)
    base = base_of(dynamics, unknowns)
    a = np.array([solution.acceleration_at(n) for n in range(len(solution.t))])
    y, moved = np.array([dynamics.coordinates(q) for q in solution.qs]), dynamics.independent
    motion = dynamics.motion(y, solution.vs[:, moved], a[:, moved], np.asarray(solution.qs))
    Y = _columns(dynamics, unknowns, base, motion) / _noise(torque_noise, dynamics.n)[:, None]
    steps = np.diff(solution.t)
    weights = 0.5 * rate * (np.append(steps, 0.0) + np.append(0.0, steps))  # trapezoidal rule
    return Information(base, np.einsum("k,kjp,kjr->pr", weights, Y, Y))


class _Search:
    """Splines between the ends of a problem, their information, and steps that increase it."""

    def __init__(self, problem: Problem, torque_noise: ArrayLike, friction: str, knots: int) -> None:
        self.problem, self.dynamics = problem, InverseDynamics(problem.robot)
        robot, n, moved = problem.robot, self.dynamics.n, self.dynamics.independent
        if robot.nu != n or not np.array_equal(robot.actuation.selection[moved], np.eye(n)):
            names = quote_all(self.dynamics.names)
            raise UnsupportedRobot(f"excite: robot {robot.name!r}: it takes one motor in each of {names}")
        first, last = _ends(problem, self.dynamics)
        self.unknowns = unknowns_of(self.dynamics, friction)
        self.base = base_of(self.dynamics, self.unknowns)
        self.noise = _noise(torque_noise, n)
        T, count = problem.duration, knots + 2 * _AT_REST
        inner = np.linspace(0.0, T, count - _DEGREE + 1)
        at = np.concatenate([[0.0] * _DEGREE, inner, [T] * _DEGREE])
        self.times = (np.arange(4 * count) + 0.5) * T / (4 * count)
        self.spline = BSpline(at, np.eye(count), _DEGREE)
        self.values = [self.spline.derivative(k)(self.times) for k in (0, 1, 2)]  # B, B', B''
        # Splines and derivatives lie in the hulls of their control points; the more knots, the tighter.
        fine = self.spline
        for middle in 0.5 * (inner[1:] + inner[:-1]):
            fine = fine.insert_knot(middle)
        self.hulls = [fine.derivative(k).c[: len(fine.t) - _DEGREE - 1 - k] for k in (0, 1, 2)]
        self.free = np.arange(count) % (count - _AT_REST) >= _AT_REST
        blend = np.clip((np.arange(count) - _AT_REST + 1) / (knots + 1), 0.0, 1.0)
        self.line = first + blend[:, None] * (last - first)
        self.weight = T / len(self.times) * 100.0  # samples at 100 Hz for each of these times
        limits, follow = problem.widest_limits, self.dynamics.dependent
        own = [robot.configuration_indices(name) for name in self.dynamics.names]
        places = [at.start for at in own]
        self.bounds = [
            (limits.q_lower[places], limits.q_upper[places]),
            (_ROOM * limits.v_lower[moved], _ROOM * limits.v_upper[moved]),
            (_ROOM * limits.a_lower[moved], _ROOM * limits.a_upper[moved]),
        ]
        self.others: IntArray = np.delete(np.arange(robot.nq), np.r_[tuple(own)])
        self.ranges = [
            np.concatenate([_ROOM * u, _ROOM * v[follow], _ROOM * a[follow], [far], q[self.others]])
            for q, v, a, u, far in zip(
                *(limits.sides(letter) for letter in "qvau"), (-np.inf, self._fastest(first)), strict=True
            )
        ]
        fast = (limits.finite("v") | limits.finite("a"))[moved] | limits.finite("u")
        if not fast.all():
            raise ProblemError(
                f"excite: nothing limits how fast {self.dynamics.names[int(fast.argmin())]!r} moves; give "
                "limits.velocity, limits.acceleration or limits.effort"
            )

    def _fastest(self, first: Array) -> float:
        """How fast dependent joints may be by the others': near singular poses they have no bound."""
        if not len(self.dynamics.dependent):
            return np.inf
        still = np.zeros((1, self.dynamics.n))
        G = self.dynamics.motion(first[None], still, still, self.problem.q_start[None]).G
        return _LEVER * max(float(np.linalg.norm(G[:, self.dynamics.dependent])), 1.0)

    def motion(self, c: Array) -> JointMotion:
        """The motion of control points (count, n)."""
        y, yd, ydd = (B @ c for B in self.values)
        return self.dynamics.motion(y, yd, ydd, self.dynamics.follow(y, self.problem.q_start))

    def torques_by_base(self, motion: JointMotion) -> Array:
        """Derivatives of torques in base parameters, in standard deviations, shape (K, n, rank)."""
        return _columns(self.dynamics, self.unknowns, self.base, motion) / self.noise[:, None]

    def matrix(self, motion: JointMotion) -> Array:
        """Its information."""
        Y = self.torques_by_base(motion)
        return np.asarray(self.weight * np.einsum("kjp,kjr->pr", Y, Y))

    def slope(self, motion: JointMotion) -> Array:
        """Gradient of log det in the control points: the trace of inv(I) dI."""
        told = self.matrix(motion)
        size = np.sqrt(np.diag(told))
        scales = np.outer(size, size)
        rest = 2.0 * self.weight * self.torques_by_base(motion) @ (np.linalg.inv(told / scales) / scales)
        parts = self.dynamics.differences(
            lambda there: np.einsum("kjp,kjp->k", rest, self.torques_by_base(there)), motion
        )
        return np.asarray(sum(B.T @ part for B, part in zip(self.values, parts, strict=True)))

    def begin(self, rng: np.random.Generator) -> Array:
        """A random motion, as large as limits allow, about the straight one."""
        away = rng.standard_normal(self.line.shape) * self.free[:, None]
        for size in 4.0 * 0.9 ** np.arange(100.0):
            if self.within(self.line + size * away) is not None:
                return np.asarray(self.line + size * away)
        raise ProblemError(
            "excite: no smooth motion from start to goal keeps the limits: give a longer horizon.duration"
        )

    def within(self, c: Array) -> JointMotion | None:
        """The motion of control points, if its loops close and the limits hold."""
        rows, upper = self.linear
        if (rows @ c.ravel() > upper + 1e-9).any():
            return None
        try:
            motion = self.motion(c)
        except InvalidValue:
            return None
        values, (lower, upper) = self.compute_bounded_values(motion), self.ranges
        return motion if ((values >= lower) & (values <= upper)).all() else None

    def compute_bounded_values(self, motion: JointMotion) -> Array:
        """What limits are not linear in, by times.

        Torques of motors; of dependent joints rates, accelerations, rates by those of the others, positions.
        """
        follow = self.dynamics.dependent
        return np.hstack(
            [
                self.torque(motion),
                motion.v[:, follow],
                motion.a[:, follow],
                np.linalg.norm(motion.G[:, follow], axis=(1, 2))[:, None],
                motion.qs[:, self.others],
            ]
        )

    def torque(self, motion: JointMotion) -> Array:
        """Torques of the motors by the file's parameters."""
        still = np.zeros((len(motion.v), self.problem.robot.nu))
        needed = self.dynamics.regressor(motion) @ self.dynamics.values
        return np.asarray(needed - self.dynamics.compute_applied_torques(motion, still))

    @cached_property
    def linear(self) -> tuple[Array, Array]:
        """Rows and upper bounds of limits that are linear in the control points."""
        pairs = []
        for hull, (lo, hi) in zip(self.hulls, self.bounds, strict=True):
            row = np.kron(hull, np.eye(self.dynamics.n))
            pairs += [(row, np.tile(hi, len(hull))), (-row, np.tile(-lo, len(hull)))]
        return _stack(pairs)

    def linearise_limits(self, motion: JointMotion) -> tuple[Array, Array]:
        """The other limits, linear about a motion: rows and upper bounds of changes."""
        values, parts = (
            self.compute_bounded_values(motion),
            self.dynamics.differences(self.compute_bounded_values, motion),
        )
        finite = np.flatnonzero(np.isfinite(self.ranges).any(axis=0))
        blocks = [
            np.einsum("kc,kji->kjci", B, part[:, finite]) for B, part in zip(self.values, parts, strict=True)
        ]
        slope = np.sum(blocks, axis=0).reshape(len(values) * len(finite), self.line.size)
        tight = np.where(np.arange(values.shape[1]) < values.shape[1] - len(self.others), _TIGHT, 1.0)
        lower, upper = (tight * side - values for side in self.ranges)
        return _stack(
            [
                (slope, np.maximum(upper[:, finite], 0.0).ravel()),
                (-slope, np.maximum(-lower[:, finite], 0.0).ravel()),
            ]
        )

    def climb(self, c: Array, rounds: int) -> tuple[float, Array]:
        """Linear programmes within a box that grows while log det does; every iterate keeps the limits."""
        rows, upper = self.linear
        free, motion, box = np.flatnonzero(np.repeat(self.free, self.dynamics.n)), self.motion(c), 0.2
        best = _log_det(self.matrix(motion))
        for _ in range(rounds):
            slope, (more, room) = self.slope(motion).ravel()[free], self.linearise_limits(motion)
            A = np.vstack([rows, more])[:, free]
            b = np.concatenate([np.maximum(upper - rows @ c.ravel(), 0.0), room])
            gain = 0.0
            while box > 1e-4:
                step = linprog(-slope, A_ub=A, b_ub=b, bounds=(-box, box), method="highs").x
                trial = c.ravel().copy()
                trial[free] += 0.0 if step is None else step
                there = self.within(trial.reshape(c.shape))
                gain = 0.0 if there is None else _log_det(self.matrix(there)) - best
                if there is not None and gain > 0.0:
                    c, motion, best, box = trial.reshape(c.shape), there, best + gain, 1.5 * box
                    break
                box *= 0.4
            if gain < _GAIN:
                break
        return best, c

    def problem_near(self, c: Array) -> Problem:
        """The problem, with the distance from a spline as cost."""
        problem, robot = self.problem, self.problem.robot
        times = np.linspace(0.0, problem.duration, problem.num_steps + 1)[1:]
        y, yd = self.spline(times) @ c, self.spline.derivative()(times) @ c
        there = self.dynamics.motion(y, yd, np.zeros_like(y), self.dynamics.follow(y, problem.q_start))
        ps = [robot.momentum(q, v) for q, v in zip(there.qs, there.v, strict=True)]
        tables = write_tables(problem)
        goal = tables["goal"]["q"]
        for key in ("guess", "terms", "cost"):
            tables.pop(key, None)
        return problem_from_tables(
            {
                **tables,
                "goal": {"q": goal, "v": 0.0, "enforce": "exact"},
                "cost": {
                    "effort": _KEPT,
                    "tracking": _NEAR,
                    "target": {"q": there.qs.tolist(), "p": np.array(ps).tolist()},
                },
                "guess": {"kind": "way", "q": there.qs[:-1].tolist()},
            },
            robot=robot,
            label="excite",
            terms=[term for term in problem.terms if term.role == "path"],
        )


def _ends(problem: Problem, dynamics: InverseDynamics) -> tuple[Array, Array]:
    """Independent coordinates at both ends."""
    if problem.phase or problem.via:
        raise ProblemError("excite: motions with phases or via points are not searched; leave these out")
    if problem.duration_range is not None:
        raise InvalidValue("excite: horizon.duration", "a range", "a number [s]")
    first, last = (dynamics.coordinates(q) for q in (problem.q_start, problem.goal.q))
    still = np.zeros((1, dynamics.n))
    G = dynamics.motion(last[None], still, still, problem.goal.q[None]).G[0]
    if np.linalg.matrix_rank(G[problem.goal.q_active]) < dynamics.n:
        raise InvalidValue("excite: goal", "no configuration", "goal.q, as start.q if periodic")
    if np.any(problem.v_start):
        raise InvalidValue("excite: start.v", problem.v_start, "rest")
    return first, last


def _noise(torque_noise: ArrayLike, n: int) -> Array:
    given: Sequence[float] | Array = np.asarray(torque_noise, dtype=np.float64)
    if np.shape(given) not in ((), (n,)) or not (np.isfinite(given).all() and np.all(np.greater(given, 0.0))):
        raise InvalidValue("torque_noise", torque_noise, f"a positive number, or {n} of them [N m, N]")
    return np.broadcast_to(given, (n,))


def _columns(
    dynamics: InverseDynamics, unknowns: Unknowns, base: BaseParameters, motion: JointMotion
) -> Array:
    return np.asarray(dynamics.regressor(motion) @ unknowns.shares[:, base.chosen])


def _stack(pairs: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Rows and upper bounds one below the other, without those that are infinite."""
    rows, upper = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    finite = np.isfinite(upper)
    return rows[finite], upper[finite]


def _log_det(matrix: Array) -> float:
    sign, value = np.linalg.slogdet(matrix)
    return float(value) if sign > 0.0 else -np.inf
