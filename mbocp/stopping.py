"""`stop`: the motion from a state to rest that takes the least time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, frozen_array
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem import Problem
from mbocp.problem._checks import check_finite
from mbocp.problem.file.tables import write_tables
from mbocp.problem.problem import problem_from_tables
from mbocp.solution import Solution
from mbocp.solution.from_files import problem_from
from mbocp.solving import solve

_LEADING = ("follow", "line")  # paths that say where a frame goes, and so where it would have to stop
_SPREAD = 20.0  # how much shorter or longer than estimated a stop may be
_RESTING = 1e-9  # [rad/s, m/s]
_SMALL = 1e-3  # part of the cost of time that controls cost: less does not tell apart those that are free


def stop(
    motion: Solution | Problem | str | Path,
    at: float | None = None,
    *,
    q: Any = None,
    v: Any = None,
    a: Any = None,
    steps: int = 20,
    time_limit: float | None = None,
) -> Solution:
    """Bring a robot to rest in the least time, within all limits of a problem and clear of its obstacles.

    What the problem's motion is for is left out: goal, via points, cost, paths that are followed. Everything
    that holds all along it stays, and where jerks are limited the acceleration ends at zero, too.

    Parameters
    ----------
    motion : Solution, Problem, str or Path
        The motion that is given up, or its problem.
    at : float, optional
        Time of that motion [s]: at the last of its nodes up to it the stop begins.
    q, v : array_like, shapes (nq,), (nv,), optional
        Where the stop begins instead [m, rad, unit quaternion xyzw; m/s, rad/s].
    a : array_like, shape (nv,), optional
        Acceleration there, for limits of jerk [m/s^2, rad/s^2]; that of the motion, or zero.
    steps : int
        Number of steps of the stop.
    time_limit : float, optional
        Longest time of the solve [s].

    Returns
    -------
    Solution
        Converged or not: its `status` and `advice` tell.

    Raises
    ------
    ProblemError
        If the robot is at rest already, has phases or constraints that come and go, or if nothing limits how
        fast it may stop.
    InvalidValue, DimensionMismatch
        If `at` is no time of the motion, or a state does not fit the robot.
    """
    problem = problem_from(motion.problem if isinstance(motion, Solution) else motion)
    robot, given = problem.robot, {"q": q, "v": v, "a": a}
    sizes = {"q": robot.nq, "v": robot.nv, "a": robot.nv}
    said = {k: frozen_array(x, shape=(sizes[k],), name=k) for k, x in given.items() if x is not None}
    for name, value in said.items():
        check_finite(name, value)
    begin = _state(motion, at, said)
    return solve(_problem_of_stop(problem, begin, steps), time_limit=time_limit)


def _state(motion: Any, at: float | None, said: dict[str, Array]) -> dict[str, Array]:
    """Configuration, velocity and acceleration where the stop begins."""
    if at is None:
        if "q" not in said or "v" not in said:
            raise ProblemError("stop: say where it begins: `at` with a solution, or `q` and `v`")
        return said
    if not isinstance(motion, Solution):
        raise ProblemError("stop: `at` is a time of a solution; of a problem give `q` and `v`")
    if not motion.t[0] <= at <= motion.t[-1]:
        raise InvalidValue("at", at, f"a time from {motion.t[0]:g} to {motion.t[-1]:g} s")
    n = int(np.searchsorted(motion.t, at * (1.0 + 1e-12), side="right")) - 1
    return {
        "q": np.asarray(motion.qs[n]),
        "v": np.asarray(motion.vs[n]),
        "a": motion.acceleration_at(n),
        **said,
    }


def _problem_of_stop(problem: Problem, begin: dict[str, Array], steps: int) -> Problem:
    """The problem of a stop."""
    if problem.phase:
        raise ProblemError("stop: motions with phases stop where their contacts allow it; solve that problem")
    if problem.clearance is not None and problem.clearance.movers:
        raise ProblemError("stop: obstacle.motion counts the time from another start; solve that problem")
    longest, force = _estimate(problem, begin)
    has_jerks = bool(problem.widest_limits.finite("j").any())
    tables = write_tables(problem)
    for key in ("via", "guess", "terms", "cost", "goal", "parameter"):
        tables.pop(key, None)
    limits = {key: limit for key, limit in tables.pop("limits", {}).items() if key != "effort_rms"}
    paths = [path for path in tables.pop("path", []) if path["kind"] not in _LEADING]
    start = {key: begin[key].tolist() for key in ("q", "v", *(["a"] if has_jerks and "a" in begin else []))}
    duration = {"min": longest / _SPREAD, "max": longest * _SPREAD, "guess": 1.5 * longest}
    return problem_from_tables(
        {
            **tables,
            "horizon": {**tables["horizon"], "duration": duration, "steps": steps},
            "start": start,
            "goal": {"v": 0.0},
            "cost": {"time": 1.0, "effort": _SMALL / force**2},
            "limits": limits,
            **({"path": paths} if paths else {}),
        },
        robot=problem.robot,
        label="stop",
    )


def _estimate(problem: Problem, begin: dict[str, Array]) -> tuple[float, float]:
    """About how long it takes [s], momenta by forces and velocities by accelerations, and which force."""
    robot, limits, v = problem.robot, problem.widest_limits, np.abs(begin["v"])
    if v.max(initial=0.0) < _RESTING:
        raise ProblemError("stop: the robot is at rest already")
    momenta = np.abs(pin.crba(robot.model, robot.model.createData(), begin["q"]) @ begin["v"])
    matrix = np.abs(robot.actuation_matrix(begin["q"]))
    jerks = np.minimum(-limits.j_lower, limits.j_upper)
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = matrix * np.minimum(-limits.u_lower, limits.u_upper)
        forces = np.where(matrix > 0.0, shares, 0.0).sum(axis=1)  # what does not act may have no limit
        times = [momenta / forces, v / np.minimum(-limits.a_lower, limits.a_upper), 2.0 * np.sqrt(v / jerks)]
    longest = max(float(np.max(one[np.isfinite(one)], initial=0.0)) for one in times)
    if not longest > 0.0:
        raise ProblemError(
            "stop: nothing limits how fast the robot may stop; give limits.effort, limits.acceleration or "
            "limits.jerk"
        )
    used = np.linalg.norm([*forces[np.isfinite(forces)], momenta.max() / longest])
    return longest, float(used)
