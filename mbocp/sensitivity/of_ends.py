"""Parameters of start and goal."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._dataclass import dataclass
from mbocp.formulation import Formulation
from mbocp.formulation.gains import tangents
from mbocp.formulation.layout import places
from mbocp.integrators import VELOCITY_TAU
from mbocp.lie import ConfigurationSpace
from mbocp.mechanisms.consistent_states import project_on_constraints
from mbocp.problem import Problem
from mbocp.problem.coordinates import COORDINATES
from mbocp.robot import Robot
from mbocp.sensitivity.change import Change, change_along
from mbocp.sensitivity.parameter import Parameter
from mbocp.terms.frame_end import FrameEnd
from mbocp.terms.frame_goal import FrameGoal

_SAME = 1e-9  # [rad, m]


@dataclass(frozen=True, eq=False)
class OfState(Parameter):
    """Configurations, and velocities or momenta; configurations move in the tangent space."""

    @property
    def is_configuration(self) -> bool:
        """Whether it is one."""
        return self.word.endswith(".q")

    @property
    def names(self) -> tuple[str, ...]:
        """Tangent directions, or components."""
        robot = self.problem.robot
        labels = robot.p_labels if self.word.endswith(".p") else robot.v_labels
        return tuple(label.name for label in labels)

    @property
    def tangent(self) -> Array:
        """Derivatives of a configuration along the tangent, shape (nq, nv)."""
        if not self.is_configuration:
            return np.eye(len(self.names))
        return ConfigurationSpace(self.problem.robot.model).tangents(self.value[None])[0]

    def _basis(self, q: Array) -> Array:
        """Directions in which numbers may move, shape (nv, any), orthonormal: those that loops allow."""
        if self.word.endswith(".p") or not self.problem.robot.nc:
            return np.eye(self.problem.robot.nv)
        return self.problem.free_at_end(q)

    def _moves(self, q: Array) -> Array:
        """How all move with each of the numbers, a row each: as far as loops allow it."""
        basis = self._basis(q)
        return basis @ basis.T

    def _formulate_anew(self, q: Array) -> Change:
        """Changes where functions do not say what they make of the numbers; q closes the loops."""
        basis = self._basis(q)

        def move_by(move: Array, size: float) -> Problem:
            if self.is_configuration:
                return self.put(self.problem, self.problem.robot.integrate(self.value, size * move))
            return self.put(self.problem, self.value + size * move)

        return change_along(self.formulation, *(partial(move_by, move) for move in basis.T)).along(basis)


def nearest_configuration(robot: Robot, q: Array) -> Array:
    """That nearest to some numbers, with its loops closed."""
    q = pin.normalize(robot.model, np.array(q, dtype=np.float64))
    return project_on_constraints(robot, q, np.arange(robot.nv)) if robot.nc else q


def _is_plain(problem: Problem) -> bool:
    """Whether states are (q, v) of joints, all of them unknowns."""
    return COORDINATES[problem.coordinates].has_joint_states and not problem.robot.drives


def _begins_with_a_chord(problem: Problem) -> bool:
    """Whether the first velocity is not the given one, but fits the first step."""
    has_ties = problem.robot.nc or not COORDINATES[problem.coordinates].has_joint_states
    return VELOCITY_TAU.get(problem.scheme) == 0.0 and bool(has_ties)


def _is_held_at_start(problem: Problem) -> bool:
    """Whether controls lead from those that hold the robot at rest."""
    return problem.u_before is not None and problem.u_start.rule == "rest"


def has_chord(problem: Problem) -> bool:
    """Whether the given state depends on the length of the first step."""
    return _begins_with_a_chord(problem) and bool(np.any(problem.v_start))


@dataclass(frozen=True, eq=False)
class Start(OfState):
    """Configuration or velocity at the start."""

    @classmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """Both, unless the start is found with the motion; drives leave no free choice of velocities.

        Neither is that of a robot held at rest, whose controls would leap with any velocity.
        """
        problem = formulation.problem
        if problem.start_free is not None or problem.goal.periodic is not None:
            return
        if not (problem.robot.drives and problem.v_start.any()):
            yield "start.q"
        if not (problem.robot.drives or _is_held_at_start(problem)):
            yield "start.v"

    def change(self) -> Change:
        """Of the given state alone."""
        formulation, problem = self.formulation, self.problem
        if _begins_with_a_chord(problem) or _is_held_at_start(problem) or not _is_plain(problem):
            return self._formulate_anew(problem.q_start)
        found, at, moves = self._none, formulation.layout, self._moves(problem.q_start)
        if self.is_configuration:
            found.start[:, : at.nw] = moves @ tangents(formulation, formulation.programme.x_start[None])[0].T
        else:
            found.start[:, at.ds] = moves
        return found

    @property
    def value(self) -> Array:
        """Configuration or velocity."""
        return self.problem.q_start if self.is_configuration else self.problem.v_start

    def put(self, problem: Problem, value: Array) -> Problem:
        """With another one, nearest to what loops allow."""
        if self.is_configuration:
            return replace(problem, q_start=nearest_configuration(problem.robot, value))
        return replace(problem, v_start=self._moves(problem.q_start) @ value)


@dataclass(frozen=True, eq=False)
class GoalOfJoints(OfState):
    """Configuration, and velocity or momentum, at the end."""

    @classmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """Those that the goal asks for; a velocity not where the robot is held at rest afterwards.

        Where loops are found, it would be one of the given loops, and not of those at the end.
        """
        problem = formulation.problem
        goal = problem.goal
        if goal.enforce == "none" or goal.periodic is not None:
            return
        if goal.q_active.any() and not _tracks_goal(problem):
            yield "goal.q"
        is_held = problem.u_after is not None and goal.u.rule == "rest"
        has_found_loops = bool(problem.robot.nc and problem.parameter)
        if goal.rate_active.any() and not (is_held or has_found_loops):
            yield f"goal.{goal.rate}"

    def change(self) -> Change:
        """Of numbers of the end."""
        formulation, problem = self.formulation, self.problem
        has_ties = problem.robot.nc or problem.timeline.switches is not None
        makes_projections = self.is_configuration and has_ties
        if makes_projections or not _is_plain(problem):
            return self._formulate_anew(problem.goal.q)
        found, space = self._none, formulation.pieces.joints
        at = places(formulation.pieces.parameters.terminal)
        if self.is_configuration:
            z = space.coordinates(np.asarray(problem.goal.q)[None])[0]
            found.rho_terminal[:, at["q"]] = space.tangents(z[None])[0].T
        else:
            found.rho_terminal[:, at["rate"]] = self._moves(problem.goal.q)
        return found

    @property
    def value(self) -> Array:
        """Configuration, velocity or momentum."""
        goal = self.problem.goal
        return np.array(goal.q if self.is_configuration else goal.value)

    def put(self, problem: Problem, value: Array) -> Problem:
        """With another one, nearest to what loops allow."""
        goal = problem.goal
        if self.is_configuration:
            return replace(problem, goal=replace(goal, q=nearest_configuration(problem.robot, value)))
        return replace(problem, goal=replace(goal, value=self._moves(goal.q) @ value))


def _tracks_goal(problem: Problem) -> bool:
    """Whether the running cost draws the motion to the goal, which it then moves with."""
    cost, goal, robot = problem.cost, problem.goal, problem.robot
    weighed = goal.q_active & (np.asarray(cost.tracking_weights)[: robot.nv] > 0.0)
    if cost.tracking == 0.0 or not weighed.any() or cost.target_q.ndim == 2:
        return False
    return bool(np.abs(robot.difference(cost.target_q, goal.q))[weighed].max() < _SAME)


@dataclass(frozen=True, eq=False)
class GoalOfFrame(Parameter):
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
        """Of numbers of the end, which are linear in those of a pose."""
        found, goal = self._none, self._goal
        at = places(self.formulation.pieces.parameters.terminal)
        for end in _frame_ends(self.formulation):
            for k, move in enumerate(self._moves(goal)):
                for key, numbers in end.numbers_at(goal.name, move).items():
                    if numbers.any():  # of a position alone the rotation of zeros says nothing
                        found.rho_terminal[k, at[key]] = numbers
        return found

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

        return replace(problem, goal=replace(problem.goal, frames=tuple(map(move, problem.goal.frames))))


def _frame_ends(formulation: Formulation) -> list[FrameEnd]:
    return [end for end in formulation.pieces.signature.ends if isinstance(end, FrameEnd)]
