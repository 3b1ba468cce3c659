"""A first motion of a robot that nobody knows yet: a start, a goal near it, and a time that suffices.

It is chosen to be easy: the joints move by half a radian at most, away from their limits, so slowly that half
of what speeds and motors can is enough.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, dataclass, select_spanning_rows
from mbocp._text import list_names
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.exceptions import LoopNotClosed
from mbocp.robot import Robot
from mbocp.robot.joints import joint_kind
from mbocp.robot.large import make_working_data

_ANGLE = 0.5  # [rad] by which joints turn at most
_LENGTH = 0.2  # [m] by which they slide at most
_SHARE_OF_ROOM = 0.3  # of the way to the farther limit
_AT_LIMIT = 0.01  # of its range, within which an initial pose is at a limit and joints go one way only
_INSIDE = 0.05  # of its range, by which a start then keeps away
_SHARE_OF_SPEED = 0.5  # of the largest speed that the motion takes
_SHARE_OF_EFFORT = 0.7  # of the largest effort
_SHORTEST, _LONGEST = 1.0, 16.0  # [s]
_PEAK_SPEED = 1.5  # of the mean speed, in a motion with a cubic in time
_SAMPLES = 9  # poses at which efforts are looked at
_RESTING = 1e-6  # relative residual below which controls hold a pose
_MAX_NAMES = 6  # of joints that a note lists
_PLACE = 3  # first directions of a base that floats
_TRIES = 6  # of closing loops with shorter ways


@dataclass(frozen=True, eq=False)
class FirstMotion:
    """Numbers of a first motion.

    Parameters
    ----------
    q_start, q_goal : ndarray, shape (nq,)
        [m, rad, unit quaternion xyzw].
    asked : ndarray of bool, shape (nv,)
        Directions in which the goal says where the motion ends, and that it rests there.
    rests : bool
        Whether controls can bring all of the robot to rest and hold it; else what has no motor moves on.
    duration : float
        [s]
    is_limited : dict
        Whether limits of "effort", "velocity" and "position" can be kept, by key; no key where the robot has
        none.
    notes : tuple of str
        What a person should know.
    """

    q_start: Array
    q_goal: Array
    asked: BoolArray
    rests: bool
    duration: float
    is_limited: dict[str, bool]
    notes: tuple[str, ...] = ()


def first_motion(robot: Robot) -> FirstMotion:
    """Choose start, goal and duration for a robot.

    Parameters
    ----------
    robot : Robot
        With at least one control.
    """
    start, notes = _start(robot)
    rests = can_rest(robot, start)
    movable = np.ones(robot.nv, dtype=np.bool_) if rests else _with_motors(robot)
    if robot.nc and rests:
        motors = _with_motors(robot)
        movable = motors if motors.any() else movable
    movable &= ~_undriven_speeds(robot)
    moved = movable
    if not rests and _hovers(robot, start):
        rests, movable, moved = True, np.ones(robot.nv, dtype=np.bool_), np.arange(robot.nv) < _PLACE
    goal = _goal(robot, start, moved)
    away = np.abs(robot.difference(start, goal))
    motion = FirstMotion(start, goal, movable, rests, _by_speed(robot, away), {}, notes)
    return _within_limits(robot, motion)


def can_rest(robot: Robot, q: Array) -> bool:
    """Whether controls can push the robot in every direction that its constraints leave."""
    forces = forces_at(robot, q)
    return int(np.linalg.matrix_rank(forces, tol=_RESTING)) == robot.nv if not robot.drives else False


def _hovers(robot: Robot, q: Array) -> bool:
    """Whether controls carry a base that floats where it is, and so at every place."""
    if joint_kind(robot.model, 1).word != "floating" or robot.nc or robot.drives:
        return False
    held = find_holding_controls(robot, q)
    return held is not None and bool(held.any())


def find_holding_controls(robot: Robot, q: Array, acceleration: Array | None = None) -> Array | None:
    """Controls that hold a pose, or accelerate in it from rest; None if none do.

    Parameters
    ----------
    robot : Robot
    q : ndarray, shape (nq,)
    acceleration : ndarray, shape (nv,), optional
        [m/s^2, rad/s^2]; none by default.

    Returns
    -------
    u : ndarray, shape (nu,), optional
        The smallest ones [N, N m].
    """
    still = np.zeros(robot.nv)
    a = still if acceleration is None else acceleration
    wanted = np.array(pin.rnea(robot.model, make_working_data(robot.model), q, still, a))
    wanted = wanted - robot.force_elements(q, still)
    forces = forces_at(robot, q)
    found = np.linalg.lstsq(forces, wanted, rcond=None)[0]
    if np.abs(forces @ found - wanted).max(initial=0.0) > _RESTING * max(
        1.0, np.abs(wanted).max(initial=0.0)
    ):
        return None
    return np.array(found[: robot.nu])


def forces_at(robot: Robot, q: Array) -> Array:
    """Columns of generalised forces that controls, and then constraints, exert, shape (nv, nu + nc)."""
    return np.hstack([robot.actuation_matrix(q), robot.constraint_jacobian(q).T])


def _start(robot: Robot) -> tuple[Array, tuple[str, ...]]:
    """The initial pose, moved off limits, and what is to be told of that."""
    limits, q = robot.limits, np.array(robot.q0)
    lower, upper = limits.position_lower, limits.position_upper
    room = np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    outside = (q < lower + _AT_LIMIT * room) | (q > upper - _AT_LIMIT * room)
    if not outside.any():
        return q, ()
    nearest = np.clip(q, lower + _INSIDE * room, upper - _INSIDE * room)
    q[outside] = nearest[outside]
    try:
        found = np.array(robot.assemble(q))
    except LoopNotClosed:
        return np.array(robot.q0), ()
    names = list_names([robot.q_labels[i].name for i in np.flatnonzero(outside)], _MAX_NAMES)
    return found, (f"its initial pose is at limits of {names}, or beyond; the motion begins inside them",)


def _with_motors(robot: Robot) -> BoolArray:
    """Directions that controls move each by itself, on one or as one of several of a joint."""
    selection = robot.actuation.selection
    has: BoolArray = np.any(selection, axis=1)
    if has.sum() > selection.shape[1]:  # one moves several
        has[:] = False
        has[select_spanning_rows(selection, RANK_TOLERANCE)] = True
    has[list(robot.driven)] = True
    for joint in range(1, robot.model.njoints):
        j = robot.model.joints[joint]
        where = slice(j.idx_v, j.idx_v + j.nv)
        has[where] = bool(j.nv > 0 and has[where].all())
    return has


def _undriven_speeds(robot: Robot) -> BoolArray:
    """Directions whose velocity a control prescribes, and no end condition can hold."""
    none = np.zeros(robot.nv, dtype=np.bool_)
    for drive in robot.drives:
        none[list(drive.dofs)] = not drive.has_state
    return none


def _goal(robot: Robot, start: Array, movable: BoolArray) -> Array:
    """A pose near the start, nearer and nearer until loops close there."""
    step = np.where(movable, _displacement(robot, start), 0.0)
    for halving in range(_TRIES):
        q = np.array(robot.integrate(start, step / 2.0**halving))
        if not robot.nc:
            return q
        for fixed in (robot.joints_with(movable), []):
            try:
                found = np.array(robot.assemble(q, fixed=fixed))
            except LoopNotClosed:
                continue
            if _is_inside(robot, found):
                return found
    return np.array(start)


def _is_inside(robot: Robot, q: Array) -> bool:
    return bool(np.all((q >= robot.limits.position_lower) & (q <= robot.limits.position_upper)))


def _displacement(robot: Robot, start: Array) -> Array:
    """How far each direction goes, towards the farther limit [m, rad], shape (nv,)."""
    away = np.zeros(robot.nv)
    for joint in range(1, robot.model.njoints):
        kind, j = joint_kind(robot.model, joint), robot.model.joints[joint]
        if kind.word in ("floating", "translation"):
            away[j.idx_v : j.idx_v + 3] = (_LENGTH, 0.0, _LENGTH)
            continue
        for i, (_, unit) in enumerate(kind.v):
            most = _ANGLE if unit == "rad" else _LENGTH
            away[j.idx_v + i] = most
            if kind.is_vector and j.nq == j.nv:
                place = j.idx_q + i
                below = start[place] - robot.limits.position_lower[place]
                above = robot.limits.position_upper[place] - start[place]
                sign = 1.0 if above >= below else -1.0
                away[j.idx_v + i] = sign * min(most, _SHARE_OF_ROOM * max(above, below, 0.0))
    return away


def _by_speed(robot: Robot, away: Array) -> float:
    """A duration in which half the speed suffices [s]."""
    speed = _SHARE_OF_SPEED * robot.limits.velocity
    needed = [_PEAK_SPEED * d / v for d, v in zip(away, speed, strict=True) if 0.0 < v < np.inf]
    return _round(max([_SHORTEST, *needed]))


def _within_limits(robot: Robot, motion: FirstMotion) -> FirstMotion:
    """The motion with the limits that it keeps, slower if motors ask for it."""
    limits, notes = robot.limits, list(motion.notes)
    limited = dict[str, bool]()
    if np.isfinite([limits.position_lower, limits.position_upper]).any():
        limited["position"] = all(_is_inside(robot, q) for q in (motion.q_start, motion.q_goal))
        if not limited["position"]:
            notes.append("its initial pose is outside its own position limits")
    if np.isfinite(limits.velocity).any():
        limited["velocity"] = bool((limits.velocity > 0.0).all())
        if not limited["velocity"]:
            name = robot.v_labels[int(np.argmin(limits.velocity))].name
            notes.append(
                f"its file allows {name} no velocity at all, so the limits of velocities are left out"
            )
    if np.isfinite(limits.effort).any() and motion.rests:
        duration, words = _by_effort(robot, motion)
        limited["effort"] = not words
        notes += [words] if words else []
        motion = replace(motion, duration=duration)
    return replace(motion, is_limited=limited, notes=tuple(notes))


def _by_effort(robot: Robot, motion: FirstMotion) -> tuple[float, str]:
    """A duration in which the motors are strong enough [s], or why there is none."""
    duration = motion.duration
    while duration <= _LONGEST:
        ratio, worst = _load(robot, motion, duration)
        if ratio <= _SHARE_OF_EFFORT:
            return duration, ""
        duration = _round(1.5 * duration)
    still, worst = _load(robot, motion, math.inf)
    label = robot.u_labels[worst]
    has = f"{robot.limits.effort[worst]:.4g} {label.unit}"
    if still <= 1.0:
        return (
            motion.duration,
            f"the motor of {label.name} has {has}: hardly enough to move, so no limits of efforts",
        )
    return motion.duration, (
        f"holding its own weight takes more than the {has} that its file gives {label.name}, so the limits "
        "of efforts are left out"
    )


def _load(robot: Robot, motion: FirstMotion, duration: float) -> tuple[float, int]:
    """Largest control over its limit on a motion with a cubic in time, and which control; no limit: 0."""
    way = robot.difference(motion.q_start, motion.q_goal)
    worst, which = 0.0, 0
    for s in np.linspace(0.0, 1.0, _SAMPLES):
        q = np.array(robot.integrate(motion.q_start, way * (3.0 * s**2 - 2.0 * s**3)))
        bend = way * (6.0 - 12.0 * s) / duration**2 if math.isfinite(duration) else np.zeros(robot.nv)
        u = find_holding_controls(robot, q if not robot.nc or s in (0.0, 1.0) else motion.q_start, bend)
        if u is None:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            limit = np.where(u < 0.0, robot.limits.effort_lower, robot.limits.effort)
            ratio = np.where(np.abs(u) > 1e-9, np.abs(u / limit), 0.0)
        if ratio.max(initial=0.0) > worst:
            worst, which = float(ratio.max()), int(ratio.argmax())
    return worst, which


def _round(duration: float) -> float:
    """Up to half a second [s]."""
    return math.ceil(2.0 * duration - 1e-9) / 2.0
