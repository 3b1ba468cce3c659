"""What the node computes, without ROS: motions from where the robot is to a goal, and stops of them."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import mbocp
from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue, ProblemError, UnknownJoint
from mbocp.problem import Problem
from mbocp.solution.export_formats import sent_within
from mbocp.solution.joined import join_motions
from mbocp.solution.sent import Sent, motion_as_sent
from mbocp.solution.sent_checks import joint_excesses
from mbocp.solution.sent_states import Follower

_STOP_STEPS = 20
_STOP_TOLERANCE = 1e-6  # of the solver
_TRIES = 3  # of a stop, each with lower limits of jerk than the one before
_TOLERANCE = 1e-3  # relative, of a limit that is left between nodes
_ROOM = 2e-3  # relative, below a limit: what is left beyond it falls more slowly from try to try than asked


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion, and how it is sent.

    Attributes
    ----------
    solution : Solution
        What was solved for; of a stop, the motion that it begins on.
    sent : Sent
        Points from the start of the motion; controllers put polynomials between them.
    turns : ndarray, shape (joints,)
        Whole turns by which the robot counts joints that turn without end further than `sent` [rad].
    stops_from : float, optional
        Time from the start [s] until which a stop is the motion that it begins on.
    """

    solution: mbocp.Solution
    sent: Sent
    turns: Array
    stops_from: float | None = None

    @property
    def duration(self) -> float:
        """Time that it takes [s]."""
        return float(self.sent.curves.nodes[-1])

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
        sent, excesses = sent_within("ros2", solution, None, None, fit=True, load_robot=lambda: problem.robot)
        here = np.array([start[name] for name in sent.joints]) - sent.curves.q[0]
        sent = replace(sent, excesses=excesses)
        motion = Motion(solution, sent, 2.0 * np.pi * np.round(here / (2.0 * np.pi)))
        if motion.words:
            raise ProblemError(f"the motion leaves limits as it is sent: {motion.words}; give it more steps")
        return motion

    def stop(self, motion: Motion, at: float, time_limit: float | None = None) -> Motion:
        """Plan the stop of a motion: what is sent in its place, from the same start.

        Until the stop begins both are the same motion. If the stop leaves limits of jerk as it is sent, it is
        solved again with lower ones; `Motion.words` of what is returned tells what is left.

        Parameters
        ----------
        motion : Motion
            Of `plan`.
        at : float
            Time from its start [s]: the stop begins at the first of its nodes that is not before.
        time_limit : float, optional
            Longest time that it takes [s]; that of the planner by default.

        Raises
        ------
        MbocpError
            If the motion ends before, or the stop does not converge in time.
        """
        until = time.monotonic() + (self.time_limit if time_limit is None else time_limit)
        plan, sent = motion.solution, motion.sent
        nodes = sent.slower * (plan.t - plan.t[0])
        node = max(int(np.searchsorted(nodes, at)), 1)
        if node >= plan.num_steps:
            raise ProblemError(f"stop: the motion is over before {at:.3g} s")
        begin = {"q": plan.qs[node], "v": plan.vs[node], "a": plan.acceleration_at(node)}
        found: list[Sent] = []
        share = 1.0
        while len(found) < _TRIES and (left := until - time.monotonic()) > 0.0:
            try:
                problem = _stopping(plan.problem, share)
                stop = mbocp.stop(problem, steps=_STOP_STEPS, time_limit=left, **begin)
                if not stop.converged:
                    raise mbocp.NotConverged(stop)
            except mbocp.MbocpError:
                if not found:
                    raise
                break
            joined = motion_as_sent(join_motions(plan, node, stop), is_joined=True, like=sent)
            follower = Follower.of(joined, plan.problem.robot)
            of_efforts = joint_excesses(follower) if follower.has_controls else ()
            found.append(replace(joined, excesses=(*joined.excesses, *of_efforts)))
            if _worst(found[-1]) <= _TOLERANCE or found[-1].excesses[0].kind != "jerk":
                break
            # Slower stops have longer steps, whose jerks the moving mean leaves larger: so the square.
            share /= (1.0 + _worst(found[-1]) + _ROOM) ** 2
        if not found:
            raise ProblemError("stop: there is no time to solve for it")
        return replace(motion, sent=min(found, key=_worst), stops_from=float(nodes[node]))

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
    own = motion_as_sent(mbocp.solve(problem, check=True), interpolation="cubic").curves
    ends = [dict(zip(names, map(float, row), strict=True)) for row in own.q[[0, -1]]]
    motion = planner.plan(ends[0], {}, ends[1])
    planner.stop(motion, 0.5 * motion.duration)
    return planner


def _stopping(problem: Problem, share: float) -> Problem:
    """The problem with a share of its limits of jerk, for stops, which need not be optimal to many digits."""
    limits = problem.limits
    lowered = replace(limits, j_lower=share * limits.j_lower, j_upper=share * limits.j_upper)
    solver = replace(problem.solver, tolerance=max(problem.solver.tolerance, _STOP_TOLERANCE))
    return problem.with_(limits=lowered, solver=solver)


def _worst(sent: Sent) -> float:
    """The largest excess beyond a limit, relative."""
    return sent.excesses[0].ratio if sent.excesses else 0.0
