"""Goals of frames: the configuration that reaches them, and which of their rows are conditions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, independent_rows, null_space
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.exceptions import ProblemError, UnreachableGoal, UnreachablePose
from mbocp.mechanisms.completion import complete_goal
from mbocp.mechanisms.consistent_states import CONSISTENCY_TOLERANCE
from mbocp.problem._checks import MAX_POSITION, MAX_RATE, check_frame, check_size
from mbocp.problem.goals.goal import Goal
from mbocp.problem.limits import Bounds, ask_millimetres, check_end_limits, with_question
from mbocp.robot import FrameTarget, InverseKinematics, Label, Robot
from mbocp.robot.kinematics import frame_jacobian
from mbocp.robot.loops.projection import violations
from mbocp.robot.poses.inverse_kinematics import LimitChoice
from mbocp.robot.poses.pose_rows import PoseErrors, PoseRows
from mbocp.robot.poses.pose_search import inside
from mbocp.terms.frame_end import FrameProjections
from mbocp.terms.frame_goal import FrameGoal

_NEAR_BRANCHES, _NEAR_RESTARTS = 3, 10  # where one is wanted: the nearest of a few is a good one
_BRANCHES, RESTARTS = 8, 24  # where several are wanted; an arm of six joints has eight
_MANY_RESTARTS, _MANY_WITH_LOOPS = 200, 30  # before a pose counts as out of reach; loops take longer
_ORDINARY_NV, _MIN_RESTARTS = 12, 8
_START_TOLERANCE = 1e-11  # [m, rad] the first step of the mechanics starts from here
_AT_POSE = 1e-8  # [m, rad] of a goal.q that is kept


def start_at(robot: Robot, targets: Sequence[FrameTarget], q: Array, written: BoolArray) -> Array:
    """Return the configuration near `q` in which frames have their poses, its loops closed.

    Parameters
    ----------
    robot : Robot
    targets : sequence of FrameTarget
    q : ndarray, shape (nq,)
        Where the search begins.
    written : ndarray of bool, shape (nv,)
        Velocity components of joints that stay where they are.

    Raises
    ------
    UnknownFrame
        If the robot does not have a frame.
    ProblemError
        If all joints are to stay.
    UnreachablePose
        If nothing within the limits of the robot reaches the poses, and nothing beyond them.
    """
    if written.all():
        raise ProblemError("start.frame: start.q gives every joint; leave out those that are to be found")
    for target in targets:
        check_frame("start.frame", robot, target.name)
        check_frame("start.frame", robot, target.relative_to)
    fixed = robot.joints_with(written)
    best: InverseKinematics | None = None
    limits = robot.limits
    has_limits = bool(np.isfinite(np.append(limits.position_lower, limits.position_upper)).any())
    for choice in (True, False) if has_limits else (False,):
        for branches, restarts in ((1, 0), (_NEAR_BRANCHES, _many(robot))):
            found = robot.inverse_kinematics(
                targets,
                q,
                fixed=fixed,
                branches=branches,
                restarts=_affordable(restarts, robot.nv),
                within_limits=choice,
                tolerance=_START_TOLERANCE,
            )
            if found.reached:
                return np.array(found.q)
        best = best or found
    raise _unreachable(robot, best or found, "start.frame", "the start")


def check_frames(robot: Robot, goal: Goal) -> None:
    """Refuse frames that the robot does not have, and numbers so large that digits would be lost."""
    for frame in goal.frames:
        check_frame("goal.frame", robot, frame.name)
        check_frame("goal.frame", robot, frame.target.relative_to)
        position = frame.target.position
        if position is not None:
            labels = [Label(f"{axis} of {frame.name}", "m") for axis in "xyz"]
            check_size("goal.frame", np.nan_to_num(position), labels, MAX_POSITION)
        rates = [Label(name, "m/s or rad/s") for name in frame.rate_labels]
        check_size("goal.frame", frame.rates, rates, MAX_RATE)


def with_configuration(robot: Robot, goal: Goal, q_start: Array, limits: Bounds) -> Goal:
    """Return the goal with a `q` at the poses of its frames: the nearest to the start of the first branches.

    Joints that the goal gives stay there. A `q` that is at the poses already is kept.

    Raises
    ------
    ProblemError
        If the goal gives every joint, and its frames are elsewhere there; or joints beyond their limits.
    UnreachablePose
        If nothing within the limits of the problem, or else of the robot, reaches an exact goal.
    UnreachableGoal
        If closed loops keep the robot from getting to any configuration that does.
    """
    if not goal.poses or goal.enforce == "none" or _is_kept(robot, goal, limits):
        return goal
    if goal.q_active.all() and goal.is_exact:
        raise _elsewhere(robot, goal)
    check_end_limits(robot, limits, goal)  # joints that it gives are searched for nowhere else
    q = _near(robot, goal, q_start, limits)
    if q is None:
        found = goal_branches(robot, goal, q_start, limits)
        if not found.reached and goal.is_exact:
            raise _unreachable(robot, found)
        q = _within_mode(robot, found, q_start) if found.reached else found.q
    return replace(goal, q=robot.balanced(q, goal.q_active) if robot.elastic else q)


def _near(robot: Robot, goal: Goal, q_start: Array, limits: Bounds) -> Array | None:
    """What a short search from the start finds, if the mechanism gets there: as a rule it does."""
    targets, start, fixed = _search_for(robot, goal, q_start)
    branches, restarts = (1, 0) if robot.nc else (_NEAR_BRANCHES, _affordable(_NEAR_RESTARTS, robot.nv))
    within = _limit_choices(limits)[0]
    found = robot.inverse_kinematics(
        targets, start, fixed=fixed, branches=branches, restarts=restarts, within_limits=within
    )
    if not found.reached:
        return None
    if not robot.nc:
        return found.q
    try:
        return complete_goal(robot, found.q, np.ones(robot.nv, dtype=np.bool_), q_start)
    except UnreachableGoal:
        return None


def goal_branches(
    robot: Robot, goal: Goal, q_start: Array, limits: Bounds, most: int = _BRANCHES, restarts: int = RESTARTS
) -> InverseKinematics:
    """Configurations at the poses of a goal's frames, `most` of them, the nearest to the start first.

    Within the position limits of the problem; where it has none, within the robot's if that is possible.
    """
    targets, start, fixed = _search_for(robot, goal, q_start)
    found: InverseKinematics | None = None
    for choice in _limit_choices(limits):
        for seed, (branches, tries) in enumerate(((most, restarts), (1, _many(robot)))):
            found_now = robot.inverse_kinematics(
                targets,
                start,
                fixed=fixed,
                branches=branches,
                restarts=_affordable(tries, robot.nv),
                within_limits=choice,
                seed=seed,
            )
            if found_now.reached:
                return found_now
        found = found or found_now
    return found if found is not None else found_now


def goal_near(robot: Robot, goal: Goal, q: Array, limits: Bounds) -> Array | None:
    """The configuration at the poses of a goal's frames to which one leads, within limits; None: to none."""
    targets, start, fixed = _search_for(robot, goal, q)
    within = _limit_choices(limits)[0]
    found = robot.inverse_kinematics(
        targets, start, fixed=fixed, branches=1, restarts=0, within_limits=within
    )
    return found.q if found.reached else None


