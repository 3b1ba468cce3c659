"""Which spheres may meet which obstacles, and each other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._text import find_repeated, warn_caller
from mbocp.exceptions import ProblemError
from mbocp.problem._checks import ProblemWarning, check_frame
from mbocp.problem.limits import Bounds
from mbocp.problem.obstacles.clearance import Clearance, SelfCollision
from mbocp.robot import Robot
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.robot.collision.obstacle_motion import ObstacleMotion
from mbocp.robot.collision.self_pairs import SelfPairs, are_kept_out_in_vain, self_pairs
from mbocp.robot.kinematics import reach
from mbocp.robot.loading.readers.urdf_xml import pairs_disabled_by

_STILL = "that stand still beside it"
_FAR = "that cannot reach it"
_FIXED = "that nothing moves out of its way"
_Sphere = tuple[int, int]  # link, and number of the sphere on it
_Ball = tuple[Array, float]  # centre [m] and radius [m]
_ASTRAY = 20.0  # times the reach: no room is as large


def clearance_of(
    robot: Robot,
    obstacles: Sequence[Obstacle],
    own: SelfCollision | None,
    limits: Bounds,
    ends: Sequence[Array] = (),
) -> Clearance:
    """The clearance of a problem with obstacles, or whose links keep away from each other.

    Where spheres of links keep them out of its ends, which shapes do not, these decide.

    Raises
    ------
    ProblemError
        If the robot has no collision geometry, or obstacles have the same name.
    UnknownFrame
        If the robot has no frame of an obstacle's `frame`.
    """
    if repeated := find_repeated(obstacle.name for obstacle in obstacles):
        raise ProblemError(f"obstacle {repeated[0]!r}: there are several of this name; give each its own")
    for obstacle in obstacles:
        check_frame(f"obstacle {obstacle.name!r}", robot, obstacle.frame)
    balls = _balls(robot, limits, obstacles)
    pieces = [piece for obstacle in obstacles for piece in obstacle.pieces]
    apart = [_reasons_apart(robot, piece, balls) for piece in pieces]
    kept = [(sphere, k) for k, told in enumerate(apart) for sphere in told if not told[sphere]]
    rest = iter(apart)
    reasons = {each.name: _common([next(rest) for _ in each.pieces]) for each in obstacles}
    for obstacle in obstacles:
        _warn_if_astray(robot, obstacle, [*reasons[obstacle.name].values()], [*balls.values()])
    found = _self_pairs(robot, own, limits, ends)
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
            f"{what}: robot {robot.name!r} has no collision geometry: its file has none; add it, "
            "or give [[collision_sphere]] in its robot.toml"
        )
    lower, upper = np.asarray(limits.q_lower), np.asarray(limits.q_upper)
    found = dict[_Sphere, _Ball]()
    for i, link in enumerate(links):
        at, length = reach(robot.model, link.joint, np.zeros(3), lower, upper)
        for j, radius in enumerate(link.radii.tolist()):
            center = robot.model.frames[link.frame].placement.act(np.array(link.centers[j]))
            far = length + float(np.linalg.norm(center))
            found[i, j] = (at, far + radius) if link.joint else (center, radius)
    return found


def _reasons_apart(robot: Robot, piece: Obstacle, balls: Mapping[_Sphere, _Ball]) -> dict[_Sphere, str]:
    """Why each sphere never meets a piece of an obstacle; empty where it may."""
    if piece.motion is not None:
        return {
            sphere: _explain_never_met(robot.collision_spheres[sphere[0]].joint, piece, piece.motion, ball)
            for sphere, ball in balls.items()
        }
    frame = robot.model.frames[robot.frame_id(piece.frame)]
    carrier, placed = int(frame.parentJoint), frame.placement * piece.placement
    joints, gaps = [link.joint for link in robot.collision_spheres], _Gaps(piece, placed)
    far = _beyond_balls(piece, placed, balls) if piece.stands and not piece.movable else set()
    return {
        sphere: _FAR
        if sphere in far and joints[sphere[0]]
        else _never_meet(robot, joints[sphere[0]], carrier, piece, ball, gaps)
        for sphere, ball in balls.items()
    }


def _beyond_balls(piece: Obstacle, placed: pin.SE3, balls: Mapping[_Sphere, _Ball]) -> set[_Sphere]:
    """Spheres whose balls are far from the one around a piece: most, of most pieces of a large scene."""
    shape = piece.geometry
    shape.computeLocalAABB()
    gap = piece.margin + float(shape.aabb_radius)
    centers, radii = np.array([at for at, _ in balls.values()]), np.array([r for _, r in balls.values()])
    away = np.linalg.norm(centers - placed.act(np.array(shape.aabb_center)), axis=1)
    return {sphere for sphere, far in zip(balls, away > radii + gap, strict=True) if far}


def _common(reasons: Sequence[Mapping[_Sphere, str]]) -> dict[_Sphere, str]:
    """Why spheres never meet any piece of an obstacle; empty where they may meet one."""
    first, *others = reasons
    return {sphere: told if all(o[sphere] for o in others) else "" for sphere, told in first.items()}


def _never_meet(robot: Robot, joint: int, carrier: int, obstacle: Obstacle, ball: _Ball, gaps: _Gaps) -> str:
    """Why a sphere on a joint never meets an obstacle on another; empty if it may."""
    parents, (at, radius) = robot.model.parents, ball
    if joint == carrier:
        return _STILL
    if carrier and (parents[joint] == carrier or parents[carrier] == joint):
        return "on the link next to its own"
    if carrier or obstacle.movable or not np.isfinite(radius):
        return ""
    return _FAR if gaps.of(at, radius) > obstacle.margin else ""


def _explain_never_met(joint: int, obstacle: Obstacle, motion: ObstacleMotion, ball: _Ball) -> str:
    """Why an obstacle never meets a sphere on its way; empty if it may."""
    if joint == 0:
        return _FIXED
    (at, radius), shape = ball, obstacle.geometry
    shape.computeLocalAABB()
    size = np.linalg.norm(obstacle.offset.act(np.array(shape.aabb_center))) + shape.aabb_radius
    is_known = np.isfinite(size) and np.isfinite(radius) and not obstacle.movable
    return _FAR if is_known and motion.distance_from(at) > size + radius + obstacle.margin else ""


def _warn_if_astray(
    robot: Robot, obstacle: Obstacle, reasons: Sequence[str], reaches: Sequence[_Ball]
) -> None:
    """Warn of an obstacle that is many times as far away as the robot reaches; `reasons` of each sphere."""
    if obstacle.motion is not None or _FAR not in reasons or not all(reasons):
        return
    placed = robot.model.frames[robot.frame_id(obstacle.frame)].placement * obstacle.placement
    size = max(radius for _, radius in reaches)
    if np.linalg.norm(reaches[0][0] - placed.translation) <= _ASTRAY * size:
        return  # soon told of the many pieces of a large scene
    gaps = _Gaps(obstacle, placed)
    gap = min(gaps.of(*ball) for ball in reaches)
    if gap > _ASTRAY * size:
        warn_caller(
            f"obstacle {obstacle.name!r}: {gap:.4g} m beyond all that robot {robot.name!r} reaches, whose "
            f"parts stay within balls of {size:.3g} m; lengths are in metres",
            ProblemWarning,
        )


class _Gaps:
    """Distances of a placed obstacle from balls, most of which are around the same few points [m]."""

    def __init__(self, obstacle: Obstacle, placed: pin.SE3) -> None:
        self._shape = obstacle.geometry, coal.Transform3s(placed.rotation, placed.translation)
        self._middle = np.array(placed.translation)
        self._known: dict[bytes, tuple[float, float, float]] = {}  # by the point, see `_smallest`

    def of(self, center: Array, radius: float) -> float:
        """That of a ball, from the smallest one around the same point; 0 where the middle is in it."""
        key = center.tobytes()
        if key not in self._known or radius < self._known[key][0]:
            self._known[key] = self._smallest(center, radius)
        least, gap, away = self._known[key]
        return min(gap - (radius - least), 0.0 if away < radius else np.inf)

    def _smallest(self, center: Array, radius: float) -> tuple[float, float, float]:
        """Radius of a ball, its distance, and that of its centre from the obstacle's middle."""
        ball = coal.Transform3s(np.eye(3), np.array(center))
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        gap = float(coal.distance(*self._shape, coal.Sphere(float(radius)), ball, request, result))
        return radius, gap, float(np.linalg.norm(center - self._middle))


