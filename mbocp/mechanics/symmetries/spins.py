r"""Parts of a robot that do not act on each other, and their spins.

The angular momentum of a robot's part about its own centre of mass changes by moments from outside alone,
whatever that centre does: weight has none about it, and a rod that ends there has none either. So it stays
where neither controls nor constraints nor force elements turn the part:

.. math:: X(q)^T B = 0, \qquad \Phi_q X(q) = 0, \qquad
          X(q) = \text{rotation of the part about its centre of mass}

A symmetry moves all bodies that are joined as one, about an axis that stays. A spin needs neither.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, IntArray, dataclass, frozen_array
from mbocp.robot import Robot
from mbocp.robot.large import make_working_data

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


_FLOATING = "JointModelFreeFlyer"


@dataclass(frozen=True, eq=False)
class Spin:
    """Rotation of a floating body, and of what it carries, about their centre of mass.

    Attributes
    ----------
    robot : Robot
    root : int
        Joint by which the body floats.
    axis : str
        "x", "y" or "z" of the world.
    """

    robot: Robot
    root: int
    axis: str

    @property
    def name(self) -> str:
        """For people."""
        return f"rotation about {self.axis} of {self.owner}"

    @property
    def owner(self) -> str:
        """What turns: the robot's part, or the robot where that is all of it."""
        is_all = len(self.joints) == self.robot.model.njoints - 1
        return self.robot.name if is_all else part_name(self.robot, self.joints)

    @property
    def joints(self) -> frozenset[int]:
        """Those that move the bodies that turn."""
        return frozenset(int(joint) for joint in self.robot.model.subtrees[self.root])

    @property
    def twist(self) -> Array:
        """As of a symmetry, but for the point that the axis passes."""
        return frozen_array(np.concatenate([np.zeros(3), np.eye(3)["xyz".index(self.axis)]]))

    def generator(self, qs: Array) -> Array:
        """X(q) for each row of `qs`, shape (n, nv)."""
        return np.array([self._field(q) for q in qs])

    def _field(self, q: Array) -> Array:
        model, field = self.robot.model, np.zeros(self.robot.nv)
        data = make_working_data(model)
        pin.forwardKinematics(model, data, np.array(q))
        bodies = sorted(self.joints)
        masses = np.array([model.inertias[joint].mass for joint in bodies])
        centres = [data.oMi[joint].act(model.inertias[joint].lever) for joint in bodies]
        place, entry = data.oMi[self.root], model.joints[self.root]
        turn = self.twist[3:]
        shift = np.cross(turn, place.translation - masses @ np.array(centres) / masses.sum())
        field[entry.idx_v : entry.idx_v + 6] = np.concatenate(
            [place.rotation.T @ shift, place.rotation.T @ turn]
        )
        return field


def spins_of(robot: Robot) -> Iterator[Spin]:
    """Spins of all bodies that float in the world and that no force element joins to anything else."""
    model = robot.model
    for root in range(1, model.njoints):
        if model.parents[root] or model.joints[root].shortname() != _FLOATING:
            continue
        own = Spin(robot, root, "x").joints
        ends = (
            [model.frames[frame].parentJoint in own for frame in (element.frame_a, element.frame_b)]
            for element in robot.forces
        )
        has_mass = sum(model.inertias[joint].mass for joint in own) > 0.0
        if has_mass and all(a == b for a, b in ends):
            yield from (Spin(robot, root, axis) for axis in "xyz")
