"""Parameters of start and goal."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.exceptions import SolverError
from mbocp.formulation import Formulation
from mbocp.formulation.gains import tangents
from mbocp.formulation.layout import places
from mbocp.integrators import VELOCITY_TAU
from mbocp.lie import ConfigurationSpace
from mbocp.mechanisms.consistent_states import project_on_constraints
from mbocp.problem import Problem
from mbocp.problem.coordinates import COORDINATES
from mbocp.robot import Robot
from mbocp.sensitivity.change import POINTS, Change, ProblemNumbers, change_along

_SAME = 1e-9  # [rad, m]
_NEAR = 1e-4  # of projections: ends that solves have chosen are nearer


@dataclass(frozen=True, eq=False)
class OfState(ProblemNumbers):
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
class StartNumbers(OfState):
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

    def _basis(self, q: Array) -> Array:
        """Velocities are those that contacts allow: of others ends that solves choose say this or that."""
        has_contacts = self.problem.timeline.switches is not None
        return self.problem.free_at_end(q) if has_contacts and self.word == "goal.v" else super()._basis(q)

    def change(self) -> Change:
        """Of numbers of the end."""
        formulation, problem, q = self.formulation, self.problem, self.problem.goal.q
        turns = self._turns_of_rows() if self.is_configuration else {}
        if turns is None or not _is_plain(problem):
            return self._formulate_anew(q)
        found, space, moves = self._none, formulation.pieces.joints, self._moves(q)
        at = places(formulation.pieces.parameters.terminal)
        if self.is_configuration:
            z = space.coordinates(np.asarray(q)[None])[0]
            found.rho_terminal[:, at["q"]] = moves @ space.tangents(z[None])[0].T
        else:
            found.rho_terminal[:, at["rate"]] = moves
        for name, turn in turns.items():
            found.rho_terminal[:, at[name]] = turn
        return found

    def _turns_of_rows(self) -> dict[str, Array] | None:
        r"""Derivatives of the rows of the end condition in a configuration, where they are known.

        Rows of single joints stay. Those of all joints, D, are a basis of what the loops allow, whose
        Jacobian is J: along moves that these allow :math:`(D^T)' = -J^+ J' D^T`.
        """
        problem, pieces = self.problem, self.formulation.pieces
        goal, robot, loose = problem.goal, problem.robot, problem.timeline.switches is not None
        if not (robot.nc or loose):
            return {}
        basis, turning = self._basis(goal.q), dict[str, Array]()
        is_held = problem.u_after is not None and goal.u.rule == "rest"
        is_known = not (loose or is_held or pieces.signature.ends)
        pairs = (("D_q", pieces.end.D_q, goal.q_active), ("D_rate", pieces.end.D_rate, goal.rate_active))
        for name, D, active in pairs:
            if len(D) and active.all():
                turning[name] = D.T
                is_known &= len(D) == basis.shape[1]
            else:
                is_known &= np.array_equal(D, np.eye(robot.nv)[active])
        if not (is_known and turning):
            return turning if is_known else None
        points = [robot.integrate(goal.q, at * move) for at, _ in POINTS for move in basis.T]
        jacobians = robot.closure_along([goal.q, *points])[1][:, list(robot.kept_rows)]
        moved = jacobians[1:].reshape(len(POINTS), -1, *jacobians.shape[1:])
        slopes = np.tensordot([weight for _, weight in POINTS], moved, 1)
        inverse = np.linalg.pinv(jacobians[0], rcond=RANK_TOLERANCE)
        along = {name: -inverse @ slopes @ allowed for name, allowed in turning.items()}
        # The transposed of D by rows is D by columns.
        return {name: basis @ turn.reshape(len(turn), -1) for name, turn in along.items()}

    @property
    def value(self) -> Array:
        """Configuration, velocity or momentum."""
        goal = self.problem.goal
        return np.array(goal.q if self.is_configuration else goal.value)

    def put(self, problem: Problem, value: Array) -> Problem:
        """With another one, nearest to what loops allow."""
        goal = problem.goal
        if self.is_configuration:
            return put_goal(problem, value)
        own = self.problem.goal  # of which q may be where the motion ends, while that of others is a guess
        q = own.q if own.q_is_reached else goal.q
        return replace(problem, goal=replace(goal, value=self._moves(q) @ value))


def check_rates_at_end(problem: Problem, q: Array) -> None:
    """Refuse velocities that contacts allow at the guess of an end, and not where the motion ends, at q.

    Solves with others choose their conditions there.

    Raises
    ------
    SolverError
    """
    guess, reached = (problem.free_at_end(at) for at in (problem.goal.q, q))
    if np.abs(guess @ guess.T - reached @ reached.T).max(initial=0.0) > _NEAR:
        raise SolverError(
            "sensitivities: goal.v: contacts allow other velocities where the motion ends than at the guess "
            "of that end; give all of goal.q"
        )


def put_goal(problem: Problem, q: Array) -> Problem:
    """With another configuration at the goal, nearest to what loops allow."""
    return replace(problem, goal=replace(problem.goal, q=nearest_configuration(problem.robot, q)))


def _tracks_goal(problem: Problem) -> bool:
    """Whether the running cost draws the motion to the goal, which it then moves with."""
    cost, goal, robot = problem.cost, problem.goal, problem.robot
    weighed = goal.q_active & (np.asarray(cost.tracking_weights)[: robot.nv] > 0.0)
    if cost.tracking == 0.0 or not weighed.any() or cost.target_q.ndim == 2:
        return False
    return bool(np.abs(robot.difference(cost.target_q, goal.q))[weighed].max() < _SAME)
