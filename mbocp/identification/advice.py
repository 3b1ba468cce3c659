"""What to know of a log, and of what was found, before the numbers are used."""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array
from mbocp._text import list_names
from mbocp.identification.dynamics import InverseDynamics, JointMotion
from mbocp.identification.likelihood import MaximumLikelihood
from mbocp.identification.unknown_parameters import BaseParameters

MOST_NAMES = 4  # in one message
_POOR = 0.3  # standard deviation by the value above which a log says little of a base parameter
_AGAINST = -0.5  # correlation of torques with the file's; friction that it lacks leaves 0.6 of right ones
_FACTOR = 30.0  # torques by the file's, of most joints; friction that it lacks makes 10 of some
_TOO_FAST = 1.5  # velocity by its limit, which drives keep
_PEAK = 50.0  # residual by its median: stiction makes 10
_SHARE = 0.05  # of the largest torque, beyond that


def ask(
    dynamics: InverseDynamics, motion: JointMotion, t: Array, measured: Array, given: Array, left: Array
) -> list[str]:
    """Ask where measurements look as if they were something else.

    Parameters
    ----------
    dynamics : InverseDynamics
        Of the robot's file.
    motion : JointMotion
        That was measured.
    t : ndarray, shape (K,)
        [s]
    measured, given, left : ndarray, shape (K, n)
        Torques; those by the file's numbers; and what those that were found leave [N m, N].
    """
    messages: list[str] = []

    def names(chosen: Array) -> str:
        return list_names([dynamics.names[j] for j in np.flatnonzero(chosen)], MOST_NAMES)

    steady, expected = (x - x.mean(axis=0) for x in (measured, given))
    sizes = np.linalg.norm(steady, axis=0) * np.linalg.norm(expected, axis=0)
    against = (steady * expected).sum(axis=0) < _AGAINST * sizes
    if against.any():
        messages.append(
            f"torques of {names(against)} go against those of the file: is a sign of torques or positions "
            "turned?"
        )
    of_log, of_file = (float(np.median(np.linalg.norm(x, axis=0))) for x in (measured, given))
    if not of_file < _FACTOR * of_log < _FACTOR**2 * of_file:
        words = f"{of_log / of_file:.2g} times those of the file" if of_file else "none by the file"
        messages.append(f"torques are {words}: are they in N m?")
    speeds, limits = np.abs(motion.v).max(axis=0), dynamics.robot.limits.velocity
    fast = (speeds > _TOO_FAST * limits)[dynamics.independent]
    if fast.any():
        messages.append(
            f"{names(fast)} would be faster than the robot can: are positions in degrees, or times not in "
            "seconds?"
        )
    size = np.abs(left)
    usual = _PEAK * np.median(size, axis=0) + _SHARE * np.abs(measured).max(axis=0)
    for j in np.flatnonzero(size.max(axis=0) > usual):
        k, name = int(size[:, j].argmax()), dynamics.names[j]
        messages.append(
            f"torque of {name!r} at {t[k]:.6g} s is off by {size[k, j]:.3g}: leave an outlier out"
        )
    return messages


def describe(base: BaseParameters, found: MaximumLikelihood, distance: float) -> list[str]:
    """Say what a log does not tell.

    Parameters
    ----------
    base : BaseParameters
    found : MaximumLikelihood
    distance : float
        From the base parameters to those of real bodies, by standard deviations.
    """
    sd = np.sqrt(np.diag(found.covariance))
    messages = (
        [] if found.settled else ["the estimate did not settle: its numbers and intervals may be wrong"]
    )
    units = [base.labels[k].unit for k in base.chosen]
    size = {unit: np.abs(found.beta[[u == unit for u in units]]).max() for unit in units}
    poor = [
        base.labels[k].name
        for k, spread, value, unit in zip(base.chosen, sd, found.beta, units, strict=True)
        if spread > _POOR * max(abs(value), _POOR * size[unit])
    ]
    if poor:
        messages.append(f"the log says little of {list_names(poor, MOST_NAMES)}: move more, or faster")
    if (found.speed_sd > _POOR * found.speeds).any():
        messages.append("the log says little of the speed over which friction turns: move slowly, too")
    if distance > 2.0:
        messages.append(
            f"no real bodies have the base parameters of the log: they moved by {distance:.2g} standard "
            "deviations; friction, an elastic joint or a wrong length may be missing"
        )
    if found.correlation.max() > 1.5:
        name = found.dynamics.names[int(found.correlation.argmax())]
        messages.append(
            f"torque residuals of {name!r} are no noise and count as {found.correlation.max():.2g} times the "
            "variance: the model lacks something"
        )
    massless = [
        name
        for joint, name in enumerate(found.dynamics.robot.joint_names, start=1)
        if found.dynamics.model.inertias[joint].mass <= 0.0
    ]
    if massless:
        messages.append(f"{list_names(massless, MOST_NAMES)}: without mass in the file, and still")
    if found.offset_sd.any() and (found.offset_sd > 0.05).any():
        names = [found.dynamics.names[j] for j in np.flatnonzero(found.offset_sd > 0.05)]
        messages.append(f"offsets of {list_names(names, MOST_NAMES)}: torques do not tell them")
    return messages
