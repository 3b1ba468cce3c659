"""What is asked for on a live page, and the thread that solves for what is asked last."""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import field, replace
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import MbocpError, ProblemError
from mbocp.problem import Goal, Problem
from mbocp.problem.weights import weights_by_key
from mbocp.robot import FrameTarget, Robot
from mbocp.solution import Solution
from mbocp.solving import solve

_ON_DISTANCES = ("tracking", "terminal")  # terms with a target, beside those that are weights alone


@dataclass(frozen=True, eq=False)
class Wish:
    """Changes of a problem.

    Attributes
    ----------
    poses : mapping of int to pin.SE3
        Poses in the world of the goal's frames, by their place among them.
    q : ndarray, shape (nq,), optional
        Configuration of the goal [m, rad, unit quaternion xyzw].
    tool : pin.SE3, optional
        Pose in the world of the first frame that leaves a trace; the goal's joints are to bring it there.
    factors : mapping of str to float
        What weights of the cost are multiplied by, by their keys in `[cost]`.
    duration : float, optional
        [s].
    """

    poses: Mapping[int, pin.SE3] = field(default_factory=dict)
    q: Array | None = None
    tool: pin.SE3 | None = None
    factors: Mapping[str, float] = field(default_factory=dict)
    duration: float | None = None


def change_problem(problem: Problem, wish: Wish, q_near: Array) -> Problem:
    """Problem with the changes.

    Parameters
    ----------
    problem : Problem
    wish : Wish
    q_near : ndarray, shape (nq,)
        Of several configurations at the goal's poses the nearest to this one is taken.

    Raises
    ------
    MbocpError
        If the goal is out of reach, or cannot be.
    """
    changes: dict[str, Any] = {}
    if wish.poses or wish.q is not None or wish.tool is not None:
        changes["goal"] = _move_goal(problem, wish, q_near)
    factors = {key: factor for key, factor in wish.factors.items() if factor != 1.0}
    if factors:
        weights = {key: factor * np.asarray(problem.cost.weight(key)) for key, factor in factors.items()}
        scalars = {key: float(value) if value.ndim == 0 else value for key, value in weights.items()}
        changes["cost"] = problem.cost.with_weights(scalars)
    if wish.duration is not None:
        changes["duration"] = wish.duration
    return problem.with_(**changes) if changes else problem


def weight_keys(problem: Problem) -> list[str]:
    """Keys in `[cost]` of the terms that count."""
    cost = problem.cost
    keys = [key for key in (*_ON_DISTANCES, *weights_by_key()) if np.any(cost.weight(key))]
    return [key for key in dict.fromkeys(keys) if key != "terminal" or problem.goal.is_penalised]


def _move_goal(problem: Problem, wish: Wish, q_near: Array) -> Goal:
    """The goal with frames and joints elsewhere."""
    robot, goal = problem.robot, problem.goal
    frames = list(goal.frames)
    for place, pose in wish.poses.items():
        target = frames[place].target
        reference = robot.frame_placement(target.relative_to, q_near)
        frames[place] = replace(frames[place], target=_move_target(target, reference.actInv(pose)))
    q = goal.q if wish.q is None else wish.q
    if wish.tool is not None:
        q = _q_at_tool(robot, wish.tool, q_near)
    elif wish.poses:
        q = _q_at_frames(problem, [frame.target for frame in frames if frame.has_pose], q_near)
    return replace(goal, frames=tuple(frames), q=q)


def _move_target(target: FrameTarget, pose: pin.SE3) -> FrameTarget:
    """What a target asks for, at a pose in its reference frame."""
    changes: dict[str, Any] = {}
    if target.position is not None:
        asked = np.isfinite(target.position)
        changes["position"] = np.where(asked, pose.translation, np.nan)
    if target.orientation is not None:
        changes["orientation"] = pin.Quaternion(pose.rotation).coeffs()
    if target.axis is not None:
        changes["direction"] = pose.rotation @ target.axis
    return replace(target, **changes)


def _q_at_tool(robot: Robot, pose: pin.SE3, q_near: Array) -> Array:
    name = robot.trace_frames[0]
    found = robot.inverse_kinematics(FrameTarget.at(name, pose), q_near, restarts=_RESTARTS)
    if not found.reached:
        distance = 1e3 * float(found.position_errors.max())
        raise ProblemError(f"goal: {name} is out of reach there: the nearest pose is {distance:.3g} mm away")
    return np.array(found.q)


