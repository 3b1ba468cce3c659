r"""Spins of floating bodies about their own centres of mass, which a robot's symmetries know nothing of.

The angular momentum of a robot's part about its own centre of mass changes by moments from outside alone,
whatever that centre does: weight has none about it, and a rod that ends there has none either. So it stays
where neither controls nor constraints nor force elements turn the part:

.. math:: X(q)^T B = 0, \qquad \Phi_q X(q) = 0, \qquad
          X(q) = \text{rotation of the part about its centre of mass}

A symmetry moves all bodies that are joined as one, about an axis that stays. A spin needs neither.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp.mechanics.symmetries.separate_parts import part_name
from mbocp.robot import Robot
from mbocp.robot.large import working_data

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
        data = working_data(model)
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
