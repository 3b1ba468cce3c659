"""Powers of the controls within steps, and their work: by the cubics through the nodes, see `StepCubics`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.integrators import SCHEMES
from mbocp.mechanics.motion_rates import powers
from mbocp.problem.step_cubics import StepCubics, move_along
from mbocp.robot import Robot

_PLACES = np.linspace(0.0, 1.0, 9)  # in a step, at which powers are looked at, by Simpson's rule
_WEIGHTS = np.array([1.0, 4.0, 2.0, 4.0, 2.0, 4.0, 2.0, 4.0, 1.0]) / 24.0


@dataclass(frozen=True, eq=False)
class StepPowers:
    """Powers of the controls in the steps that take time.

    Attributes
    ----------
    values : ndarray, shape (places, n, nu)
        At the begins and ends of the steps, and at places as far apart between [W].
    lengths : ndarray, shape (n,)
        [s].
    """

    values: Array
    lengths: Array

    @classmethod
    def of(
        cls, robot: Robot, scheme: str, t: Array, qs: Array, vs: Array, controls: Callable[[Array], Array]
    ) -> StepPowers:
        """Of a motion whose controls at shares (k,) of its steps, shape (N, k, nu), a function gives.

        Of schemes of first order, and of unknown ones, speeds are linear within steps.
        """
        cubics, timed = StepCubics.through(robot, t, qs, vs), np.diff(t) > 0.0
        if scheme not in SCHEMES or SCHEMES[scheme].order == 1:
            cubics = replace(cubics, means=(cubics.v0 + cubics.v1) / 2.0)
        us, values = controls(_PLACES)[timed], []
        for k, s in enumerate(_PLACES):
            begins = qs[:-1][timed]
            places = begins if robot.actuation.is_constant else move_along(robot, begins, cubics.ways(s))
            values.append(powers(robot, places, cubics.speeds(s), us[:, k]))
        return cls(np.array(values), cubics.lengths[:, 0])

    @property
    def works(self) -> tuple[Array, Array]:
        """Work that each control does, and that it brakes [J], shape (nu,)."""
        work, braked = (
            np.einsum("p,pnu,n->u", _WEIGHTS, np.maximum(side, 0.0), self.lengths)
            for side in (self.values, -self.values)
        )
        return work, braked
