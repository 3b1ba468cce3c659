"""Samples of a motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp._text import warn_caller
from mbocp.exceptions import InvalidValue, MbocpError
from mbocp.solution.sent import NotCheckedWarning, Sent
from mbocp.solution.sent_states import Follower

if TYPE_CHECKING:
    from mbocp.robot import Robot


@dataclass(frozen=True, eq=False)
class JointSamples:
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
        Controls of the same names; NaN where a joint has none [N m, N].
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

    def of_part(self, part: str) -> JointSamples:
        """Those of one of several robots, by the names that its own controller knows.

        Raises
        ------
        InvalidValue
            If no joint is of that part.
        """
        start = f"{part}/"
        at = [k for k, name in enumerate(self.joints) if name.startswith(start)]
        if not at:
            parts = list(dict.fromkeys(name.partition("/")[0] for name in self.joints if "/" in name))
            raise InvalidValue.of_choice("part", part, parts or ["none, since the robot has no parts"])
        return replace(
            self,
            joints=tuple(self.joints[k].removeprefix(start) for k in at),
            units=tuple(self.units[k] for k in at),
            positions=self.positions[:, at],
            velocities=self.velocities[:, at],
            accelerations=self.accelerations[:, at],
            efforts=self.efforts[:, at],
            left_out=tuple(name.removeprefix(start) for name in self.left_out if name.startswith(start)),
        )


def sample(
    sent: Sent, load_robot: Callable[[], Robot] | None = None, part: str | None = None
) -> JointSamples:
    """Sample a motion as it is sent.

    Parameters
    ----------
    sent : Sent
    load_robot : callable, optional
        Loads the robot: efforts are then those that the motion takes as it is sent, where it says them.
        Elsewhere they are those of the solution: constant over its steps, or polynomials.
    part : str, optional
        Whose joints are sampled, see `JointSamples.of_part`; all by default.

    Raises
    ------
    InvalidValue
        If there is no such part.

    Warns
    -----
    NotCheckedWarning
        If the robot cannot be loaded.
    """
    labels, times = sent.solution.labels, sent.times
    controls = {column.name: k for k, column in enumerate(labels.u)}
    positions, velocities, accelerations, _ = sent.curves.at(times)
    applied = sent.controls(times)
    follower = _follower(sent, load_robot)
    if follower is not None and follower.has_controls:
        applied = follower.controls(*follower.states(times, positions, velocities), accelerations)
    efforts = np.full((len(times), len(sent.joints)), np.nan)
    for k, name in enumerate(sent.joints):
        if name in controls:
            efforts[:, k] = applied[:, controls[name]]
    names = {name.partition(".")[0] for name in (*sent.joints, *sent.names)}
    left_out = {column.name.partition(".")[0] for column in labels.v} - names
    found = JointSamples(
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
    return found if part is None else found.of_part(part)


def _follower(sent: Sent, load_robot: Callable[[], Robot] | None) -> Follower | None:
    """The robot on a motion of quintics; accelerations of cubics at nodes are not those of the motion."""
    if load_robot is None or sent.curves.interpolation != "quintic":
        return None
    try:
        return Follower.of(sent, load_robot())
    except MbocpError as error:
        warn_caller(f"efforts are those of the solution, not of what is sent: {error}", NotCheckedWarning)
        return None
