"""The horizon that moves on: `RecedingHorizon`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import InvalidValue, MbocpError, ProblemError, SolverError
from mbocp.formulation import Formulation
from mbocp.formulation.formulate import formulate_with_independent_ends, with_compiled_functions
from mbocp.formulation.updates import ParameterUpdates
from mbocp.guesses.in_turn import solve_from_guesses
from mbocp.job import Job
from mbocp.problem import Problem
from mbocp.problem._checks import check_integer
from mbocp.problem.coordinates import COORDINATES
from mbocp.programme import Iterate
from mbocp.receding.given import MICROSECOND, MOST_ITERATIONS, iterations_of, numbers_of, time_of
from mbocp.receding.refusals import MovingStages, check_can_recede, check_functions
from mbocp.receding.saved import check_savable, write_horizon
from mbocp.receding.speed import targets_at_speed
from mbocp.receding.status import HorizonStatus
from mbocp.robot import Robot
from mbocp.solution import Solution
from mbocp.solution.from_files import problem_from
from mbocp.solvers import Status
from mbocp.solvers.receding import RecedingSettings, loop_of, make_receding_horizon
from mbocp.solvers.strategies.patience import Patience

_WHOLE = 1e-6  # of a step: times that are as good as whole ones


@dataclass(frozen=True, slots=True, eq=False)
class HorizonStep:
    """The prediction after a step.

    Arrays are views of the horizon's memory, which the next step overwrites: copy what is to stay.

    Attributes
    ----------
    status : HorizonStatus
    u : ndarray, shape (nu,)
        Control for the step from now on [N, N m, and the units of drives]; for a part of it see
        `RecedingHorizon.control_for`.
    K : ndarray, shape (nu, 2 nv)
        What it answers to a deviation dx of the state, u + K dx, of the last factorisation: moves of q
        along its tangent, then of v. Shape (0, 0) where the programme's states are not (q, v).
    q : ndarray, shape (N + 1, nq)
        Predicted configurations [m, rad, unit quaternion xyzw], the first of them now.
    v : ndarray, shape (N + 1, nv)
        Velocities [m/s, rad/s].
    us : ndarray, shape (N, nu)
        Controls of the steps.
    gains : ndarray, shape (N, nu, 2 nv)
        K of every step, or shape (0, 0, 0).
    """

    status: HorizonStatus
    u: Array
    K: Array
    q: Array
    v: Array
    us: Array
    gains: Array

    def __repr__(self) -> str:
        return f"<HorizonStep {self.status.state}: {self.status}>"


class RecedingHorizon:
    """An optimal control problem that is solved again and again, from wherever the robot is.

    Functions are compiled and the first motion is solved for at construction. A step then shifts that motion
    in time, begins it at the given state and takes a few exact Newton steps in one call of the kernel, which
    allocates nothing. Limits are kept by a barrier, which goes by the cost.

    Parameters
    ----------
    problem : Problem, str or Path
        The horizon is its own: it always ends `duration` from now, where the goal is. Phases repeat for ever;
        via points come nearer until they are over.
    warm_start : Solution, optional
        Where the first solve begins.
    iterations : int
        Newton steps of a step, at most; 1 to 1,000,000.
    barrier : float
        Part of the cost that the limits' barrier may take: smaller ones come nearer to limits, and need more
        Newton steps where other limits become active.
    tolerance : float
        Norm of a Newton step below which no further one is taken.

    Attributes
    ----------
    problem : Problem
    first : HorizonStep
        The motion from the problem's start.

    Raises
    ------
    ProblemError
        If the problem belongs to given times that cannot move, or finds its own; or its phases cannot follow
        themselves.
    InvalidValue
        If `iterations` is out of range.
    SolverError
        If the problem cannot be solved from its start.
    """

    def __init__(
        self,
        problem: Problem | str | Path,
        *,
        warm_start: Solution | None = None,
        iterations: int = 1,
        barrier: float = 1e-3,
        tolerance: float = 1e-6,
    ) -> None:
        self.problem = problem_from(problem)
        check_can_recede(self.problem)
        self._iterations = check_integer("iterations", iterations, 1, MOST_ITERATIONS)
        formulation, _ = formulate_with_independent_ends(self.problem, math.inf)
        self._formulation = with_compiled_functions(formulation)
        check_functions(self._formulation)
        iterate = _solve(self._formulation, warm_start)
        self._settings = RecedingSettings(barrier, tolerance)
        self._native, self._programme = make_receding_horizon(
            self._formulation.programme, iterate, self._settings
        )
        self._has_limits = bool(self._programme.slack.size)
        self._numbers = ParameterUpdates(self._formulation)
        differ = self.problem.phase or self.problem.via
        self._stages = MovingStages(self._formulation, self._programme) if differ else None
        self._state = np.array(self._formulation.start_state(self.problem.q_start, self.problem.v_start))
        self._take_views()
        self.first = self._step(HorizonStatus("converged", 1, 0.0, 1.0, 0.0, 0.0, 0.0))

    def step(
        self,
        q: Any,
        v: Any,
        *,
        goal: Any = None,
        target: Any = None,
        weights: Mapping[str, Any] | None = None,
        robot: Robot | None = None,
        speed: Any = None,
        dt: float | None = None,
        time_limit: float | None = None,
        iterations: int | None = None,
    ) -> HorizonStep:
        """Move on in time and improve the motion from a state. Nothing is raised: see `HorizonStep.status`.

        Parameters
        ----------
        q : array_like, shape (nq,)
            Configuration of the robot [m, rad, unit quaternion xyzw].
        v : array_like, shape (nv,)
            Velocity [m/s, rad/s].
        goal : array_like or mapping, optional
            Another goal from now on: a configuration; or some of `q`, `v` or `p`, and poses by names of
            frames, as far as the problem's goal has them: a matrix (4, 4), or a position (3,) [m].
        target : array_like or mapping, optional
            Another target of the tracking cost from now on, one row or N.
        weights : mapping, optional
            Other weights of the cost from now on, by their keys in `[cost]`.
        robot : Robot, optional
            The robot with another payload from now on, on the same frames as in the problem.
        speed : array_like, shape (3,), optional
            Another target of the tracking cost in this step: the floating base goes on from where it is,
            forward and to the left [m/s], and turns [rad/s]. Its height, its attitude but for the heading and
            all other joints are those of the problem's target.
        dt : float, optional
            Time since the step before [s]; default: one step of the horizon. With phases or via points a
            multiple of it.
        time_limit : float, optional
            Time that the step may take in the kernel [us]: no second Newton step begins that would not end in
            time, by how long those before took, and each looks at the clock between its parts.
        iterations : int, optional
            Newton steps at most, in place of those of the horizon; with 0 the motion is shifted and no more.
        """
        wrong = self._take_numbers(goal, target, weights, robot) + self._take_state(q, v)
        steps, limit, count, words = self._times(dt, time_limit, iterations)
        wrong += words
        has_moved = steps > 0.0
        is_new = self._numbers.move_on(steps * self.problem.dt)
        if self._stages is not None and steps > 0.0:
            self._stages.move_on(round(steps), self._numbers)
            steps, is_new = 0.0, True
            self._forget_barrier()
        if speed is not None:
            wrong += self._take_speed(q, speed)
            is_new = True
        if is_new:
            self._pass_numbers()
        found = self._native.step(self._state, steps, count, limit)
        if has_moved and self._numbers.take_before():
            self._pass_numbers()
        if found.outcome.name == "bad_state" and not wrong:
            wrong = ["q or v: not finite"]
        return self._step(HorizonStatus.of(found, wrong))

    def control_for(self, period: float) -> Array:
        """Control to hold for less than a step of the horizon, from the last prediction, shape (nu,).

        `HorizonStep.u` is that of the middle of the first step, and comes early where it is held for a part
        of that: this is on the line through those of the first two steps, amid the period, within
        `limits.effort`.

        Parameters
        ----------
        period : float
            Time for which it is held [s]; from a step on it is `HorizonStep.u`.

        Raises
        ------
        InvalidValue
            If the period is no positive time.
        """
        if not period > 0.0:
            raise InvalidValue("period", period, "a time above 0 [s]")
        us = self._views[4] if self._stages is None else self._views[4][~self._stages.is_impact]
        early = 0.5 * (1.0 - min(period / self.problem.dt, 1.0))
        found: Array = us[0] - early * (us[min(1, len(us) - 1)] - us[0])
        limits = self.problem.limits
        return np.clip(found, limits.u_lower, limits.u_upper)

    @property
    def times(self) -> Array:
        """Times of the nodes from now on [s], shape (N + 1,): impacts of phases take none."""
        if self._stages is not None:
            return self._stages.times
        return np.arange(self.problem.num_steps + 1.0) * self.problem.dt

    def contact_forces(self) -> dict[str, Array]:
        """Forces of the contacts of the last prediction, by name, shapes (N, 6) [N, N m].

        Along the normal and two tangents, and torques about them; of impacts the impulse by the length of a
        step. Zero where a contact is open; empty without phases.
        """
        return {} if self._stages is None else self._stages.forces()

    def save(self, folder: str | Path) -> Path:
        """Write a folder from which a C++ program without Python goes on as this horizon would.

        See `mbocp/receding_horizon.hpp` in `mbocp.receding.HEADERS`. The folder is for machines with the same
        processor instructions; it holds code.

        Parameters
        ----------
        folder : str or Path
            Made where there is none.

        Raises
        ------
        ProblemError
            If states are not (q, v), something belongs to given times, or functions are interpreted.
        ResultFileError
            If something cannot be written.
        """
        if self._stages is not None:
            raise ProblemError(
                "receding horizon: phase, via: phases and via points move in Python alone; save a horizon "
                "that has none"
            )
        check_savable(
            self._formulation, is_plain=self._is_plain, belongs_to_times=self._numbers.belong_to_times
        )
        numbers = {
            "theta": self._numbers.theta,
            "rho": self._numbers.rho,
            "rho_terminal": self._numbers.rho_terminal,
            "state": self._state,
            "iterations": np.array([self._iterations]),
            "effort_lower": self.problem.limits.u_lower,
            "effort_upper": self.problem.limits.u_upper,
        }
        return write_horizon(
            folder,
            self._formulation,
            self._native,
            self._programme,
            self._settings,
            self._numbers.places,
            numbers,
        )

    def _take_state(self, q: Any, v: Any) -> list[str]:
        """Copy a state to where the kernel reads it; words for what cannot be, and NaN in its place."""
        robot, at, wrong = self.problem.robot, self._state, list[str]()
        q0, v0 = numbers_of("q", q, robot.nq, wrong), numbers_of("v", v, robot.nv, wrong)
        if q0 is None or v0 is None:
            at[0] = math.nan
        elif self._is_plain:
            at[: robot.nq], at[robot.nq :] = q0, v0
        else:
            at[:] = self._formulation.start_state(q0, v0)
        return wrong

    def _forget_barrier(self) -> None:
        """Begin another loop where the last limit is over: one with a barrier waits for it to fall."""
        if self._has_limits and not self._programme.slack.size:
            self._has_limits = False
            self._native = loop_of(self._formulation.programme, self._programme, self._settings)
            self._take_views()

    def _take_speed(self, q: Any, speed: Any) -> list[str]:
        """Take a speed of the base; words for what cannot be."""
        nominal, times = np.atleast_2d(self.problem.cost.target_q)[0], self.times
        moments = times[:-1] + self._formulation.pieces.signature.steps.tau * np.diff(times)
        try:
            at = np.asarray(q, dtype=np.float64)
            if not (at.shape == nominal.shape and np.isfinite(at).all()):
                return []  # told already, of q
            targets = targets_at_speed(self.problem.robot, nominal, at, speed, moments)
            self._numbers.set_target({"q": targets})
        except (MbocpError, TypeError, ValueError) as error:
            return [str(error)]
        return []

    def _take_numbers(
        self, goal: Any, target: Any, weights: Mapping[str, Any] | None, robot: Robot | None
    ) -> list[str]:
        """Take other goals, targets, weights and payloads; words for what cannot be."""
        if goal is None and target is None and weights is None and robot is None:
            return []
        wrong = []
        changes: tuple[tuple[Callable[[Any], None], Any], ...] = (
            (self._numbers.set_goal, goal),
            (self._numbers.set_target, target),
            (self._numbers.set_weights, weights),
            (self._numbers.set_robot, robot),
        )
        for change, value in changes:
            try:
                if value is not None:
                    change(value)
            except (MbocpError, TypeError, ValueError) as error:
                wrong.append(str(error))
        self._pass_numbers()
        return wrong

    def _times(
        self, dt: float | None, time_limit: float | None, iterations: int | None
    ) -> tuple[float, float, int, list[str]]:
        """Steps to move by, time limit [s], Newton steps, and words for what cannot be."""
        wrong, unit = list[str](), self.problem.dt
        steps = time_of("dt", dt, unit, "s", wrong) / unit
        if self._stages is not None and abs(steps - round(steps)) > _WHOLE:
            step = f"{unit:g} s, the step by which phases and via points move"
            wrong.append(f"dt: got {dt}, expected a multiple of {step}")
            steps = float(max(round(steps), 1))
        limit = time_of("time_limit", time_limit, math.inf, "us", wrong) * MICROSECOND
        return steps, limit, iterations_of(iterations, self._iterations, wrong), wrong

    def _pass_numbers(self) -> None:
        numbers = self._numbers
        self._programme.set_parameters(numbers.theta, numbers.rho, numbers.rho_terminal)

    def _take_views(self) -> None:
        """Arrays over the kernel's memory, once."""
        at, robot, native = self._formulation.layout, self.problem.robot, self._native
        self._is_plain = (
            COORDINATES[self.problem.coordinates].has_joint_states
            and at.nz == robot.nq
            and at.ns == robot.nv
            and self._state.size == robot.nq + robot.nv
            and at.nw == robot.nv
            and not robot.drives
        )
        x, us = native.x, native.u[:, : robot.nu]
        gains = native.gains[:, : robot.nu, : 2 * robot.nv] if self._is_plain else np.zeros((0, 0, 0))
        K = gains[0] if self._is_plain else np.zeros((0, 0))
        self._views = (us[0], K, x[:, at.z], x[:, at.s], us, gains)

    def _step(self, status: HorizonStatus) -> HorizonStep:
        u, K, q, v, us, gains = self._views
        if not self._is_plain:
            motion = self._formulation.motion_of(
                Iterate.read_from(self._programme, self._formulation.programme)
            )
            q, v = motion.qs, motion.vs
        return HorizonStep(status, u, K, q, v, us, gains)


def _solve(formulation: Formulation, warm_start: Solution | None) -> Iterate:
    """Solution of a problem from its start.

    Raises
    ------
    SolverError
        If the solver does not converge.
    """
    job = Job(formulation.problem, formulation.problem, warm_start, math.inf, Patience())
    outcome, _ = solve_from_guesses(job, formulation, phases=[])
    result = outcome.result
    if result.status is not Status.CONVERGED:
        raise SolverError(
            f"receding horizon: the problem is not solved from its start: {result.status}, {result.advice}"
        )
    return result.iterate
