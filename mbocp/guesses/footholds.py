"""Where feet land in a guess, so that they go along with the body.

A problem says of a foot that lands that it is on the ground, and seldom more. In a guess it lands where it is
on the line from start to goal in the middle of the time for which it stands then: in the end, where it is at
the goal. The body is there in the middle of its feet.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.guesses.stop import Stop, first_of
from mbocp.problem import Goal
from mbocp.problem.timeline.switches import SwitchTable, rows_of_frames
from mbocp.robot import Robot
from mbocp.robot.kinematics import WORLD
from mbocp.robot.poses.target import FrameTarget
from mbocp.robot.walking import find_walking_bodies

_PLACE = 3  # rows of what keeps the origin of a frame where it is [m]


class Landing(NamedTuple):
    """What a guess wants at a stop at which feet land.

    Attributes
    ----------
    q : ndarray, shape (nq,)
        Of the line.
    targets : tuple of FrameTarget
        Where they land, as far as the problem leaves that open.
    """

    q: Array
    targets: tuple[FrameTarget, ...]


class _Stand(NamedTuple):
    """A foot stands from one node to another, the first ones of their instants."""

    foot: str
    has_attitude: bool
    first: int
    last: int


def footholds(table: SwitchTable, stops: Mapping[int, Stop], clock: Array) -> dict[int, Landing]:
    """Return the landings among stops, by their nodes.

    Parameters
    ----------
    table : SwitchTable
    stops : mapping of int to Stop
        The start, what a line goes through, and the end, in their order, as they are without holds.
    clock : ndarray, shape (N + 1,)
        Times of the nodes, in any unit.
    """
    robot, stands = table.robot, list(_stands(table))
    start, end = min(stops), max(stops)
    landing = _landings(stands, stops)
    if not landing:
        return {}
    in_air = {s.foot for s in stands} - {s.foot for s in stands if s.first == start}
    begin = clock[start] if in_air else min(clock[s.last] for s in stands)
    last = clock[max(landing)]

    def share(time: float) -> float:
        return float(np.clip((time - begin) / (last - begin), 0.0, 1.0))

    def share_of(stand: _Stand) -> float:
        if stand.first == start or stand.last >= end:
            return float(stand.first > start)
        return share((clock[stand.first] + clock[stand.last]) / 2.0)

    at = _line(robot, [(share(clock[n]), stop.q) for n, stop in stops.items() if n not in landing])
    found = {}
    for node, feet in landing.items():
        standing = [share_of(s) for s in stands if s.first <= node <= s.last]
        places = [
            _target(foot, robot.frame_placement(foot.foot, at(share_of(foot))), stops[node].goal)
            for foot in feet
        ]
        targets = tuple(target for target in places if not target.is_empty)
        found[node] = Landing(at(float(np.mean(standing))), targets)
    return found


def _landings(stands: Sequence[_Stand], stops: Mapping[int, Stop]) -> dict[int, list[_Stand]]:
    """Feet that land at inner stops whose goals are theirs alone, by their nodes."""
    _, *inner, _ = sorted(stops)
    landing = {node: [stand for stand in stands if stand.first == node] for node in inner}
    return {node: feet for node, feet in landing.items() if feet and _are_all(feet, stops[node].goal)}


def takeoffs(table: SwitchTable) -> set[int]:
    """Return the nodes from which no foot stands, the first ones of their instants."""
    stands = list(_stands(table))
    return {s.last for s in stands} - {n for s in stands for n in range(s.first, s.last)}


def _stands(table: SwitchTable) -> Iterator[_Stand]:
    """When which feet stand: frames that are held where they are in the world, and moved by motors."""
    robot = table.robot
    for frame, rows in zip(table.held, rows_of_frames(table.held), strict=True):
        names = [robot.frame_names[at] for at in frame.constraint.frame_ids if at]
        keeps_place = sum(label.unit == "m" for label in frame.rows) == _PLACE
        if len(names) > 1 or not frame.is_anchored or not keeps_place or not _is_foot(robot, names[0]):
            continue
        acts = np.concatenate([[False], table.rows[:, rows].any(axis=1), [False]])
        changes = np.flatnonzero(acts[1:] != acts[:-1]).tolist()
        for first, last in zip(changes[::2], changes[1::2], strict=True):
            ends = (first_of(table.is_impact, node) for node in (first, last))
            yield _Stand(names[0], len(frame.rows) > _PLACE, *ends)


def _is_foot(robot: Robot, frame: str) -> bool:
    """Whether motors move a frame on a body that walks."""
    model = robot.model
    _, *joints = model.supports[model.frames[robot.frame_id(frame)].parentJoint]
    at = [robot.velocity_indices(model.names[joint]) for joint in joints]
    return len(at) > 1 and bool(find_walking_bodies(robot)[at[0]].all())


def _are_all(feet: list[_Stand], goal: Goal | None) -> bool:
    """Whether a goal is one of these feet alone, in the world."""
    names = {foot.foot for foot in feet}
    return goal is None or not (
        goal.q_active.any()
        or any(p.target.name not in names or p.target.relative_to != WORLD for p in goal.poses)
    )


def _target(stand: _Stand, place: pin.SE3, goal: Goal | None) -> FrameTarget:
    """A foothold, but for what the problem says of it."""
    position, said = np.array(place.translation), [] if goal is None else goal.poses
    for pose in said:
        if pose.target.name == stand.foot:
            position[pose.target.coordinates] = np.nan
    quaternion = pin.Quaternion(place.rotation).coeffs() if stand.has_attitude else None
    return FrameTarget(name=stand.foot, position=position, orientation=quaternion)


def _line(robot: Robot, knots: list[tuple[float, Array]]) -> Callable[[float], Array]:
    """Straight lines from one configuration to the next, by the share of the way at which they are."""
    legs = [(a, b) for a, b in pairwise(knots) if b[0] > a[0]]

    def at(share: float) -> Array:
        (first, q0), (last, q1) = next(leg for leg in legs if share <= leg[1][0])
        return np.array(pin.interpolate(robot.model, q0, q1, (share - first) / (last - first)))

    return at
