"""Steps of an estimator's horizon with the samples in them, as the kernel's functions take them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mbocp._arrays import Array
from mbocp.receding.estimator_functions import NUM_MOMENTS, EstimatorLayout
from mbocp.robot import Robot
from mbocp.robot.kinematics import difference

FIRST = 2  # stages before the steps
_ROUND_OFF = 1e-6  # of the length of a step


class Samples:
    """Moments of the samples in each step, however many there are.

    Parameters
    ----------
    robot : Robot
    layout : EstimatorLayout
    steps : int
    weights : mapping of str to ndarray, shapes (nv,)
        Inverse variances of `q` and, if it is measured, `v`.

    Attributes
    ----------
    rows : ndarray, shape (FIRST + steps, num_rho)
        Parameters of all stages, the newest step last.
    """

    def __init__(
        self, robot: Robot, layout: EstimatorLayout, steps: int, weights: Mapping[str, Array]
    ) -> None:
        self._robot, self._weights, self._reference = robot, weights, layout.rho["reference"]
        self.rows = np.zeros((FIRST + steps, layout.num_rho))
        self.rows[:FIRST, layout.rho["arrives"]] = np.eye(FIRST)
        self.rows[:, self._reference] = robot.q0
        self._newest = {name: self.rows[-1, where] for name, where in layout.rho.items()}

    def has_room(self, dt: float, step: float) -> bool:
        """Return whether so much time fits into the newest step; a new one takes any."""
        h = float(self._newest["h"][0])
        return h == 0.0 or h + dt <= (1.0 + _ROUND_OFF) * step

    def begin_step(self) -> None:
        """Leave out the oldest step for a new one."""
        self.rows[FIRST:-1] = self.rows[FIRST + 1 :]
        self.rows[-1] = 0.0

    def forget(self) -> None:
        """Leave out all samples."""
        self.rows[FIRST:] = 0.0
        self.rows[FIRST:, self._reference] = self._robot.q0

    def add(self, sample: Mapping[str, Array], u: Array, dt: float, q_last: Array) -> None:
        """Make the newest step longer by the time to a sample, and add the sample, if it is not lost.

        Parameters
        ----------
        sample : mapping of str to ndarray
            `q` and, if it is measured, `v`; empty: it was lost.
        u : ndarray, shape (nu,)
            Controls since the sample before.
        dt : float
            Time since then [s].
        q_last : ndarray, shape (nq,)
            Configuration at the newest node, about which a step takes its samples.
        """
        row = self._newest
        before = float(row["h"][0])
        t = before + dt
        if before == 0.0:
            row["reference"][:] = q_last
        row["h"][0], row["rate"][0], row["moves"][0] = t, 1.0 / t, 1.0
        row["u"][:] = (before * row["u"] + dt * u) / t
        if not sample:
            return
        row["moments"] += t ** np.arange(NUM_MOMENTS)
        off = {**sample, "q": difference(self._robot.model, row["reference"], sample["q"])}
        for key, powers in (("q", (1.0, t, t * t / 2)), ("v", (1.0, t))):
            if key in off:
                row[f"of_{key}"] += np.outer(powers, off[key]).ravel()
                row["squares"] += self._weights[key] @ off[key] ** 2 / 2
