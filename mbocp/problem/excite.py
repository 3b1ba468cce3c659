"""What an exciting motion is to tell, and how long one looks for it."""

from __future__ import annotations

from mbocp._arrays import Array, dataclass

FRICTIONS = ("none", "viscous", "coulomb", "both")


@dataclass(frozen=True, kw_only=True, eq=False)
class Excite:
    """A motion whose torques tell most about the robot's parameters, in the place of the cost.

    Attributes
    ----------
    torque_noise : ndarray, shape (nu,)
        Standard deviations of measured torques [N m, N].
    friction : {"both", "viscous", "coulomb", "none"}
        Which is unknown, beside masses and inertias.
    knots : int
        Free control points of each joint's spline.
    starts, rounds : int
        Random splines that are improved, and how often at most.
    seed : int
        Of these.
    """

    torque_noise: Array
    friction: str
    knots: int
    starts: int
    rounds: int
    seed: int
