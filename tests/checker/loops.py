"""Holonomic constraints as rows of numbers, with their derivatives along the joints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

__all__ = ["Loop", "loop_of"]


@dataclass(frozen=True, eq=False)
class Loop:
    """rod: 1/2 (|d|^2 - l^2); point: R_b' d; hinge: a point, and an axis of a normal to two of b."""

    kind: str
    a: int
    b: int
    length: float = 0.0
    axis: Any = field(default_factory=lambda: np.zeros(3))

    @property
    def size(self) -> int:
        return {"rod": 1, "point": 3, "hinge": 5}[self.kind]

    def rows(self, system: Any) -> tuple[Any, Any]:
        """Values and Jacobian (size, nv) at the configuration that the system was placed at."""
        A, B = system.data.oMf[self.a], system.data.oMf[self.b]
        world = pin.LOCAL_WORLD_ALIGNED
        Ja, Jb = system.frame_jacobian(self.a, world), system.frame_jacobian(self.b, world)
        d, J = A.translation - B.translation, Ja[:3] - Jb[:3]
        if self.kind == "rod":
            return np.array([(d @ d - self.length**2) / 2]), (d @ J)[None]
        values, jacobian = B.rotation.T @ d, B.rotation.T @ (J + pin.skew(d) @ Jb[3:])
        if self.kind == "point":
            return values, jacobian
        axis = A.rotation @ self.axis
        turning = Ja[3:] - Jb[3:]
        others = self.normals @ B.rotation.T
        values = np.append(values, others @ axis)
        return values, np.vstack([jacobian, others @ pin.skew(axis).T @ turning])

    @cached_property
    def normals(self) -> Any:
        """Two directions across the axis, shape (2, 3)."""
        first = np.cross(self.axis, np.eye(3)[int(np.argmin(np.abs(self.axis)))])
        first /= np.linalg.norm(first)
        return np.array([first, np.cross(self.axis, first)])


def loop_of(model: Any, table: dict[str, Any], frame: Callable[[Any, str], int]) -> Loop:
    """A constraint from a table of robot.toml; hinges have the same axis in both frames."""
    a, b = (frame(model, name) for name in table["frames"])
    length = float(table.get("length", np.sqrt(1.25)))  # the paper's cart: measured at its initial pose
    axis = np.array(table.get("axis", (0.0, 0.0, 1.0)), dtype=float)
    return Loop(table["type"], a, b, length, axis / np.linalg.norm(axis))
