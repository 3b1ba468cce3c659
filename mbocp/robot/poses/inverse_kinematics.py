"""Inverse kinematics: the configurations in which frames of a robot have the poses that are asked for.

From the start a damped Gauss-Newton method goes to a configuration that reaches all targets, with closed
loops as rows beside theirs. Where it does not arrive, or more branches are wanted (elbow up and down, wrist
flipped), it begins again at random configurations within the limits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from mbocp._arrays import Array, BoolArray, dataclass, frozen_array
from mbocp.exceptions import DimensionMismatch, InvalidValue, LoopNotClosed
from mbocp.robot.kinematics import difference
from mbocp.robot.loops.projection import assemble, components, violations
from mbocp.robot.mechanism import Mechanism
from mbocp.robot.poses.pose_rows import PoseErrors, PoseRows
from mbocp.robot.poses.pose_search import JointBounds, inside, joint_bounds, reach
from mbocp.robot.poses.target import FrameTarget, Targets, targets_of

LimitChoice: TypeAlias = bool | tuple[ArrayLike, ArrayLike]

_SAME = 1e-3  # [rad, m] between configurations that count as one
_MIN_PUSH = 1e-6  # [m, rad] by [rad, m] that a joint at a limit would gain beyond it
_CLOSURE_TOLERANCE = 1e-10  # [m, rad, m^2]
_RESTARTS = 40  # random configurations from which loops are closed
_MIN_TOLERANCE = 1e-12  # [m, rad] above round-off of some metres


@dataclass(frozen=True, eq=False)
class InverseKinematics:
    """What a search for configurations found.

    Attributes
    ----------
    targets : tuple of FrameTarget
        What was asked for.
    reached : bool
        Whether a configuration reaches all targets.
    q : ndarray, shape (nq,)
        The branch nearest to the start; where none was found, the best try.
    branches : ndarray, shape (n, nq)
        All distinct configurations that were found, the nearest to the start first.
    distances : ndarray, shape (n,)
        How far each is from the start: the Euclidean norm of the displacements of the joints [rad, m].
    position_errors : ndarray, shape (number of targets,)
        Distance of each frame's origin from its target at `q`, of the coordinates that are asked for [m].
    angle_errors : ndarray, shape (number of targets,)
        Angle between each frame and its orientation, or between axis and direction, at `q` [rad].
    at_limits : tuple of str
        Joints that are at a limit at `q`; out of reach, those that would have to go beyond it.
    attempts : int
        Number of starts from which the search began.
    """

    targets: tuple[FrameTarget, ...]
    reached: bool
    q: Array
    branches: Array
    distances: Array
    position_errors: Array
    angle_errors: Array
    at_limits: tuple[str, ...]
    attempts: int

    @property
    def position_error(self) -> float:
        """The largest of `position_errors` [m]."""
        return float(self.position_errors.max())

    @property
    def angle_error(self) -> float:
        """The largest of `angle_errors` [rad]."""
        return float(self.angle_errors.max())


@dataclass(frozen=True, eq=False)
class _Search:
    """One question, and what every attempt at it needs."""

    robot: Mechanism
    rows: PoseRows
    bounds: JointBounds
    lower: Array
    upper: Array
    start: Array
    tolerance: float
    held: BoolArray

    @classmethod
    def of(
        cls,
        robot: Mechanism,
        targets: Sequence[FrameTarget],
        within_limits: LimitChoice,
        start: Array,
        tolerance: float,
        fixed: Sequence[str],
    ) -> _Search:
        """For targets of a robot, with joints that stay where they are at the start."""
        rows, (lower, upper) = PoseRows(robot, targets), _limits(robot, within_limits)
        bounds = joint_bounds(robot.model, lower, upper, _leaders_and_followers(robot))
        return cls(robot, rows, bounds, lower, upper, start, tolerance, components(robot, fixed))

    def attempts(self, restarts: int, seed: int) -> Iterator[tuple[Array, bool]]:
        """What `attempt` finds from the start, and then from random configurations."""
        rng = np.random.default_rng(seed)
        for attempt in range(1 + restarts):
            q0 = self.start if attempt == 0 else self.bounds.random(self.robot.model, self.start, rng)
            yield self.attempt(self.hold_joints(self.bounds.clip(q0)))

    def attempt(self, q: Array) -> tuple[Array, bool]:
        """Configuration from one start, and whether it may count."""
        found, has_arrived = reach(self.rows, q, self.bounds, self.held, self.tolerance)
        if not has_arrived:
            return found, False
        found = self.hold_joints(self.bounds.unwind(found, self.start))
        is_closed = not self.robot.constraints or not violations(self.robot, found)
        return found, is_closed and inside(self.robot.model, found, self.lower, self.upper)

    def hold_joints(self, q: Array) -> Array:
        """The same, joints that are held where they are at the start."""
        out = np.array(q)
        for joint in self.robot.joints_with(self.held):
            where = self.robot.configuration_indices(joint)
            out[where] = self.start[where]
        return out

    def close_loops(self, q: Array) -> Array:
        """A best try with its loops closed to round-off."""
        if not self.robot.constraints:
            return q
        try:
            return np.array(assemble(self.robot, q, self.robot.joints_with(self.held)))
        except LoopNotClosed:
            return self.start

    def distance(self, q: Array) -> Array:
        """Displacement of each joint from the start."""
        return np.array(difference(self.robot.model, self.start, q))


def solve_inverse_kinematics(
    robot: Mechanism,
    targets: Targets,
    start: Array,
    fixed: Sequence[str],
    branches: int | None,
    restarts: int,
    seed: int,
    within_limits: LimitChoice,
    tolerance: float,
) -> InverseKinematics:
    """Search for configurations that reach targets, see `Robot.inverse_kinematics`."""
    wanted = targets_of(targets)
    _check(branches, restarts, tolerance)
    search = _Search.of(robot, wanted, within_limits, start, tolerance, fixed)
    found: list[Array] = []
    best, least, attempts = start, np.inf, 0
    for q, counts in search.attempts(restarts, seed):
        attempts += 1
        if counts and _is_new(search, q, found):
            found.append(q)
        elif not found:
            e = search.rows.residual(q)
            best, least = (q, float(e @ e)) if e @ e < least else (best, least)
        if len(found) == branches:
            break
    lengths = np.array([np.linalg.norm(search.distance(q)) for q in found])
    order = np.argsort(lengths, kind="stable")
    nearest = found[order[0]] if found else search.close_loops(best)
    errors: PoseErrors = search.rows.errors(nearest)
    return InverseKinematics(
        targets=wanted,
        reached=bool(found),
        q=frozen_array(nearest),
        branches=frozen_array(np.array(found).reshape(-1, robot.nq)[order]),
        distances=frozen_array(lengths[order]),
        position_errors=frozen_array(errors.positions),
        angle_errors=frozen_array(errors.angles),
        at_limits=_at_limits(search, nearest, is_reached=bool(found)),
        attempts=attempts,
    )


def close_anywhere(robot: Mechanism, start: Array, fixed: Sequence[str] = ()) -> Array | None:
    """A configuration within the limits that closes the loops, found from the start or from random ones.

    Parameters
    ----------
    robot : Mechanism
    start : ndarray, shape (nq,)
        Configuration where the search begins.
    fixed : sequence of str
        Joints that stay where they are.

    Returns
    -------
    q : ndarray, shape (nq,), or None
        None if no attempt closes the loops.
    """
    search = _Search.of(robot, (), True, start, _CLOSURE_TOLERANCE, fixed)
    return next((q for q, is_closed in search.attempts(_RESTARTS, seed=0) if is_closed), None)


def _at_limits(search: _Search, q: Array, *, is_reached: bool) -> tuple[str, ...]:
    robot, bounds = search.robot, search.bounds
    if is_reached:
        return tuple(robot.q_labels[i].name for i in bounds.joints_at_bounds(q))
    e = search.rows.residual(q)
    gradient = search.rows.jacobian(q).T @ e
    pushed = np.where(np.abs(gradient) > _MIN_PUSH * np.linalg.norm(e), gradient, 0.0)
    stopped = bounds.blocks(bounds.clip(q), pushed)
    return tuple(robot.v_labels[i].name for i in np.flatnonzero(stopped))


def _check(branches: int | None, restarts: int, tolerance: float) -> None:
    if branches is not None and branches < 1:
        raise InvalidValue("branches", branches, "a positive number, or None for all that the restarts find")
    if restarts < 0:
        raise InvalidValue("restarts", restarts, "a number of random starts, 0 or more")
    if not tolerance >= _MIN_TOLERANCE:
        raise InvalidValue("tolerance", tolerance, f"a number of at least {_MIN_TOLERANCE:g} [m, rad]")


def _limits(robot: Mechanism, choice: LimitChoice) -> tuple[Array, Array]:
    if choice is True:
        return robot.limits.position_lower, robot.limits.position_upper
    if choice is False:
        return np.full(robot.nq, -np.inf), np.full(robot.nq, np.inf)
    lower, upper = (np.asarray(side, dtype=np.float64) for side in choice)
    for side in (lower, upper):
        if side.shape != (robot.nq,):
            raise DimensionMismatch("within_limits", side.shape, (robot.nq,))
    if not (lower <= upper).all():
        i = int(np.argmin(lower <= upper))
        raise InvalidValue(f"within_limits[{i}]", [lower[i], upper[i]], "a lower below an upper limit")
    return lower, upper


def _leaders_and_followers(robot: Mechanism) -> frozenset[int]:
    """Joints whose whole turns count since others follow them."""
    leaders: Sequence[int] = robot.model.mimicked_joints
    return frozenset([*leaders, *(joint for c in robot.constraints for joint in c.joint_ids)])


def _is_new(search: _Search, q: Array, found: Sequence[Array]) -> bool:
    model = search.robot.model
    return all(np.abs(difference(model, old, q)).max(initial=0.0) > _SAME for old in found)
