"""Numbers of a programme that change while it is in use: goals, targets and weights, in place.

Functions stay those that were compiled, so that only what their signature does not depend on can change.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import DimensionMismatch, InvalidValue, ProblemError, suggest
from mbocp.formulation.base import Formulation
from mbocp.formulation.features.clock import TIME
from mbocp.formulation.features.feature import join
from mbocp.formulation.layout import places
from mbocp.formulation.parameter_layout import NUMBERS, path_parameters
from mbocp.formulation.steps import HAS_BEFORE
from mbocp.formulation.term_numbers import term_numbers
from mbocp.problem.coordinates import COORDINATES
from mbocp.robot import Robot
from mbocp.robot.nodes import between
from mbocp.terms.frame_end import FrameEnd
from mbocp.terms.frame_tolerance import FrameTolerance
from mbocp.terms.kinds import TerminalCost
from mbocp.terms.own_parts import collect_running_terms


class ParameterUpdates:
    """Parameters of a formulation's programme, to be changed in place.

    Attributes
    ----------
    theta, rho, rho_terminal : ndarray
        As in `StagewiseProgramme`, writable.
    """

    def __init__(self, formulation: Formulation) -> None:
        programme, pieces = formulation.programme, formulation.pieces
        self._problem, self._pieces, self._cost = formulation.problem, pieces, formulation.problem.cost
        self.theta, self.rho = np.array(programme.theta), np.array(programme.rho)
        self.rho_terminal = np.array(programme.rho_terminal)
        layout = pieces.parameters
        self._theta_at, self._stage_at = places(layout.theta), places(layout.stage)
        self._end_at = places(layout.terminal)
        self._rows = self.rho.reshape(programme.num_steps, -1)
        self._time = 0.0  # [s], since the problem's start
        targets = {"q": self._cost.target_q, "p": self._cost.target_p}
        self._targets = {
            key: rows for key, rows in targets.items() if rows.ndim == 2 and f"target_{key}" in self._stage_at
        }

    @property
    def belong_to_times(self) -> bool:
        """Whether `move_on` changes any."""
        return bool(self._targets) or TIME in self._stage_at

    def move_on(self, duration: float) -> bool:
        """Move what belongs to times by a time [s]: t of terms, targets that are trajectories.

        Targets are between their rows, and stay at the last one. Returns whether anything is new.
        """
        if not (duration > 0.0 and self.belong_to_times):
            return False
        self._time += duration
        if TIME in self._stage_at:
            self._rows[:, self._stage_at[TIME]] += duration
        last = len(self._rows) - 1
        at = np.minimum(np.arange(last + 1) + self._time / self._problem.dt, last)
        n, share = at.astype(int), at % 1.0
        for key, rows in self._targets.items():
            begin, end = rows[n], rows[np.minimum(n + 1, last)]
            if key == "q":
                self._set_target(key, between(self._problem.robot, begin, end, share))
            else:
                self._set_target(key, begin + share[:, None] * (end - begin))
        return True

    def turn(self, count: int, times: Array) -> None:
        """Begin with what a stage had that was so many later, and end with what those before it had.

        Targets, and whether a step has one before it, stay where they are; t of terms is that of `times`
        from now on [s], shape (N,).
        """
        for name, place in self._stage_at.items():
            if name not in ("target_q", "target_p", HAS_BEFORE, TIME):
                self._rows[:, place] = np.roll(self._rows[:, place], -count, axis=0)
        if TIME in self._stage_at:
            self._rows[:, self._stage_at[TIME]] = (self._time + times)[:, None]

    @property
    def places(self) -> Mapping[str, slice]:
        """Where numbers are that a step may change, empty where there are none.

        `goal_q` and `goal_rate` in those of the end; `target_q`, `target_p` and `has_before` in each stage's.
        """
        nowhere, end, stage = slice(0, 0), self._end_at, self._stage_at
        is_fixed = bool(self._problem.robot.nc)
        return {
            "goal_q": nowhere if is_fixed else end.get("q", nowhere),
            "goal_rate": end.get("rate", nowhere),
            "target_q": stage.get("target_q", nowhere),
            "target_p": stage.get("target_p", nowhere),
            "has_before": stage.get(HAS_BEFORE, nowhere),
        }

    def take_before(self) -> bool:
        """Tell the first step that it has one before it, which its state remembers; whether that is new."""
        place = self._stage_at.get(HAS_BEFORE)
        if place is None or self._rows[0, place] == 1.0:
            return False
        self._rows[0, place] = 1.0
        return True

    def set_goal(self, goal: Any) -> None:
        """Another goal at the end.

        Parameters
        ----------
        goal : array_like, shape (nq,), or mapping
            Configuration; or some of `q`, `v` or `p`, whichever the problem's goal has, and names of the
            goal's frames, each with a pose: a homogeneous matrix (4, 4), or a position (3,) [m].

        Raises
        ------
        ProblemError, DimensionMismatch
            If the compiled functions have no place for it.
        """
        asked = dict(goal) if isinstance(goal, Mapping) else {"q": goal}
        rate = self._problem.goal.rate
        frames = {frame.name for frame in self._problem.goal.frames}
        for key, value in asked.items():
            if key == "q":
                self._set_configuration(value)
            elif key == rate:
                self._end("rate", _numbers(f"goal.{key}", value, self._problem.robot.nv))
            elif key in frames:
                self._set_frame(key, value)
            else:
                known = ["q", rate, *sorted(frames)]
                raise ProblemError(f"goal: no {key!r} in that of the problem; {suggest(str(key), known)}")

    def set_target(self, target: Any) -> None:
        """Another target of the tracking cost.

        Parameters
        ----------
        target : array_like, shape (nq,) or (N, nq), or mapping
            Configurations; or some of `q` and `p`, each one row or N.
        """
        asked = dict(target) if isinstance(target, Mapping) else {"q": target}
        robot, N = self._problem.robot, len(self._rows)
        for key, size in (("q", robot.nq), ("p", robot.nv)):
            if key not in asked:
                continue
            name, rows = f"target_{key}", np.atleast_2d(np.asarray(asked.pop(key), dtype=np.float64))
            if name not in self._stage_at:
                raise ProblemError(f"target.{key}: the cost of the problem does not track it")
            if rows.shape not in ((1, size), (N, size)):
                raise DimensionMismatch(f"target.{key}", rows.shape, (N, size), f"or ({size},)")
            _check_finite(f"target.{key}", rows)
            self._targets.pop(key, None)  # this one is from now on, not at given times
            self._set_target(key, rows)
        if asked:
            raise ProblemError(f"target: no {next(iter(asked))!r}; give q and p")

    def _set_target(self, key: str, rows: Array) -> None:
        rows = self._pieces.joints.coordinates(rows) if key == "q" else rows
        self._rows[:, self._stage_at[f"target_{key}"]] = rows

    def set_weights(self, weights: Mapping[str, Any]) -> None:
        """Other weights of the cost, by their keys in `[cost]`.

        Raises
        ------
        ProblemError
            If a weight had been zero, so that the compiled functions have no term for it, or cannot be.
        """
        problem, signature = self._problem, self._pieces.signature
        cost = self._cost.with_weights(weights).on_controls(problem.robot.nu)
        cost.check_dimensions(problem.robot.nq, problem.robot.nv, problem.num_steps)
        given = term_numbers(problem, cost, self._pieces.joints)
        for term in collect_running_terms(given):
            if term not in signature.cost:
                raise ProblemError(
                    f"weights: the term {term.signature['term']!r} had no weight when the functions were "
                    "compiled; give it a small one in the problem"
                )
        for term in signature.cost:
            for name, value in term.numbers(given).items():
                if name in self._theta_at:
                    self.theta[self._theta_at[name]] = value
        if signature.terminal is not None:
            for name, value in TerminalCost.numbers(cost, problem.robot.nv).items():
                if name in self._end_at:
                    self.rho_terminal[self._end_at[name]] = value
        self._cost = cost

    def set_robot(self, robot: Robot) -> None:
        """The robot with another payload, or locked at other values of the same joints.

        Parameters
        ----------
        robot : Robot
            That of the problem but for what `Robot.varying` has.

        Raises
        ------
        ProblemError
            If the compiled functions are not its.
        """
        own = self._problem.robot
        if not isinstance(robot, Robot):
            raise TypeError(f"robot: got {robot!r}, expected a Robot")
        if robot.shape_fingerprint != own.shape_fingerprint:
            raise ProblemError(
                f"robot: {robot.name!r} differs from {own.name!r}, that of the problem, in more than numbers "
                "of payloads and values of locked joints; give the problem a payload on the same frame, "
                "whose mass may be zero"
            )
        if robot.fingerprint != own.fingerprint and NUMBERS not in self._theta_at:
            raise ProblemError('robot: payloads are constants of the functions in coordinates = "natural"')
        if NUMBERS in self._theta_at:
            self.theta[self._theta_at[NUMBERS]] = robot.varying_values
            self.rho_terminal[self._end_at[NUMBERS]] = robot.varying_values

    def _set_configuration(self, value: Any) -> None:
        problem, joints = self._problem, self._pieces.joints
        if problem.robot.nc or not COORDINATES[problem.coordinates].has_joint_states:
            raise ProblemError(
                f"goal.q: the end condition of robot {problem.robot.name!r} depends on where its loops or "
                "bodies are at the goal, and cannot move; make another horizon for another goal"
            )
        self._end("q", joints.coordinates(_numbers("goal.q", value, problem.robot.nq)[None])[0])

    def _set_frame(self, name: str, value: Any) -> None:
        pose = np.asarray(value, dtype=np.float64)
        if pose.shape not in ((3,), (4, 4)):
            raise DimensionMismatch(f"goal.{name}", pose.shape, (4, 4), "or (3,) for its position")
        _check_finite(f"goal.{name}", pose)
        ends = [end for end in self._pieces.signature.ends if isinstance(end, FrameEnd)]
        at_end = join(end.numbers_at(name, pose) for end in ends)
        along = {
            path_parameters(k, key): numbers
            for k, one in enumerate(self._problem.inequalities)
            if isinstance(one, FrameTolerance) and one.goal.name == name
            for key, numbers in one.term.shape.numbers_at(name, pose).items()
        }
        if not (at_end or along):
            raise ProblemError(f"goal.{name}: the goal of the problem asks for none of this in its pose")
        for key, numbers in at_end.items():
            self._end(key, numbers)
        for key, numbers in along.items():
            self.theta[self._theta_at[key]] = numbers

    def _end(self, name: str, value: Array) -> None:
        self.rho_terminal[self._end_at[name]] = value


def _numbers(name: str, value: Any, size: int) -> Array:
    numbers = np.asarray(value, dtype=np.float64)
    if numbers.shape != (size,):
        raise DimensionMismatch(name, numbers.shape, (size,))
    _check_finite(name, numbers)
    return numbers


def _check_finite(name: str, numbers: Array) -> None:
    if not np.isfinite(numbers).all():
        raise InvalidValue(name, numbers.tolist(), "finite numbers")
