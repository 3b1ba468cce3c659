"""Parts of a world that do not act on each other: each has symmetries of its own."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pinocchio as pin

from mbocp._arrays import IntArray
from mbocp.robot import Robot

_SEED, _SAMPLES = 20250521, 3  # what couples does so at random configurations


def independent_parts(robot: Robot) -> tuple[frozenset[int], ...]:
    """Joints of each set of branches of the world that nothing joins, in the order of their first joints.

    Branches are joined by force elements, elastic joints, holonomic constraints, mimic joints, inertia and
    actuators that act on both.
    """
    model = robot.model
    branch = [0] * model.njoints
    owner = np.zeros(robot.nv, dtype=np.intp)
    for joint in range(1, model.njoints):
        parent, entry = int(model.parents[joint]), model.joints[joint]
        branch[joint] = branch[parent] if parent else joint
        owner[entry.idx_v : entry.idx_v + entry.nv] = branch[joint]
    joined = {root: root for root in branch[1:]}
    for pair in zip(model.mimicking_joints, model.mimicked_joints, strict=True):
        _join(joined, (branch[joint] for joint in pair))
    for element in robot.forces:
        ends = (model.frames[frame].parentJoint for frame in (element.frame_a, element.frame_b))
        _join(joined, (branch[joint] for joint in ends if joint))
    for elastic in robot.elastic:
        _join(joined, (int(owner[dof]) for dof in elastic.at_v))
    if len({_root(joined, root) for root in branch[1:]}) > 1:  # what is one part already stays one
        _join_by_equations(robot, joined, owner)
    roots = {joint: _root(joined, branch[joint]) for joint in range(1, model.njoints)}
    return tuple(
        frozenset(joint for joint, root in roots.items() if root == first)
        for first in dict.fromkeys(roots.values())
    )


def _join_by_equations(robot: Robot, joined: dict[int, int], owner: IntArray) -> None:
    """Join what a row of the equations has together, at random configurations."""
    model = robot.model
    rng = np.random.default_rng(_SEED)
    for _ in range(_SAMPLES):
        q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.2, 1.2, robot.nv))
        rows = (robot.mass_matrix(q), robot.closure_jacobian(q), robot.actuation_matrix(q).T)
        for row in np.vstack([matrix.reshape(-1, robot.nv) for matrix in rows]):
            _join(joined, owner[row != 0.0].tolist())


def part_name(robot: Robot, joints: frozenset[int]) -> str:
    """What such a part is called: the part of the problem that its joints belong to, or its first joint."""
    names = [robot.model.names[joint] for joint in sorted(joints)]
    for part in robot.parts:
        if all(name.startswith(part.prefix) for name in names):
            return part.name
    return str(names[0])


def _join(joined: dict[int, int], roots: Iterable[int]) -> None:
    found = [_root(joined, root) for root in roots]
    for root in found:
        joined[root] = min(found)


def _root(joined: dict[int, int], branch: int) -> int:
    while joined[branch] != branch:
        branch = joined[branch]
    return branch