def _self_pairs(
    robot: Robot, own: SelfCollision | None, limits: Bounds, ends: Sequence[Array]
) -> SelfPairs | None:
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
        disabled |= pairs_disabled_by(own.srdf)
    else:
        for source in robot.shapes:
            pairs = source.disabled()
            disabled |= {frozenset(source.prefix + link for link in pair) for pair in pairs}
    lower, upper = (tuple(np.asarray(side).tolist()) for side in (limits.q_lower, limits.q_upper))
    found = _find_self_pairs(robot, lower, upper, frozenset(disabled))
    given = robot.model, robot.collision_spheres, robot.collision_model, found
    if not are_kept_out_in_vain(*given, ends, own.margin):
        return found
    places = tuple(tuple(np.asarray(q).tolist()) for q in ends)
    return _find_self_pairs(robot, lower, upper, frozenset(disabled), places)


@lru_cache(maxsize=16)
def _find_self_pairs(
    robot: Robot,
    q_lower: tuple[float, ...],
    q_upper: tuple[float, ...],
    disabled: frozenset[frozenset[str]],
    given: tuple[tuple[float, ...], ...] = (),
) -> SelfPairs:
    """The same for all problems of a robot within the same limits."""
    lower, upper = (
        np.where(np.isfinite(mine), mine, theirs)
        for mine, theirs in (
            (np.array(q_lower), robot.limits.position_lower),
            (np.array(q_upper), robot.limits.position_upper),
        )
    )
    own, poses = (robot.model, robot.collision_spheres, robot.q0), [np.array(q) for q in given]
    return self_pairs(*own, (lower, upper), robot.collision_model, disabled, poses)
