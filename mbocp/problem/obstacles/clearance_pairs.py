"""Which spheres may meet which obstacles, and each other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._warn import warn_caller
from mbocp.exceptions import ProblemError
from mbocp.problem._checks import ProblemWarning, check_frame
from mbocp.problem.limits import Bounds
from mbocp.problem.obstacles.clearance import Clearance, SelfCollision
from mbocp.robot import LinkSpheres, Robot
from mbocp.robot.collision.motion import ObstacleMotion
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.robot.collision.reach import reach
from mbocp.robot.collision.self_pairs import SelfPairs, self_pairs
from mbocp.robot.loading.readers.srdf import disabled_by

_STILL = "that stand still beside it"
_FAR = "that cannot reach it"
_FIXED = "that nothing moves out of its way"
_Sphere = tuple[int, int]  # link, and number of the sphere on it
_Ball = tuple[Array, float]  # centre [m] and radius [m]
_ASTRAY = 20.0  # times the reach: no room is as large


def clearance_of(
    robot: Robot, obstacles: Sequence[Obstacle], own: SelfCollision | None, limits: Bounds
) -> Clearance:
    """The clearance of a problem with obstacles, or whose links keep away from each other.

    Raises
    ------
    ProblemError
        If the robot has no collision geometry, or obstacles have the same name.
    UnknownFrame
        If the robot has no frame of an obstacle's `frame`.
    """
    _check_names(obstacles)
    balls = _balls(robot, limits, obstacles)
    reasons = {obstacle.name: _reasons_apart(robot, obstacle, balls) for obstacle in obstacles}
    kept = [(sphere, k) for k, told in enumerate(reasons.values()) for sphere in told if not told[sphere]]
    found = _self_pairs(robot, own, limits)
    between = () if found is None else found.spheres
    used = sorted({sphere for sphere, _ in kept}.union(*between))
    place = {sphere: n for n, sphere in enumerate(used)}
    return Clearance(
        robot=robot,
        obstacles=tuple(obstacles),
        spheres=tuple(used),
        pairs=tuple((place[sphere], k) for sphere, k in kept),
        sphere_pairs=tuple((place[a], place[b]) for a, b in between),
        own=own or SelfCollision(),
        left_out={name: dict(Counter(filter(None, told.values()))) for name, told in reasons.items()},
        self_pairs=found,
    )


def _balls(robot: Robot, limits: Bounds, obstacles: Sequence[Obstacle]) -> dict[_Sphere, _Ball]:
    """A ball for each sphere of the robot, which it never leaves."""
    links = robot.collision_spheres
    if not links:
        what = "obstacle" if obstacles else "self_collision"
        raise ProblemError(
            f"{what}: robot {robot.name!r} has no collision geometry: its URDF has no <collision>; add it, "
            "or give [[collision_sphere]] in its robot.toml"
        )
    return {
        (i, j): _reach(robot, link, j, limits) for i, link in enumerate(links) for j in range(len(link.radii))
    }


def _check_names(obstacles: Sequence[Obstacle]) -> None:
    for name, count in Counter(obstacle.name for obstacle in obstacles).items():
        if count > 1:
            raise ProblemError(f"obstacle {name!r}: there are several of this name; give each its own")


def _reasons_apart(robot: Robot, obstacle: Obstacle, balls: Mapping[_Sphere, _Ball]) -> dict[_Sphere, str]:
    """Why each sphere never meets the obstacle; empty where it may."""
    if obstacle.motion is not None:
        return {
            sphere: _never_met(robot.collision_spheres[sphere[0]].joint, obstacle, obstacle.motion, ball)
            for sphere, ball in balls.items()
        }
    frame = robot.model.frames[check_frame(f"obstacle {obstacle.name!r}", robot, obstacle.frame)]
    carrier, placed = int(frame.parentJoint), frame.placement * obstacle.placement
    reasons = {
        sphere: _never_meet(robot, robot.collision_spheres[sphere[0]].joint, carrier, obstacle, placed, ball)
        for sphere, ball in balls.items()
    }
    if _FAR in reasons.values() and all(reasons.values()):
        _warn_if_astray(robot, obstacle, placed, [*balls.values()])
    return reasons


def _reach(robot: Robot, link: LinkSpheres, number: int, limits: Bounds) -> _Ball:
    """Centre [m] and radius [m] of a ball that a sphere never leaves."""
    center = robot.model.frames[link.frame].placement.act(np.array(link.centers[number]))
    lower, upper = np.asarray(limits.q_lower), np.asarray(limits.q_upper)
    at, radius = reach(robot.model, link.joint, center, lower, upper)
    return at, radius + float(link.radii[number])


def _never_meet(
    robot: Robot, joint: int, carrier: int, obstacle: Obstacle, placed: pin.SE3, ball: _Ball
) -> str:
    """Why a sphere on a joint never meets an obstacle on another; empty if it may."""
    parents, (at, radius) = robot.model.parents, ball
    if joint == carrier:
        return _STILL
    if carrier and (parents[joint] == carrier or parents[carrier] == joint):
        return "on the link next to its own"
    if carrier or obstacle.movable or not np.isfinite(radius):
        return ""
    if obstacle.margin >= 0.0 and np.linalg.norm(at - placed.translation) < radius:
        return ""
    return _FAR if _distance(obstacle, placed, at, radius) > obstacle.margin else ""


def _never_met(joint: int, obstacle: Obstacle, motion: ObstacleMotion, ball: _Ball) -> str:
    """Why an obstacle never meets a sphere on its way; empty if it may."""
    if joint == 0:
        return _FIXED
    (at, radius), shape = ball, obstacle.geometry
    shape.computeLocalAABB()
    size = np.linalg.norm(obstacle.offset.act(np.array(shape.aabb_center))) + shape.aabb_radius
    is_known = np.isfinite(size) and np.isfinite(radius) and not obstacle.movable
    return _FAR if is_known and motion.distance_from(at) > size + radius + obstacle.margin else ""


def _warn_if_astray(robot: Robot, obstacle: Obstacle, placed: pin.SE3, reaches: Sequence[_Ball]) -> None:
    """Warn of an obstacle that is many times as far away as the robot reaches."""
    gap = min(_distance(obstacle, placed, *ball) for ball in reaches)
    size = max(radius for _, radius in reaches)
    if gap > _ASTRAY * size:
        warn_caller(
            f"obstacle {obstacle.name!r}: {gap:.4g} m beyond all that robot {robot.name!r} reaches, whose "
            f"parts stay within balls of {size:.3g} m; lengths are in metres",
            ProblemWarning,
        )


def _distance(obstacle: Obstacle, placed: pin.SE3, center: Array, radius: float) -> float:
    shape = coal.Transform3s(placed.rotation, placed.translation)
    ball = coal.Transform3s(np.eye(3), np.array(center))
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return float(coal.distance(obstacle.geometry, shape, coal.Sphere(float(radius)), ball, request, result))


def _self_pairs(robot: Robot, own: SelfCollision | None, limits: Bounds) -> SelfPairs | None:
    if own is None:
        return None
    disabled = {frozenset(pair) for pair in own.disabled}
    known = {link.link for link in robot.collision_spheres}
    for pair in own.disabled:
        for name in pair:
            if name not in known:
                raise ProblemError(
                    f"self_collision.disabled: {name!r} is no link with collision geometry; there are "
                    f"{', '.join(sorted(known))}"
                )
    if own.srdf is not None:
        disabled |= disabled_by(own.srdf)
    else:
        for source in robot.shapes:
            pairs = source.disabled()
            disabled |= {frozenset(source.prefix + link for link in pair) for pair in pairs}
    ranges = (limits.q_lower, limits.q_upper)
    return _found(robot, *(tuple(np.asarray(side).tolist()) for side in ranges), frozenset(disabled))


@lru_cache(maxsize=16)
def _found(
    robot: Robot, q_lower: tuple[float, ...], q_upper: tuple[float, ...], disabled: frozenset[frozenset[str]]
) -> SelfPairs:
    """The same for all problems of a robot within the same limits."""
    lower, upper = (
        np.where(np.isfinite(mine), mine, theirs)
        for mine, theirs in (
            (np.array(q_lower), np.asarray(robot.model.lowerPositionLimit)),
            (np.array(q_upper), np.asarray(robot.model.upperPositionLimit)),
        )
    )
    return self_pairs(robot.model, robot.collision_spheres, robot.q0, (lower, upper), disabled)
