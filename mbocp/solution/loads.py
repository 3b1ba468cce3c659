"""What a motion asks of each motor: root mean square and largest of its control, largest powers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.integrators import root_mean_squares
from mbocp.solution.solution_data import SolutionData

if TYPE_CHECKING:
    from mbocp.robot import Robot


FORCES = ("N", "N m")  # units of controls that have a power; others prescribe a motion


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
        Largest power that it gives and that it takes up, within steps, too [W]; NaN of controls that
        prescribe a motion.
    work, braked : float
        Energy that it gives and that it takes up over the motion [J]; NaN likewise.
    """

    name: str
    unit: str
    rms: float
    largest: float
    power: float
    braking: float
    work: float
    braked: float


def rms_of(solution: SolutionData) -> Array:
    """Root mean square of each control over the whole motion, shape (nu,)."""
    lengths = np.diff(solution.t)
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers that diverged
        return root_mean_squares(lengths, solution.us, solution.u_values, solution.u_shares.tolist())


def largest_of(solution: SolutionData) -> Array:
    """Largest magnitude of each control over the whole motion, shape (nu,): see `Load.largest`."""
    timed = np.diff(solution.t) > 0.0  # impacts take no time, and no control acts
    begins, ends = solution.controls_at(solution.t[:-1][timed]), solution.us_at_ends[timed]
    given = solution.u_values[timed].reshape(-1, solution.nu) if solution.u_values.size else begins
    return np.abs(np.vstack([begins, ends, given])).max(axis=0, initial=0.0)


def loads_of(solution: SolutionData, robot: Robot) -> tuple[Load, ...]:
    """Say what a motion asks of each of its controls, in their order.

    Parameters
    ----------
    solution : Solution
    robot : Robot
        That of the solution, see `Solution.load_robot`.
    """
    from mbocp.problem.step_powers import StepPowers  # mechanics, which no summary needs

    squares, sizes = rms_of(solution), largest_of(solution)
    motion = (solution.t, solution.qs, solution.vs, solution.controls_within)
    found = StepPowers.of(robot, solution.scheme, *motion)
    flows, (work, braked) = found.values.reshape(-1, solution.nu), found.works
    return tuple(
        Load(
            column.name,
            column.unit,
            rms=float(squares[k]),
            largest=float(sizes[k]),
            power=max(0.0, float(flows[:, k].max())) if column.unit in FORCES else math.nan,
            braking=max(0.0, float(-flows[:, k].min())) if column.unit in FORCES else math.nan,
            work=float(work[k]) if column.unit in FORCES else math.nan,
            braked=float(braked[k]) if column.unit in FORCES else math.nan,
        )
        for k, column in enumerate(solution.labels.u)
    )