def _q_at_frames(problem: Problem, targets: list[FrameTarget], q_near: Array) -> Array:
    """A configuration at the poses near another one; where there is none, the problem looks further."""
    robot, limits = problem.robot, problem.limits_of_ends[1]
    given = robot.joints_with(problem.goal.q_active)
    within: Any = (limits.q_lower, limits.q_upper) if limits.finite("q").any() else True
    start = np.array(q_near)
    for name in given:
        start[robot.configuration_indices(name)] = problem.goal.q[robot.configuration_indices(name)]
    found = robot.inverse_kinematics(targets, start, fixed=given, restarts=0, within_limits=within)
    return np.array(found.q if found.reached else problem.goal.q)


_RESTARTS = 4  # of a search that has to be done within a moment


@dataclass(frozen=True, eq=False)
class Reply:
    """What became of a wish.

    Attributes
    ----------
    wish : Wish
    problem : Problem, optional
        What was solved; None where it cannot be asked for.
    solution : Solution, optional
    seconds : float
        Time that it took, the making of the problem included [s].
    words : str
        Why there is no solution, or what is odd about the problem.
    """

    wish: Wish
    problem: Problem | None
    solution: Solution | None
    seconds: float
    words: str = ""

    @property
    def is_good(self) -> bool:
        """Whether there is a solution that converged."""
        return self.solution is not None and self.solution.converged

    @property
    def state(self) -> str:
        """How it went, in a line."""
        took = f"{1e3 * self.seconds:.0f} ms" if self.seconds < 1.0 else f"{self.seconds:.1f} s"
        if self.solution is None:
            return f"not solved ({took})"
        count = self.solution.iterations
        steps = f"{count} iteration{'' if count == 1 else 's'}"
        if self.is_good:
            return f"converged in {took}, {steps}, cost {self.solution.cost:.5g}"
        return f"not converged: {self.solution.status}, {took}, {steps}"


class Resolver:
    """Solves for the last of the wishes that came in while it was busy.

    Parameters
    ----------
    problem : Problem
        What wishes change.
    solution : Solution
        Its solution: from where the first wish is solved.
    on_answer : callable
        Called in the thread, with each `Reply`.
    rate : float
        Solves a second, at most [1/s].
    time_limit : float
        Longest time of a solve [s].
    """

    def __init__(
        self,
        problem: Problem,
        solution: Solution,
        on_answer: Callable[[Reply], None],
        *,
        rate: float = 20.0,
        time_limit: float = 2.0,
    ) -> None:
        self._problem, self._good = problem, solution
        self._time_limit = time_limit
        self._on_answer, self._period = on_answer, 1.0 / rate
        self._changed = threading.Condition()
        self._wish: Wish | None = None
        self._is_busy = self._is_closed = False
        self.error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="mbocp live", daemon=True)
        self._thread.start()

    def ask(self, wish: Wish) -> None:
        """Solve for a wish as soon as possible, in the place of one that has not begun."""
        with self._changed:
            self._wish = wish
            self._changed.notify_all()

    def wait_until_idle(self, timeout: float | None = None) -> bool:
        """Block until all is answered; False if that takes longer than the timeout [s]."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._is_busy and self._wish is None, timeout)

    def close(self) -> None:
        """End the thread, after the solve that it is at."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run(self) -> None:
        try:
            while (wish := self._next()) is not None:
                begun = time.perf_counter()
                self._on_answer(self._answer(wish))
                with self._changed:
                    self._is_busy = False
                    self._changed.notify_all()
                    left = self._period - (time.perf_counter() - begun)
                    self._changed.wait_for(lambda: self._is_closed, max(left, 0.0))
        except BaseException as error:
            self.error = error  # told where somebody waits for the page
            with self._changed:
                self._is_busy, self._wish, self._is_closed = False, None, True
                self._changed.notify_all()

    def _next(self) -> Wish | None:
        """The last wish, once there is one; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._wish is not None or self._is_closed)
            wish, self._wish = self._wish, None
            self._is_busy = wish is not None
            return None if self._is_closed else wish

    def _answer(self, wish: Wish) -> Reply:
        begun = time.perf_counter()
        problem, solution, words = None, None, []
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                problem = change_problem(self._problem, wish, np.array(self._good.qs[-1]))
                solution = solve(problem, warm_start=self._good, time_limit=self._time_limit)
            except MbocpError as error:
                words.append(str(error))
        if solution is not None and solution.converged:
            self._good = solution
        elif solution is not None:
            words.append(solution.advice)
        words += [str(warning.message) for warning in caught]
        return Reply(wish, problem, solution, time.perf_counter() - begun, "; ".join(filter(None, words)))
