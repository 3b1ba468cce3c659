"""Parameters of poses that frames have at the end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp.formulation import Formulation
from mbocp.formulation.layout import places
from mbocp.problem import Goal, Problem
from mbocp.robot import Robot
from mbocp.sensitivity.change import Change, ProblemNumbers, change_along
from mbocp.terms.frame_end import FrameEnd
from mbocp.terms.frame_goal import FrameGoal

_AT_POSE = 1e-12  # [m, rad]: differences of rows are right to 1e-9


@dataclass(frozen=True, eq=False)
class GoalOfFrame(ProblemNumbers):
    """Position or orientation of a frame at the end; orientations turn about the axes that are asked for."""

    @classmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """Those that the goal asks for, without tolerances."""
        for goal in {goal.name: goal for end in _frame_ends(formulation) for goal in end.goals}.values():
            if goal.target.coordinates.size:
                yield f"goal.frame.{goal.name}.position"
            if goal.target.orientation is not None:
                yield f"goal.frame.{goal.name}.orientation"

    @property
    def names(self) -> tuple[str, ...]:
        """Axes."""
        if self._is_position:
            return tuple("xyz"[i] for i in self._goal.target.coordinates)
        return ("x", "y", "z")

    @property
    def _is_position(self) -> bool:
        return self.word.endswith(".position")

    @property
    def _frame(self) -> str:
        return self.word.split(".", 2)[2].rpartition(".")[0]

    @property
    def _goal(self) -> FrameGoal:
        ends = _frame_ends(self.formulation)
        return next(goal for end in ends for goal in end.goals if goal.name == self._frame)

    def change(self) -> Change:
        """Of numbers of the end, which are linear in those of a pose; rows turn where closed loops move."""
        if self._takes_loops_along:
            return change_along(self.formulation, *(partial(self._move, k) for k in range(len(self.names))))
        found, goal = self._none, self._goal
        at = places(self.formulation.pieces.parameters.terminal)
        for end in _frame_ends(self.formulation):
            for k, move in enumerate(self._moves(goal)):
                for key, numbers in end.numbers_at(goal.name, move).items():
                    if numbers.any():  # of a position alone the rotation of zeros says nothing
                        found.rho_terminal[k, at[key]] = numbers
        return found

    @property
    def _takes_loops_along(self) -> bool:
        """Whether rows on velocities are those of closed loops at the pose, not where a motion has ended."""
        return bool(self.problem.robot.nc) and not self.problem.goal.q_is_reached

    def _move(self, k: int, size: float) -> Problem:
        move = size * np.eye(len(self.names))[k]
        if self._is_position:
            return self.put(self.problem, self.value + move)
        turned = pin.Quaternion(self._goal.target.rotation @ pin.exp3(move))
        return self.put(self.problem, turned.coeffs())

    def _moves(self, goal: FrameGoal) -> Iterator[Array]:
        """Derivatives of the pose's matrix."""
        if self._is_position:
            for i in goal.target.coordinates:
                yield np.eye(3)[i]
            return
        for axis in np.eye(3):
            move = np.zeros((4, 4))
            move[:3, :3] = goal.target.rotation @ np.cross(np.eye(3), axis)
            yield move

    @property
    def value(self) -> Array:
        """Coordinates that are asked for, or a quaternion xyzw."""
        target = self._goal.target
        if self._is_position:
            return np.array(target.position)[target.coordinates]
        return np.array(target.orientation)

    @property
    def tangent(self) -> Array:
        """Derivatives of the quaternion along turns about the axes, shape (4, 3)."""
        if self._is_position:
            return np.eye(len(self.names))
        *vector, w = self.value
        return 0.5 * np.vstack([w * np.eye(3) + pin.skew(np.array(vector)), -np.array(vector)])

    def put(self, problem: Problem, value: Array) -> Problem:
        """With another position, or the orientation nearest to a quaternion."""

        def move(goal: FrameGoal) -> FrameGoal:
            if goal.name != self._frame:
                return goal
            if not self._is_position:
                return replace(goal, target=replace(goal.target, orientation=value / np.linalg.norm(value)))
            position = np.array(goal.target.position)
            position[goal.target.coordinates] = value
            return replace(goal, target=replace(goal.target, position=position))

        goal = replace(problem.goal, frames=tuple(map(move, problem.goal.frames)))
        return replace(problem, goal=_with_loops_at(problem.robot, goal) if self._takes_loops_along else goal)


def _with_loops_at(robot: Robot, goal: Goal) -> Goal:
    """The goal with the nearest configuration at its poses, if there is one near."""
    fixed, targets = robot.joints_with(goal.q_active), [frame.target for frame in goal.poses]
    found = robot.inverse_kinematics(
        targets, goal.q, fixed=fixed, branches=1, restarts=0, tolerance=_AT_POSE, within_limits=False
    )
    return replace(goal, q=found.q) if found.reached else goal


def _frame_ends(formulation: Formulation) -> list[FrameEnd]:
    return [end for end in formulation.pieces.signature.ends if isinstance(end, FrameEnd)]
