"""How much better a motion could be at most: lower bounds of duration and cost."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.bounds.durations import BY_FORCES, BY_FRAMES, least_duration
from mbocp.bounds.task import BoundTask, windows_of
from mbocp.integrators import SCHEMES, VELOCITY_TAU
from mbocp.problem import Problem
from mbocp.problem.coordinates import COORDINATES
from mbocp.solution import Solution

_PARTS = 400  # of the range of a free duration


@dataclass(frozen=True)
class Bound:
    """A cost and a duration that no motion of a problem falls below.

    Attributes
    ----------
    value : float
        Lower bound of the cost; NaN where there is none.
    duration : float
        Lower bound of the duration [s].
    method : str
        What decides, in words; empty where nothing does.
    of : {"continuous", "continuous and discretised"}
        Which problem it is a bound of: steps may beat one of continuous time by their error.
    reason : str
        Why there is no bound, or none above zero; else empty.
    reached, reached_duration : float
        Cost and duration [s] of the solution; NaN where there is none.
    """

    value: float
    duration: float
    method: str = ""
    of: str = "continuous"
    reason: str = ""
    reached: float = math.nan
    reached_duration: float = math.nan

    @property
    def is_valid(self) -> bool:
        """Whether there is a bound of the cost; it may be zero."""
        return not math.isnan(self.value)

    @property
    def gap(self) -> float:
        """Which part of the cost that was reached is above the bound; NaN if either is unknown."""
        return (self.reached - self.value) / abs(self.reached) if self.reached else math.nan

    @property
    def words(self) -> str:
        """The bound in a line."""
        if not self.is_valid:
            return f"none: {self.reason}"
        gap = "" if math.isnan(self.gap) else f", {100.0 * self.gap:.3g} % below what was reached"
        how = self.method or self.reason
        return f"{self.value:.6g}{gap}" + (f" ({how})" if how else "")


def bound(problem: Problem | Solution, solution: Solution | None = None) -> Bound:
    """Bound cost and duration of all motions that a problem allows, from below.

    Parameters
    ----------
    problem : Problem or Solution
        A solution is one of its own problem.
    solution : Solution, optional
        What is known to be possible, for a gap. It helps, too: motions that cost less have bounded efforts,
        and so bounded speeds.

    Examples
    --------
    >>> mbocp.bound(mbocp.solve(problem)).gap  # doctest: +SKIP
    0.021
    """
    if isinstance(problem, Solution):
        return bound(problem.problem, problem)
    reached = solution.cost if solution is not None and solution.is_stationary else math.nan
    return _best(problem, reached, solution)


def quick_bound(solution: Solution, problem: Problem) -> Bound:
    """Bound by arithmetic on single joints alone, which takes less than a millisecond for each goal."""
    return _best(problem, math.nan, solution, is_quick=True)


def _best(problem: Problem, reached: float, solution: Solution | None, *, is_quick: bool = False) -> Bound:
    """Bound the best of several goals, which may be any."""
    found = [_of_task(BoundTask.of(one, reached), is_quick) for _, one in problem.members]
    least = min(found, key=lambda one: (one.is_valid, one.value))
    least = replace(least, duration=min(one.duration for one in found))
    if solution is None:
        return least
    return replace(least, reached=solution.cost, reached_duration=solution.duration)


def _of_task(task: BoundTask, is_quick: bool) -> Bound:
    low, high = task.problem.duration_range or (task.problem.duration,) * 2
    if task.why_none:
        return Bound(math.nan, low, reason=task.why_none)
    if low == high:
        least, method = low, ""
    else:
        least, method = least_duration(task, is_quick=is_quick)
        method = method if least > low else "horizon.duration.min"
        least = min(max(least, low), high)
    if task.why_no_cost:
        return Bound(math.nan, least, method, reason=task.why_no_cost)
    edges = np.linspace(least, high, _PARTS + 1 if high > least else 2)
    of_time = float(task.lightest("time", 1)[0])
    moved = _cost_of_motion(task, edges[1:])
    value = float(np.min(of_time * edges[:-1] + moved))
    value += sum(one.least_cost for one in task.problem.parameter)
    words = [method] if method and of_time else []
    if moved.any():
        words.append("squares of rates")
    efforts, reason = 0.0, "efforts are not looked at: the duration is free"
    if low == high and not is_quick:
        efforts, reason = _efforts(task)
    if efforts > 0.0:
        words.append("momenta")
    value = value + efforts if math.isnan(task.reached) else min(value + efforts, max(task.reached, value))
    is_of_steps = not efforts and method not in (BY_FORCES, BY_FRAMES) and _holds_for_steps(task.problem)
    of = "continuous and discretised" if is_of_steps else "continuous"
    return Bound(value, least, "; ".join(words), of, "" if value > 0.0 else reason)


def _holds_for_steps(problem: Problem) -> bool:
    """Whether what bounds speeds and accelerations bounds those of steps, which are pieces of constant ones.

    Forces and jerks of steps are others than those of a continuous motion.
    """
    has_joint_states = COORDINATES[problem.coordinates].has_joint_states
    scheme = problem.scheme
    is_linear = has_joint_states and VELOCITY_TAU.get(scheme) == 0.5 and not SCHEMES[scheme].projects
    is_free = not problem.robot.nc  # steps of closed loops put them together again
    return is_linear and is_free and "j" not in problem.widest_limits.letters


def _cost_of_motion(task: BoundTask, times: Array) -> Array:
    """What squares of velocities and accelerations cost in given times at least."""
    total = np.zeros_like(times)
    nv, start, goal = task.problem.robot.nv, task.places[0], task.places[-1]
    speed, rise = task.lightest("velocity", nv), task.lightest("acceleration", nv)
    for i, way in enumerate(task.ways):
        total += 0.5 * speed[i] * way**2 / times
        if np.isfinite(task.moves[i]) and start.v[i] == 0.0:
            total += rise[i] * (6.0 if goal.v[i] == 0.0 else 1.5) * task.moves[i] ** 2 / times**3
    return total


def _efforts(task: BoundTask) -> tuple[float, str]:
    """Bound the cost of efforts in the given time, or say why it is zero."""
    weights = task.lightest("effort", task.problem.robot.nu)
    if not weights.any():
        return 0.0, "nothing weighs efforts"
    if task.why_no_forces:
        return 0.0, f"efforts are not looked at: {task.why_no_forces}"
    from mbocp.bounds.efforts import least_squares  # CasADi, for those who need it

    windows = windows_of(task)
    if windows is None:
        return 0.0, "nothing bounds the speeds of joints; give limits.velocity"
    alpha = np.full(task.problem.robot.nv, np.inf)
    for u, at, factor in task.motors():
        alpha[at] = weights[u] / factor**2
    return least_squares(windows, alpha), "efforts may be zero for most of the time within these limits"
