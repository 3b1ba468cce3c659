"""What the node computes, without ROS: motions from where the robot is to a goal, and stops of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import mbocp
from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue, ProblemError, UnknownJoint
from mbocp.problem import Problem
from mbocp.solution.export_formats import prepare_within
from mbocp.solution.sent import Sent, compute_motion_sent
from mbocp.solution.sent_states import Follower

_TOLERANCE = 1e-3  # relative, of a limit that is left between nodes


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion, and how it is sent.

    Attributes
    ----------
    solution : Solution
        What was solved for.
    sent : Sent
        Points from the start of the motion; controllers put polynomials between them.
    turns : ndarray, shape (joints,)
        Whole turns by which the robot counts joints that turn without end further than `sent` [rad].
    stopped : Motion, optional
        Of a stop: the motion that it begins on.
    begin : float
        Of a stop: its time on that motion [s].
    """

    solution: mbocp.Solution
    sent: Sent
    turns: Array
    stopped: Motion | None = None
    begin: float = 0.0

    @property
    def duration(self) -> float:
        """Time that it takes, with what is before a stop [s]."""
        return self.begin + float(self.sent.curves.nodes[-1])

    @property
    def words(self) -> str:
        """Limits that it leaves as it is sent, of joints by more than a thousandth; "" if it keeps all."""
        left = (one for one in self.sent.excesses if one.kind == "path" or one.ratio > _TOLERANCE)
        return "; ".join(f"{excess.name}: {excess.words}" for excess in left)