def _many(robot: Robot) -> int:
    """Restarts before a pose counts as out of reach."""
    return _MANY_WITH_LOOPS if robot.nc else _MANY_RESTARTS


def _affordable(restarts: int, nv: int) -> int:
    """Fewer restarts for robots of many joints: each takes longer, and the first reaches what is in reach."""
    return max(_MIN_RESTARTS, round(restarts * min(1.0, (_ORDINARY_NV / max(nv, 1)) ** 2)))


def _search_for(robot: Robot, goal: Goal, q_start: Array) -> tuple[list[FrameTarget], Array, list[str]]:
    """Targets, where the search for them begins, and the joints that the goal gives."""
    start, fixed = np.array(q_start), []
    for joint in robot.joint_names:
        if goal.q_active[robot.velocity_indices(joint)].any():
            start[robot.configuration_indices(joint)] = goal.q[robot.configuration_indices(joint)]
            fixed.append(joint)
    return [frame.target for frame in goal.poses], start, fixed


def pose_errors(robot: Robot, goal: Goal, q: Array) -> PoseErrors:
    """Distance [m] and angle [rad] that are left to each pose of the goal at q."""
    return errors_of_poses(robot, goal.poses, q)


def errors_of_poses(robot: Robot, poses: Sequence[FrameGoal], q: Array) -> PoseErrors:
    """Distance [m] and angle [rad] that are left to each of these poses at q."""
    return _rows(robot, poses).errors(q)


def pose_jacobian(robot: Robot, goal: Goal) -> Array:
    """Derivative of the poses' rows without a tolerance at goal.q, which is at them, shape (rows, nv)."""
    frames = [frame for frame in goal.conditions if frame.has_pose]
    if not frames:
        return np.zeros((0, robot.nv))
    rows = _rows(robot, frames)
    rows.errors(goal.q)
    return rows.pose_jacobian(goal.q)


def rate_jacobian(robot: Robot, goal: Goal) -> Array:
    """Matrix from v to the velocities that are asked of frames, at goal.q, shape (rows, nv)."""
    rows = [np.zeros((0, robot.nv))]
    for frame in goal.conditions:
        whole = frame_jacobian(robot.model, goal.q, robot.frame_id(frame.name), pin.LOCAL_WORLD_ALIGNED)
        rows += [whole[:3]] * (frame.velocity is not None) + [whole[3:]] * (
            frame.angular_velocity is not None
        )
    return np.vstack(rows)


