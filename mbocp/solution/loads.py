"""What a motion asks of each motor: root mean square and largest of its control, largest powers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbocp.solution.data import SolutionData

if TYPE_CHECKING:
    from mbocp.robot import Robot


_FORCES = ("N", "N m")  # units of controls that have a power; others prescribe a motion


@dataclass(frozen=True)
class Load:
    """What a motion asks of one control.

    Attributes
    ----------
    name, unit : str
        Of the control.
    rms : float
        Root mean square over the whole motion, which heats a motor.
    largest : float
        Largest magnitude at ends of steps, and where controls vary at the places that they are given at.
    power, braking : float
        Largest power that it gives and that it takes up, at the ends of steps [W]; NaN of controls that
        prescribe a motion.
    """

    name: str
    unit: str
    rms: float
    largest: float
    power: float
    braking: float


def loads_of(solution: SolutionData, robot: Robot) -> tuple[Load, ...]:
    """Say what a motion asks of each of its controls, in their order.

    Parameters
    ----------
    solution : Solution
    robot : Robot
        That of the solution, see `Solution.load_robot`.
    """
    from mbocp.mechanics.rates import powers  # mechanics, which no summary needs

    lengths = np.diff(solution.t)
    timed = lengths > 0.0  # impacts take no time, and no control acts
    values = max(len(solution.u_shares), 1)
    nodes, weights = np.polynomial.legendre.leggauss(values)  # exact for squares of the polynomials
    begins, lengths = solution.t[:-1][timed], lengths[timed]
    inside = solution.controls_at((begins[:, None] + lengths[:, None] * (1.0 + nodes) / 2.0).ravel())
    parts = np.outer(lengths, weights / 2.0).ravel() / lengths.sum()
    first, last = solution.controls_at(begins), solution.us_at_ends[timed]
    given = solution.u_values.reshape(-1, solution.nu) if solution.u_values.size else first
    work = np.vstack(
        [
            powers(robot, solution.qs[:-1][timed], solution.vs[:-1][timed], first),
            powers(robot, solution.qs[1:][timed], solution.vs[1:][timed], last),
        ]
    )
    return tuple(
        Load(
            column.name,
            column.unit,
            rms=math.sqrt(parts @ inside[:, k] ** 2),
            largest=float(max(np.abs(each[:, k]).max() for each in (first, last, given))),
            power=max(0.0, float(work[:, k].max())) if column.unit in _FORCES else math.nan,
            braking=max(0.0, float(-work[:, k].min())) if column.unit in _FORCES else math.nan,
        )
        for k, column in enumerate(solution.labels.u)
    )
