"""What is uncertain about a motion, and how much room its limits leave for that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

from mbocp._arrays import Array, dataclass, frozen_array

FEEDBACKS = ("gains", "none")


@dataclass(frozen=True, kw_only=True, eq=False)
class Robust:
    """Standard deviations of what a motion does not know, and by how many of them its limits keep off.

    Attributes
    ----------
    q, v : ndarray, shape (nv,)
        Of the start: moves of q along its tangent [m, rad], and v [m/s, rad/s].
    tau : ndarray, shape (nu,)
        Of white noise added to the controls [N sqrt(s), N m sqrt(s)].
    parameters : mapping of str to ndarray
        Of numbers of the robot, by the words of `mbocp.sensitivities`.
    sigmas : float
        Standard deviations between a limit and the mean of what it limits.
    feedback : {"gains", "none"}
        What answers to deviations: the feedback of the optimum, or nothing.
    """

    q: Array
    v: Array
    tau: Array
    parameters: Mapping[str, Array] = field(default_factory=dict)
    sigmas: float
    feedback: str = "gains"

    def __post_init__(self) -> None:
        for name in ("q", "v", "tau"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))
        parameters = {word: frozen_array(sizes) for word, sizes in self.parameters.items()}
        object.__setattr__(self, "parameters", parameters)


@dataclass(frozen=True, eq=False)
class Tube:
    """How far motions stray from a plan, in a programme's unknowns.

    Attributes
    ----------
    sigmas : float
        See `Robust`.
    xs, us : ndarray, shapes (N + 1, nx), (N, nu)
        The plan.
    covariances : ndarray, shape (N + 1, ndx, ndx)
        Of states, in their tangent.
    spreads : ndarray, shape (N, nu)
        Standard deviations of controls.
    """

    sigmas: float
    xs: Array
    us: Array
    covariances: Array
    spreads: Array
