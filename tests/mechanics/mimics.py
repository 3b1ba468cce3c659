"""Robots with mimic joints, and the same ones without: joints of their own, tied by a matrix written here.

q_full = G q + offsets and v_full = G v, but for continuous joints, whose angles these are. Whatever holds for
the robot with mimic joints follows from numeric Pinocchio on the other one: M = G' M_full G, and so on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot import Robot, load_robot
from tests.robot import urdfs
from tests.robot.urdfs import joint, link, mimic

_RANGE = '<limit lower="-2.5" upper="2.5" effort="9" velocity="9"/>'

# An arm with a hand: fingers that slide against each other, a finger whose two joints bend together, and a
# rack in another branch that the arm drives.
HAND = urdfs.robot(
    link("base", None),
    link("arm"),
    joint("arm_joint", "revolute", "base", "arm", axis="0 1 0", extra=_RANGE),
    link("f1", 0.3),
    joint("finger1", "prismatic", "arm", "f1", axis="0 1 0.3"),
    link("f2", 0.3),
    joint("finger2", "prismatic", "arm", "f2", axis="0 1 -0.2", extra=mimic("finger1", -1.0, 0.05)),
    link("k"),
    joint("knuckle", "revolute", "arm", "k", axis="1 0 0.5", extra=_RANGE),
    link("t", 0.5),
    joint("tip", "revolute", "k", "t", axis="1 0.2 0", extra=mimic("knuckle", 1.3, -0.2)),
    link("t2", 0.5),
    joint("tip2", "revolute", "t", "t2", axis="0 0.2 1", extra=mimic("knuckle", -0.6, 0.1)),
    link("r", 0.7),
    joint("rack", "prismatic", "base", "r", axis="1 1 0", extra=mimic("arm_joint", 0.3)),
    name="hand",
)
HAND_TIES = {
    "finger2": ("finger1", -1.0, 0.05),
    "tip": ("knuckle", 1.3, -0.2),
    "tip2": ("knuckle", -0.6, 0.1),
    "rack": ("arm_joint", 0.3, 0.0),
}

# Wheels: one that turns freely and drives two others, a planar joint in between.
GEARS = urdfs.robot(
    link("base", None),
    link("big"),
    joint("drive", "continuous", "base", "big", axis="0 1 0.2"),
    link("table"),
    joint("floor", "planar", "big", "table", extra=""),
    link("small", 0.4),
    joint("gear1", "continuous", "table", "small", extra=mimic("drive", -3.0, 0.4)),
    link("last", 0.4),
    joint("gear2", "continuous", "small", "last", axis="1 0 0", extra=mimic("drive", 2.0)),
    name="gears",
)
GEARS_TIES = {"gear1": ("drive", -3.0, 0.4), "gear2": ("drive", 2.0, 0.0)}

# The smallest: two arms that go against each other.
PAIR = urdfs.robot(
    link("base", None),
    link("a"),
    joint("ja", "revolute", "base", "a", axis="0 1 0", extra=_RANGE),
    link("b"),
    joint("jb", "revolute", "base", "b", axis="0 1 0", extra=mimic("ja", -1.5, 0.3)),
    name="pair",
)
PAIR_TIES = {"jb": ("ja", -1.5, 0.3)}

ROBOTS = {"hand": (HAND, HAND_TIES), "gears": (GEARS, GEARS_TIES), "pair": (PAIR, PAIR_TIES)}


@dataclass(frozen=True, eq=False)
class Tied:
    """A robot with mimic joints, the one without, and what ties the latter's joints."""

    robot: Robot
    full: Robot
    ties: Mapping[str, tuple[str, float, float]]

    @property
    def G(self) -> Array:
        """Velocities of all joints per velocity of the robot, shape (full.nv, nv)."""
        out = np.zeros((self.full.nv, self.robot.nv))
        for name in self.full.joint_names:
            leader, ratio, _ = self.ties.get(name, (name, 1.0, 0.0))
            rows, columns = self.full.velocity_indices(name), self.robot.velocity_indices(leader)
            out[rows, columns] = ratio * np.eye(rows.stop - rows.start)
        return out

    def configuration(self, q: Array) -> Array:
        """Configuration of all joints, shape (full.nq,)."""
        out = np.array(self.full.neutral())
        for name in self.full.joint_names:
            leader, ratio, offset = self.ties.get(name, (name, 1.0, 0.0))
            numbers, where = (
                q[self.robot.configuration_indices(leader)],
                self.full.configuration_indices(name),
            )
            if name not in self.ties:
                out[where] = numbers
            elif len(numbers) == 2:
                angle = ratio * np.arctan2(numbers[1], numbers[0]) + offset
                out[where] = [np.cos(angle), np.sin(angle)]
            else:
                out[where] = ratio * numbers + offset
        return out

    def mass_matrix(self, q: Array) -> Array:
        full, G = self.full.mass_matrix(self.configuration(q)), self.G
        return np.asarray(G.T @ full @ G)

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        model, G = self.full.model, self.G
        return np.asarray(G.T @ pin.rnea(model, model.createData(), self.configuration(q), G @ v, G @ a))

    def acceleration(self, q: Array, v: Array, tau: Array) -> Array:
        """From forward dynamics of all joints: with the reactions of the ties, which do no work."""
        model, G, at = self.full.model, self.G, self.configuration(q)
        free = pin.aba(model, model.createData(), at, G @ v, G @ np.linalg.solve(G.T @ G, tau))
        mass = self.full.mass_matrix(at)
        return np.linalg.solve(G.T @ mass @ G, G.T @ mass @ free)


def tied(name: str, folder: Path, **options: object) -> Tied:
    """One of `ROBOTS`, with and without mimic joints."""
    text, ties = ROBOTS[name]
    path = urdfs.write(folder, text)
    return Tied(load_robot(path, **options), load_robot(path, mimic=False, **options), ties)  # type: ignore[arg-type]
