"""Obstacles and self-collision of a problem as one path constraint."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

import casadi as ca
import coal
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.mechanics import JointMechanics
from mbocp.problem.limits import Bounds
from mbocp.robot import Label, LinkSpheres, Robot
from mbocp.robot.collision.obstacle import SMOOTHING, Obstacle
from mbocp.robot.collision.reach import reach
from mbocp.robot.collision.self_pairs import SelfPairs, disabled_by, find_srdf, self_pairs
from mbocp.terms import ClearanceTerm, Point, ShapeOn, Span

__all__ = ["Clearance", "SelfCollision", "clearance_of", "with_larger_margin"]

P = TypeVar("P", bound="WithObstacles")

_STILL = "that stand still beside it"
_FAR = "that cannot reach it"
_TOLD = 20  # obstacles of which the summary speaks each


class WithObstacles(Protocol):
    """Fields of `mbocp.problem.Problem`, which imports this module."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    # fmt: off
    @property
    def obstacle(self) -> tuple[Obstacle, ...]: ...
    @property
    def self_collision(self) -> SelfCollision | bool | None: ...
    # fmt: on


@dataclass(frozen=True)
class SelfCollision:
    """That links keep away from each other.

    Attributes
    ----------
    margin : float
        Least distance of their spheres [m].
    disabled : tuple of (str, str)
        Pairs of links that need not.
    srdf : Path, optional
        Whose <disable_collisions> need not, either; by default one of the URDF's name beside it.
    """

    margin: float = 0.0
    disabled: tuple[tuple[str, str], ...] = ()
    srdf: Path | None = None