@dataclass(frozen=True, eq=False)
class Planner:
    """Motions of a robot within the limits of a problem, from rest to rest; `load_planner` makes one.

    Attributes
    ----------
    problem : Problem
        Its start and goal are replaced; all else holds for each motion.
    time_limit : float
        Longest time of a solve [s].
    rest : float
        Speed below which a joint counts as at rest [rad/s, m/s].
    """

    problem: Problem
    time_limit: float = 10.0
    rest: float = 0.01

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in the order of their velocities."""
        return tuple(label.name for label in self.problem.robot.v_labels)

    def plan(self, q: Mapping[str, float], v: Mapping[str, float], goal: Mapping[str, float]) -> Motion:
        """Plan a motion to a goal.

        Parameters
        ----------
        q, v : mapping of str to float
            Position [rad, m] and velocity [rad/s, m/s] of each joint now. Other names may be among them;
            joints without a velocity are at rest.
        goal : mapping of str to float
            Positions at the end [rad, m]; joints that are not named come back to where they are.

        Raises
        ------
        MbocpError
            If a joint is not known, its position is missing or outside the limits, the robot moves, or there
            is no motion that keeps the limits as it is sent.
        """
        start = self._start(q, v)
        for name in goal:
            if name not in self.joints:
                raise UnknownJoint(name, self.problem.robot.name, self.joints)
        document = self.problem.document
        ends = {"start": {"q": self._wrap(start)}, "goal": {"q": self._wrap({**start, **goal}), "v": 0}}
        problem = Problem.of(
            replace(document, tables={**document.tables, **ends}, values={}), before=self.problem
        )
        solution = mbocp.solve(problem, check=True, time_limit=self.time_limit)
        motion = self._prepare(solution, start)
        if motion.words:
            raise ProblemError(f"the motion leaves limits as it is sent: {motion.words}; give it more steps")
        return motion

    def _prepare(
        self, solution: mbocp.Solution, start: Mapping[str, float], interpolation: str | None = None
    ) -> Motion:
        """A motion as it is sent, from where the robot counts its joints to be [rad, m]."""
        sent, excesses = prepare_within(
            "ros2", solution, None, interpolation, fit=True, load_robot=lambda: solution.problem.robot
        )
        here = np.array([start[name] for name in sent.joints]) - sent.curves.q[0]
        turns = 2.0 * np.pi * np.round(here / (2.0 * np.pi))
        return Motion(solution, replace(sent, excesses=excesses), turns)

    def stop(self, motion: Motion, at: float, time_limit: float | None = None) -> Motion:
        """Plan the stop of a motion, which begins where this is as it is sent.

        Limits that it leaves as it is sent are told by `Motion.words` of what is returned.

        Parameters
        ----------
        motion : Motion
            Of `plan`.
        at : float
            Time from its start [s] at which the stop begins.
        time_limit : float, optional
            Longest time of the solve [s]; that of the planner by default.

        Raises
        ------
        MbocpError
            If the motion ends before, or the stop does not converge in time.
        """
        curves, problem = motion.sent.curves, motion.solution.problem
        if at >= motion.duration:
            raise ProblemError(f"stop: the motion is over before {at:.3g} s")
        positions, velocities, accelerations, _ = curves.at(np.array([at]))
        follower, limits = Follower.of(motion.sent, problem.robot), problem.limits
        (q,), (v,) = follower.states(np.array([at]), positions, velocities)
        a = follower.rates(accelerations)[0]
        begin = {
            "v": np.clip(v, limits.v_lower, limits.v_upper),
            "a": np.clip(a, limits.a_lower, limits.a_upper),
        }
        longest = self.time_limit if time_limit is None else time_limit
        found = mbocp.stop(problem, q=q, **begin, time_limit=longest)
        if not found.converged:
            raise mbocp.NotConverged(found)
        here = dict(zip(motion.sent.joints, (positions[0] + motion.turns).tolist(), strict=True))
        stop = self._prepare(found, here, curves.interpolation)
        return replace(stop, stopped=motion, begin=at)

    def _wrap(self, q: Mapping[str, float]) -> dict[str, float]:
        """Positions without whole turns of joints that turn without end [rad, m]."""
        counted = {label.name for label in self.problem.robot.q_labels}
        return {name: x if name in counted else math.remainder(x, math.tau) for name, x in q.items()}

    def _start(self, q: Mapping[str, float], v: Mapping[str, float]) -> dict[str, float]:
        """Positions of the joints, where they are at rest [rad, m]."""
        for name in self.joints:
            if name not in q:
                raise InvalidValue(f"start.q.{name}", "nothing", "the position of each joint")
            if not abs(v.get(name, 0.0)) <= self.rest:
                raise ProblemError(
                    f"start.v: {name} moves by {v[name]:.3g}; motions begin at rest, below {self.rest:g}"
                )
        return {name: q[name] for name in self.joints}


def load_planner(path: str | Path, time_limit: float = 10.0, rest: float = 0.01) -> Planner:
    """Load a problem, and solve its own motion and a stop of it, so that all functions are there.

    Where the file says nothing of positions, those of the robot are limits.

    Parameters
    ----------
    path : str or Path
        Of the problem file.
    time_limit : float
        Longest time of a solve [s].
    rest : float
        Speed below which a joint counts as at rest [rad/s, m/s].

    Raises
    ------
    MbocpError
        If the robot has joints of several velocities, or the problem phases; if nothing limits how fast the
        robot may stop, or a solve does not converge.
    """
    problem = mbocp.load_problem(path)
    limits = problem.limits
    if not (np.isfinite(limits.q_lower).any() or np.isfinite(limits.q_upper).any()):
        problem = problem.with_(limits={"position": True})
    names = problem.robot.joint_names
    planner = Planner(problem, time_limit, rest)
    if planner.joints != names:
        raise ProblemError("robot: joints of several velocities, as of floating bases, are not supported")
    if problem.phase:
        raise ProblemError("phase: motions with phases cannot be stopped, and are not supported")
    own = compute_motion_sent(mbocp.solve(problem, check=True), interpolation="cubic").curves
    ends = [dict(zip(names, map(float, row), strict=True)) for row in own.q[[0, -1]]]
    motion = planner.plan(ends[0], {}, ends[1])
    planner.stop(motion, 0.5 * motion.duration)
    return planner