def frame_rates(goal: Goal) -> Array:
    """Velocities that are asked of frames, in the order of `rate_jacobian`."""
    return np.concatenate([np.zeros(0), *(frame.rates for frame in goal.conditions)])


def frame_projections(
    robot: Robot, goal: Goal, D_q: Array, rates: Array, reachable: Array, basis: Array
) -> FrameProjections:
    """Combinations of the rows of frames that the constraints and the goal's joints do not decide.

    Parameters
    ----------
    D_q : ndarray, shape (k, nv)
        Conditions on the configuration that there are beside.
    rates : ndarray, shape (l, m)
        Conditions on the velocity that there are beside, on the directions below.
    reachable : ndarray, shape (nv, m)
        Directions in which velocities can be.
    basis : ndarray, shape (nv, k)
        Directions in which the configuration can move.
    """
    if not goal.conditions:
        return FrameProjections(np.zeros((0, 0)), np.zeros((0, 0)))
    free = basis @ null_space(D_q @ basis, RANK_TOLERANCE)
    moving = reachable @ null_space(rates, RANK_TOLERANCE)
    return FrameProjections(
        independent_rows(pose_jacobian(robot, goal) @ free, RANK_TOLERANCE),
        independent_rows(rate_jacobian(robot, goal) @ moving, RANK_TOLERANCE),
    )


def _rows(robot: Robot, frames: Sequence[FrameGoal]) -> PoseRows:
    return PoseRows(robot, [frame.target for frame in frames])


def _limit_choices(limits: Bounds) -> list[LimitChoice]:
    return [(limits.q_lower, limits.q_upper)] if limits.finite("q").any() else [True, False]


def _is_kept(robot: Robot, goal: Goal, limits: Bounds) -> bool:
    """Whether goal.q is where the goal's frames are to be."""
    errors = pose_errors(robot, goal, goal.q)
    is_there = max(errors.positions.max(), errors.angles.max()) <= _AT_POSE
    is_closed = not robot.nc or not violations(robot, goal.q, CONSISTENCY_TOLERANCE)
    return is_there and is_closed and inside(robot.model, goal.q, limits.q_lower, limits.q_upper)


def _within_mode(robot: Robot, found: InverseKinematics, q_start: Array) -> Array:
    """The nearest branch to which the mechanism gets from the start with its loops closed."""
    if not robot.nc:
        return found.q
    refused: UnreachableGoal | None = None
    for q in found.branches:
        try:
            return complete_goal(robot, q, np.ones(robot.nv, dtype=np.bool_), q_start)
        except UnreachableGoal as error:
            refused = refused or error
    words = ", ".join(repr(target.name) for target in found.targets)
    raise UnreachableGoal(
        f"goal.frame: {len(found.branches)} configurations of robot {robot.name!r} bring {words} there, but "
        "none was reached from the start with its loops closed; give another pose, or another start"
    ) from refused


def _elsewhere(robot: Robot, goal: Goal) -> ProblemError:
    """What is wrong with poses beside a whole configuration."""
    errors = pose_errors(robot, goal, goal.q)
    names = ", ".join(frame.name for frame in goal.poses)
    distance, angle = 1e3 * float(errors.positions.max()), np.degrees(float(errors.angles.max()))
    return ProblemError(
        f"goal.frame: goal.q gives every joint, and with these {names} is not where it is asked to be, by "
        f"{distance:.3g} mm and {angle:.3g} deg; leave out goal.q, or the joints that are to be found"
    )


def _unreachable(
    robot: Robot, found: InverseKinematics, key: str = "goal.frame", what: str = "the goal"
) -> UnreachablePose:
    worst = int(np.argmax(found.position_errors + found.angle_errors))
    target = found.targets[worst]
    distance, angle = float(found.position_errors[worst]), float(found.angle_errors[worst])
    length = f"{1e3 * distance:.3g} mm" if distance < 1.0 else f"{distance:.3g} m"
    left = [length] * (target.coordinates.size > 0)
    left += [f"{np.degrees(angle):.3g} deg"] * (target.orientation is not None or target.axis is not None)
    at = found.at_limits
    why = (
        f"with {', '.join(at)} at {'their limits' if len(at) > 1 else 'its limit'}"
        if at
        else "with no joint at a limit"
    )
    advice = "widen these limits, " if at else ""
    turns = any(one.orientation is not None or one.axis is not None for one in found.targets)
    other = ", or leave a part of the pose free" if turns else " or the base"
    question = "" if target.position is None else ask_millimetres(target.position, distance)
    words = (
        f"{key}: out of reach of robot {robot.name!r}: {target.words}; the nearest of {found.attempts} "
        f"tries is {' and '.join(left)} away, {why}; {advice}move {what}{other}"
    )
    return UnreachablePose(
        robot.name, target.name, distance, angle, at, found.q, with_question(words, question)
    )
