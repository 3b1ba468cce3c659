"""Samples of a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbocp._arrays import Array
from mbocp.solution.sent import Sent


@dataclass(frozen=True, eq=False)
class Sampled:
    """Joints of one velocity along a motion; others (floating bases, balls) are left out.

    Parameters
    ----------
    t : ndarray, shape (K,)
        From the start of the motion [s].
    joints : tuple of str
        Names, in the order of the columns; elastic ones have the positions and efforts of their motors.
    units : tuple of str
        "rad" or "m".
    positions, velocities, accelerations : ndarray, shape (K, n)
        Continuous joints count their turns [rad, m, s].
    efforts : ndarray, shape (K, n)
        Controls of the same names, as the solution has them between nodes: constant over its steps, or
        polynomials; NaN where a joint has none [N m, N].
    interpolation : {"cubic", "quintic"}
        Between them.
    left_out : tuple of str
        Joints that are not among them.
    """

    t: Array
    joints: tuple[str, ...]
    units: tuple[str, ...]
    positions: Array
    velocities: Array
    accelerations: Array
    efforts: Array
    interpolation: str
    left_out: tuple[str, ...]


def sample(sent: Sent) -> Sampled:
    """Sample a motion as it is sent."""
    labels, times = sent.solution.labels, sent.times
    controls = {column.name: k for k, column in enumerate(labels.u)}
    applied = sent.controls(times)
    efforts = np.full((len(times), len(sent.joints)), np.nan)
    for k, name in enumerate(sent.joints):
        if name in controls:
            efforts[:, k] = applied[:, controls[name]]
    names = {name.partition(".")[0] for name in (*sent.joints, *sent.names)}
    left_out = {column.name.partition(".")[0] for column in labels.v} - names
    positions, velocities, accelerations, _ = sent.curves.at(times)
    return Sampled(
        times,
        sent.names,
        sent.units,
        positions,
        velocities,
        accelerations,
        efforts,
        sent.curves.interpolation,
        tuple(sorted(left_out)),
    )
