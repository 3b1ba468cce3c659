"""Completion of a start or goal with closed loops: joints that were not written follow from the others."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mbocp._arrays import Array, BoolArray
from mbocp._text import quote_all
from mbocp._tolerances import ARRIVAL_TOLERANCE
from mbocp.exceptions import InconsistentStart, LoopNotClosed, UnreachableGoal
from mbocp.mechanisms.closed_path import MAX_PATH_LENGTH, find_driving_joints, path_towards
from mbocp.mechanisms.consistent_states import (
    CONSISTENCY_TOLERANCE,
    check_position,
    distance,
    project_on_constraints,
    search,
)
from mbocp.robot import Robot
from mbocp.robot.loops.projection import follow, violations
from mbocp.robot.poses.inverse_kinematics import close_anywhere

_MAX_ATTEMPTS = 5  # the first from the given pose, the others from around it
_STRETCHED = 1e-2  # smallest singular value by its largest, of joints that follow, where they are in line
_SHARE = 0.5  # of the largest part from which loops and joints are named
_STRIDE = 0.1  # [rad, m]


def close_loops(
    robot: Robot, q: Array, active: BoolArray, *, assemble: bool, base: Array, key: str = "q"
) -> Array:
    """Return `q` with its loops closed.

    Parameters
    ----------
    q : ndarray, shape (nq,)
    active : ndarray of bool, shape (nv,)
        Velocity components of the joints that were written; the others are found.
    assemble : bool
        Whether a configuration that was written in full may move to the nearest one that closes the loops.
    base : ndarray, shape (nq,)
        Configuration that closes the loops, from which the search for the other joints starts.
    key : str
        What q is called in messages.

    Raises
    ------
    InconsistentStart, UnreachableGoal
        If the written joints are too far from `base` for a path in small steps.
    LoopNotClosed
        If no configuration with the written joints closes the loops, or none near one written in full.
    """
    if not violations(robot, q, CONSISTENCY_TOLERANCE):
        return q
    if active.all() or not active.any():
        return np.array(robot.assemble(q)) if assemble else q
    _check_distance(robot, base, q, active, key)
    reached = follow(robot, base, q, active)
    if distance(robot, reached, q, active) <= ARRIVAL_TOLERANCE:
        return reached
    written = robot.joints_with(active)
    try:
        return np.array(robot.assemble(q, fixed=written))
    except LoopNotClosed:
        found = close_anywhere(robot, q, written)
        if found is None:
            raise
        return found


def assemble_velocity(robot: Robot, q: Array, v: Array, active: BoolArray, *, assemble: bool) -> Array:
    """Return `v` along the constraints: the velocities that were not written follow from the others."""
    if not robot.nc or np.abs(robot.constraint_jacobian(q) @ v).max() <= CONSISTENCY_TOLERANCE:
        return v
    if active.all():
        return np.array(robot.assemble_velocity(q, v)) if assemble else v
    return np.array(robot.assemble_velocity(q, v, fixed=robot.joints_with(active)))


def complete_goal(robot: Robot, q: Array, active: BoolArray, q_start: Array) -> Array:
    """Return the goal with its free directions moved so that the constraints hold.

    The path from the start goes in small steps with the loops closed, so the goal is in the assembly mode of
    the start.

    Returns
    -------
    q : ndarray, shape (nq,)

    Raises
    ------
    InconsistentStart
        If no configuration with the wanted entries meets the constraints.
    UnreachableGoal
        If some do, but the search finds no path from the start to any of them.
    """
    if not robot.nc or not active.any():
        return q
    return np.array(_complete(robot, q.tobytes(), active.tobytes(), q_start.tobytes()))


@lru_cache(maxsize=64)  # copies of a problem check themselves again
def _complete(robot: Robot, q_bytes: bytes, active_bytes: bytes, start_bytes: bytes) -> Array:
    q, q_start = np.frombuffer(q_bytes), np.frombuffer(start_bytes)
    active = np.frombuffer(active_bytes, dtype=np.bool_)
    if active.all():
        check_position(robot, q, "goal.q")
    _check_distance(robot, q_start, q, active, "goal.q")
    if active.all():
        _check_mode(robot, q_start, q)
        return q
    size = distance(robot, q_start, q, active)
    path = path_towards(robot, q_start, q, active, np.linspace(0.0, 1.0, 2 + int(size / _STRIDE))[1:])
    reached = follow(robot, q_start, q, active) if path is None else path[-1]
    if distance(robot, reached, q, active) <= ARRIVAL_TOLERANCE:
        return reached
    bad = violations(robot, _close_anywhere(robot, q, np.flatnonzero(~active)), CONSISTENCY_TOLERANCE)
    short, written = _short(robot, reached, q, active), quote_all(robot.joints_with(active))
    stretched, stuck = _dead_end(robot, reached, active)
    if bad and stretched:
        raise InconsistentStart(
            f"goal.q: no configuration of robot {robot.name!r} has it with closed loops: on the way from the "
            f"start {quote_all(stretched)} {'is' if len(stretched) == 1 else 'are'} stretched out or folded, "
            f"and {quote_all(stuck)} can go no farther (nearest: {short}); give a nearer position of "
            f"{quote_all(stuck)}"
        )
    if bad:
        row, value, unit = bad[0]
        raise InconsistentStart(
            f"goal.q: violates constraint {row!r} of robot {robot.name!r} by {value:.3g} {unit}, wherever "
            f"the other joints are (nearest from the start: {short}); give another position of {written}"
        )
    found = search(robot, q_start, q, active)
    if found is None:
        raise UnreachableGoal(
            f"goal.q: out of reach in the start's assembly mode of robot {robot.name!r}: with its loops "
            f"closed it comes as near as {short}; give another position of {written}, or another start"
        )
    return found


def _dead_end(robot: Robot, q: Array, active: BoolArray) -> tuple[list[str], list[str]]:
    """Loops that are stretched out or folded at q, and the written joints that they stop; empty elsewhere.

    There the joints that follow cannot close the loops any more, along the left singular vector of their part
    of the Jacobian; what moves the rows along it is stopped.
    """
    G = robot.constraint_jacobian(q)
    left, sizes, _ = np.linalg.svd(G[:, ~active], full_matrices=False)
    if not sizes.size or sizes[-1] > _STRETCHED * sizes[0]:
        return [], []
    rows, pull = np.abs(left[:, -1]), np.where(active, np.abs(left[:, -1] @ G), 0.0)
    owners = [one.name for one in robot.constraints for _ in one.rows]
    owner = [owners[row] for row in robot.kept_rows]
    named = list(dict.fromkeys(owner[i] for i in np.flatnonzero(rows > _SHARE * rows.max())))
    stops = pull > _SHARE * pull.max(initial=0.0)
    return named, [n for n in robot.joint_names if stops[robot.velocity_indices(n)].any()]


def _close_anywhere(robot: Robot, q: Array, free: NDArray[np.intp]) -> Array:
    """Gauss-Newton on Phi(q) = 0 over the free directions, from several initial poses."""
    rng = np.random.default_rng(0)
    found = q
    for attempt in range(_MAX_ATTEMPTS):
        offset = np.zeros(robot.nv)
        # [m, rad] away from where Phi_q is singular
        offset[free] = 0.1 * attempt * rng.standard_normal(free.size)
        found = project_on_constraints(robot, robot.integrate(q, offset), free)
        if not violations(robot, found, CONSISTENCY_TOLERANCE):
            break
    return found


def _check_distance(robot: Robot, base: Array, q: Array, active: BoolArray, key: str) -> None:
    """Refuse a configuration that is too far away for a path in small steps."""
    away = np.where(active, np.abs(robot.difference(base, q)), 0.0)
    worst = int(away.argmax())
    if away[worst] > MAX_PATH_LENGTH:
        is_goal, label = key == "goal.q", robot.move_labels[worst]
        begin, unit = "the start" if is_goal else "the initial pose", label.unit
        raise (UnreachableGoal if is_goal else InconsistentStart)(
            f"{key}: {label.name} is {away[worst]:.3g} {unit} from {begin} of robot {robot.name!r}, and "
            f"ways with closed loops are followed over {MAX_PATH_LENGTH:g} {unit} at most; give a nearer "
            "position, an angle without its whole turns"
        )


def _check_mode(robot: Robot, q_start: Array, q: Array) -> None:
    """Refuse a goal that no path from the start reaches: straight, by the driving joints, or by a search."""
    everything = np.ones(robot.nv, dtype=np.bool_)
    nearest = q_start
    for wanted in (everything, find_driving_joints(robot, q_start)):
        reached = follow(robot, q_start, q, wanted)
        if distance(robot, reached, q, everything) <= ARRIVAL_TOLERANCE:
            return
        nearest = reached
    if search(robot, q_start, q, everything) is not None:
        return
    turned = _turn(robot, q_start, q)
    moved = np.flatnonzero(turned != q)
    if moved.size:
        reached = follow(robot, q_start, turned, everything)
        if distance(robot, reached, turned, everything) <= ARRIVAL_TOLERANCE:
            values = ", ".join(f"{robot.q_labels[i].name} = {turned[i]:.9g}" for i in moved)
            raise UnreachableGoal(
                f"goal.q: whole turns away from what robot {robot.name!r} reaches from the start with its "
                f"loops closed; the same pose with {values} is in reach"
            )
    raise UnreachableGoal(
        f"goal.q: in another assembly mode of robot {robot.name!r} than the start: no way was found on which "
        f"its loops ({quote_all(constraint.name for constraint in robot.constraints)}) stay closed (nearest: "
        f"{_short(robot, nearest, q, everything)}); leave out the joints that follow from the others, or "
        "start in the goal's mode"
    )


def _turn(robot: Robot, q_start: Array, q: Array) -> Array:
    """The same pose with each angle within half a turn of the start's."""
    turned = np.array(q)
    for name in robot.joint_names:
        at = robot.configuration_indices(name)
        if at.stop - at.start == 1 and robot.q_labels[at.start].unit == "rad":
            turned[at] -= 2.0 * np.pi * np.round((q[at] - q_start[at]) / (2.0 * np.pi))
    return turned


def _short(robot: Robot, q: Array, target: Array, active: BoolArray) -> str:
    missing = np.where(active, robot.difference(q, target), 0.0)
    worst = int(np.abs(missing).argmax())
    label = robot.move_labels[worst]
    return f"{label.name} {abs(missing[worst]):.3g} {label.unit} off"