@dataclass(frozen=True, eq=False)
class Clearance:
    """Distances of spheres from obstacles and from each other, see `mbocp.problem.PathConstraint`.

    Attributes
    ----------
    robot : Robot
    obstacles : tuple of Obstacle
    spheres : tuple of (int, int)
        Link, by its place in `robot.collision_spheres`, and sphere of it, of all that take part.
    pairs : tuple of (int, int)
        Sphere, by its place in `spheres`, and obstacle.
    sphere_pairs : tuple of (int, int)
    self_margin : float
        Least distance of spheres from each other [m].
    left_out : mapping of str to mapping of str to int
        How many spheres of an obstacle, by its name, are left out for which reason.
    self_pairs : SelfPairs, optional
    """

    robot: Robot
    obstacles: tuple[Obstacle, ...]
    spheres: tuple[tuple[int, int], ...]
    pairs: tuple[tuple[int, int], ...]
    sphere_pairs: tuple[tuple[int, int], ...] = ()
    self_margin: float = 0.0
    left_out: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    self_pairs: SelfPairs | None = None

    name = "clearance"
    span = Span()

    @property
    def _links(self) -> tuple[LinkSpheres, ...]:
        return self.robot.collision_spheres

    @cached_property
    def term(self) -> ClearanceTerm:
        """Its structure, with its expression."""
        shapes = (ShapeOn(o.shape, self.robot.frame_id(o.frame)) for o in self.obstacles)
        frames = tuple(self._links[link].frame for link, _ in self.spheres)
        return ClearanceTerm(frames, tuple(shapes), self.pairs, self.sphere_pairs)

    def structure(self, rotations: str) -> ClearanceTerm:
        """The same in all coordinates of attitudes."""
        return self.term

    @property
    def rows(self) -> int:
        """Number of pairs."""
        return len(self.pairs) + len(self.sphere_pairs)

    @cached_property
    def labels(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        names = [f"{self._links[link].link}[{number}]" for link, number in self.spheres]
        words = [f"distance of {names[a]} from {self.obstacles[k].name}" for a, k in self.pairs]
        words += [f"distance of {names[a]} from {names[b]}" for a, b in self.sphere_pairs]
        return tuple(Label(word, "m") for word in words)

    @cached_property
    def lower(self) -> Array:
        """Least clearances, shape (rows,) [m]."""
        margins = [self.obstacles[k].margin for _, k in self.pairs]
        return np.array([*margins, *[self.self_margin] * len(self.sphere_pairs)])

    @cached_property
    def upper(self) -> Array:
        """None, shape (rows,)."""
        return np.full(self.rows, np.inf)

    @cached_property
    def _sizes(self) -> Array:
        """What is subtracted from distances of centres, shape (rows,) [m]."""
        radii = np.array([self._links[link].radii[number] for link, number in self.spheres])
        single = [radii[a] for a, _ in self.pairs]
        return np.array([*single, *(radii[a] + radii[b] for a, b in self.sphere_pairs)])

    @property
    def inner_bounds(self) -> tuple[Array, Array]:
        """Bounds of the expression: of distances of centres."""
        return self.lower + self._sizes, self.upper

    @cached_property
    def numbers(self) -> dict[str, Array]:
        """Parameters by name."""
        centers = [self._links[link].centers[number] for link, number in self.spheres]
        found = {"centers": np.concatenate([np.zeros(0), *centers])}
        for k, obstacle in enumerate(self.obstacles):
            placed = obstacle.placement
            found[f"{k}.lengths"] = np.asarray(obstacle.sizes)
            found[f"{k}.position"] = placed.translation
            found[f"{k}.rotation"] = placed.rotation.ravel(order="F")
            found[f"{k}.smoothing"] = np.array([obstacle.smoothing])
        return found | ({"smoothing": np.array([SMOOTHING])} if self.sphere_pairs else {})

    def numbers_in(self, rotations: str) -> dict[str, Array]:
        """The same where attitudes are in these coordinates."""
        return self.numbers

    def check_frames(self, robot: Robot) -> None:
        """Frames have been found before."""

    def values(self, robot: Robot, q: Array, v: Array) -> Array:
        """Clearances at one state, shape (rows,) [m]."""
        found: Array = self.values_along(robot, q[None], v[None], np.zeros((1, robot.nu)))[0]
        return found

    def values_along(self, robot: Robot, qs: Array, vs: Array, us: Array) -> Array:
        """Clearances at each of n states, shape (n, rows) [m], by the expression that solvers see."""
        found: Array = np.asarray(self._function(np.asarray(qs).T)).T - self._sizes
        return found

    @cached_property
    def _function(self) -> ca.Function:
        robot = self.robot
        q = ca.SX.sym("q", robot.nq)
        numbers = {name: ca.SX(ca.DM(np.asarray(value))) for name, value in self.numbers.items()}
        h = self.term.expression(Point(JointMechanics(robot), q, ca.SX.zeros(robot.nv)), numbers)
        return ca.Function("h", [q], ca.cse([ca.densify(h)]))

    def slopes(self, values: Array) -> Array:
        """Derivatives of the expression in the values."""
        return np.ones_like(values)

    def refusal(self, values: Array, where: str) -> str:
        """Why a state of these clearances is refused, of what is worst; `where`: "start" or "goal"."""
        row = int((values - self.lower).argmin())
        if row < len(self.pairs):
            sphere, k = self.pairs[row]
            subject, other = f"obstacle {self.obstacles[k].name!r}", "it"
        else:
            sphere, second = self.sphere_pairs[row - len(self.pairs)]
            subject, other = "self_collision", self._links[self.spheres[second][0]].link
        link, number = self.spheres[sphere]
        name, size = self._links[link].link, f"{1e3 * abs(values[row]):.4g} mm"
        how = f"{size} inside {other}" if values[row] < 0.0 else f"{size} from {other}"
        margin = f", and the margin is {1e3 * self.lower[row]:.4g} mm" if self.lower[row] > 0.0 else ""
        return (
            f"{subject}: at the {where} {name} is {how} by its sphere {number}{margin}; move the {where} or "
            f"the obstacle, or give links closer spheres (mbocp spheres {self.robot.name})"
        )

    @property
    def words(self) -> tuple[str, ...]:
        """What is kept apart and what is left out, a line for each."""
        lines, counts = [], Counter(k for _, k in self.pairs)
        for k, obstacle in enumerate(self.obstacles[:_TOLD]):
            count = counts[k]
            told = [f"{n} {reason}" for reason, n in self.left_out.get(obstacle.name, {}).items()]
            left = f"; left out {' and '.join(told)}" if told else ""
            lines.append(f"{obstacle.name}: {count} {'sphere' if count == 1 else 'spheres'}{left}")
        more = len(self.obstacles) - _TOLD
        if more > 0:
            count = sum(counts[k] for k in range(_TOLD, len(self.obstacles)))
            lines.append(f"and {more} more obstacles: {count} spheres")
        if self.self_pairs is not None:
            found = self.self_pairs
            told = [f"{len(pairs)} {reason}" for reason, pairs in found.left_out.items()]
            left = f"; left out {', '.join(told)}" if told else ""
            pairs = len(self.sphere_pairs)
            lines.append(f"itself: {len(found.links)} pairs of links, {pairs} of spheres{left}")
        return tuple(lines)


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
    what = "obstacle" if obstacles else "self_collision"
    names = [obstacle.name for obstacle in obstacles]
    for name, count in Counter(names).items():
        if count > 1:
            raise ProblemError(f"obstacle {name!r}: there are several of this name; give each its own")
    links = robot.collision_spheres
    if not links:
        raise ProblemError(
            f"{what}: robot {robot.name!r} has no collision geometry: its URDF has no <collision>; add it, "
            "or give [[collision_sphere]] in its robot.toml"
        )
    every = [(i, j) for i, link in enumerate(links) for j in range(len(link.radii))]
    kept: list[tuple[tuple[int, int], int]] = []
    left_out: dict[str, dict[str, int]] = {}
    for k, obstacle in enumerate(obstacles):
        told: dict[str, int] = {}
        for sphere in every:
            reason = _never_meet(robot, links[sphere[0]], sphere[1], obstacle, limits)
            if reason:
                told[reason] = told.get(reason, 0) + 1
            else:
                kept.append((sphere, k))
        left_out[obstacle.name] = told
    found = None if own is None else _self_pairs(robot, own, limits)
    between = () if found is None else found.spheres
    used = sorted({sphere for sphere, _ in kept} | {s for pair in between for s in pair})
    place = {sphere: n for n, sphere in enumerate(used)}
    return Clearance(
        robot=robot,
        obstacles=tuple(obstacles),
        spheres=tuple(used),
        pairs=tuple((place[sphere], k) for sphere, k in kept),
        sphere_pairs=tuple((place[a], place[b]) for a, b in between),
        self_margin=0.0 if own is None else own.margin,
        left_out=left_out,
        self_pairs=found,
    )


def with_larger_margin(problem: P, between: str, more: float) -> P | None:
    """The problem with more room between two things, which keep their pairs; None if an end is too near.

    Parameters
    ----------
    problem : Problem
    between : str
        Both, as `mbocp.problem.approach.Approach` says it.
    more : float
        [m].
    """
    names = [o for o in problem.obstacle if between.endswith(f" and {o.name}")]
    try:
        if names:
            raised = (replace(o, margin=o.margin + more) if o in names else o for o in problem.obstacle)
            return replace(problem, obstacle=tuple(raised))
        own = problem.self_collision
        if not isinstance(own, SelfCollision):
            return None
        return replace(problem, self_collision=replace(own, margin=own.margin + more))
    except ProblemError:  # the start or the goal has not as much room: the motion stays as it is
        return None


def _never_meet(robot: Robot, link: LinkSpheres, number: int, obstacle: Obstacle, limits: Bounds) -> str:
    """Why a sphere never meets an obstacle; empty if it may."""
    model, frame = robot.model, robot.model.frames[robot.frame_id(obstacle.frame)]
    carrier = int(frame.parentJoint)
    if link.joint == carrier:
        return _STILL
    if carrier and (model.parents[link.joint] == carrier or model.parents[carrier] == link.joint):
        return "on the link next to its own"
    if carrier or obstacle.movable:
        return ""
    center = model.frames[link.frame].placement.act(np.array(link.centers[number]))
    at, radius = reach(model, link.joint, center, np.asarray(limits.q_lower), np.asarray(limits.q_upper))
    if not np.isfinite(radius):
        return ""
    placed = frame.placement * obstacle.placement
    return _FAR if _distance(obstacle, placed, at, radius + link.radii[number]) > obstacle.margin else ""


def _distance(obstacle: Obstacle, placed: pin.SE3, center: Array, radius: float) -> float:
    shape = coal.Transform3s(placed.rotation, placed.translation)
    ball = coal.Transform3s(np.eye(3), np.array(center))
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return float(coal.distance(obstacle.geometry, shape, coal.Sphere(float(radius)), ball, request, result))


def _self_pairs(robot: Robot, own: SelfCollision, limits: Bounds) -> SelfPairs:
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
        for source in robot.collision:
            beside = find_srdf(source.urdf.path)
            disabled |= set() if beside is None else disabled_by(beside, source.prefix)
    lower, upper = (
        np.where(np.isfinite(mine), mine, theirs)
        for mine, theirs in (
            (np.asarray(limits.q_lower), np.asarray(robot.model.lowerPositionLimit)),
            (np.asarray(limits.q_upper), np.asarray(robot.model.upperPositionLimit)),
        )
    )
    return self_pairs(robot.model, robot.collision_spheres, robot.q0, (lower, upper), disabled)
