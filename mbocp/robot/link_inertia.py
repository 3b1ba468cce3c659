"""Mass and inertia of a link that its file does not give."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin


@dataclass(frozen=True)
class LinkInertia:
    """What stands in place of a link's inertial element.

    Parameters
    ----------
    link : str
    mass : float
        [kg].
    com : (float, float, float)
        Centre of mass in the link [m].
    inertia : tuple of 6 floats
        ixx, iyy, izz, ixy, ixz, iyz about the centre of mass, in the axes of the link [kg m^2].
    origin : str
        Where the numbers are from, in words.
    """

    link: str
    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]
    origin: str

    @classmethod
    def of(cls, link: str, body: pin.Inertia, origin: str) -> LinkInertia:
        """Make it of a body in the axes of the link."""
        com, moments = np.asarray(body.lever), np.asarray(body.inertia)
        rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
        return cls(
            link, float(body.mass), tuple(com.tolist()), tuple(moments[rows, columns].tolist()), origin
        )

    @property
    def table(self) -> dict[str, Any]:
        """The numbers as in a file."""
        return {"mass": self.mass, "com": list(self.com), "inertia": list(self.inertia)}
