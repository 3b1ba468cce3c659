"""What a problem asks of a motion, in plain values that a result keeps.

They follow from the problem, see `mbocp.solution.its_problem`. A result has them beside the text of its
problem: nobody has to make the problem again to say which limits a motion touches, or where its phases end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.terms.rates import RATE_TERMS

_Numbers = tuple[float, ...]


class ViaPlace(NamedTuple):
    """A via point of a solved problem.

    Attributes
    ----------
    name : str
    node : int
    is_found : bool
        Whether the solver found its time.
    earliest, latest : float
        Bounds of that time [s]; infinite, or 0, where there is none.
    """

    name: str
    node: int
    is_found: bool
    earliest: float
    latest: float


class PhasePlace(NamedTuple):
    """A phase of a solved problem.

    Attributes
    ----------
    name : str
    first, last : int
        Nodes where it begins and ends; an impact at its beginning is part of it.
    shortest, longest : float
        Bounds of its duration [s]; the same where it was given.
    has_impact : bool
        Whether its first step takes no time.
    has_parting : bool
        Whether its last step takes no time.
    """

    name: str
    first: int
    last: int
    shortest: float
    longest: float
    has_impact: bool = False
    has_parting: bool = False

    @property
    def is_free(self) -> bool:
        """Whether the solver found its duration."""
        return self.shortest < self.longest


class PathRow(NamedTuple):
    """What a row of the path constraints says.

    Attributes
    ----------
    name : str
    lower, upper : float
        Bounds; the same where it is an equation.
    unit : str
    total : int
        At how many nodes it holds.
    """

    name: str
    lower: float
    upper: float
    unit: str
    total: int

    @property
    def is_equation(self) -> bool:
        """Whether both bounds are the same."""
        return self.lower == self.upper


class ParameterValue(NamedTuple):
    """A number of the robot that was found.

    Attributes
    ----------
    name : str
    value : float
    unit : str
    lower, upper : float
    multiplier : float
        Of its bounds: what the optimal cost loses where the bound yields by one; negative at a lower one.
    """

    name: str
    value: float
    unit: str
    lower: float
    upper: float
    multiplier: float


class BrakingPlace(NamedTuple):
    """A joint whose speed falls towards the limits of its position, all along a motion.

    Attributes
    ----------
    joint : str
    lower, upper : float
        Limits of its position; infinite where there is none.
    deceleration, reserve : float
        See `mbocp.terms.braking.Braking`.
    """

    joint: str
    lower: float
    upper: float
    deceleration: float
    reserve: float


@dataclass(frozen=True)
class Facts:
    """What a problem asks of a motion.

    Attributes
    ----------
    duration_range : tuple of float, optional
        Least and greatest duration [s]; None where it is given.
    via : tuple of ViaPlace
        The via points, in the order of their nodes.
    phases : tuple of PhasePlace
        The phases that have names, in their order.
    path : tuple of PathRow
        The rows of the path constraints.
    rates : mapping of str to (tuple of float, tuple of float)
        Lower and upper bounds by key of `mbocp.terms.rates.RATE_TERMS`, for all velocities or controls; where
        phases differ, the widest of them.
    along : mapping of str to (tuple, tuple)
        Lower and upper limits of "u" in the N steps, and of "v" and "q" at the nodes 1..N, where phases have
        limits of their own.
    ties : int, optional
        How many constraints the robot has at all times; None in files of older versions.
    held, contacts : tuple of str
        Names of what phases hold, and of constraints whose forces are bounded.
    a_start : tuple of float
        Acceleration before the start, for each velocity.
    u_start, u_goal : tuple of float
        Controls before the start and after the end, from and to which limits of rates lead; empty where these
        are free.
    q_goal : tuple of bool
        Of each velocity, whether the goal says where its coordinate ends; empty where all do.
    braking : tuple of BrakingPlace
    ends_held : bool
        Whether limits of rates lead to the controls that hold the robot where it ends.
    effort_rms : tuple of float
        Limit of the root mean square of each control, infinite where there is none.
    parameters : tuple of ParameterValue
        Numbers of the robot that were found, in their order.
    elastic : mapping of str to str
        Joints of the motors of elastic joints, by the names of these.
    """

    duration_range: tuple[float, float] | None = None
    via: tuple[ViaPlace, ...] = ()
    phases: tuple[PhasePlace, ...] = ()
    path: tuple[PathRow, ...] = ()
    rates: Mapping[str, tuple[_Numbers, _Numbers]] = field(default_factory=dict)
    along: Mapping[str, tuple[tuple[_Numbers, ...], tuple[_Numbers, ...]]] = field(default_factory=dict)
    ties: int | None = None
    held: tuple[str, ...] = ()
    contacts: tuple[str, ...] = ()
    a_start: _Numbers = ()
    u_start: _Numbers = ()
    u_goal: _Numbers = ()
    q_goal: tuple[bool, ...] = ()
    braking: tuple[BrakingPlace, ...] = ()
    ends_held: bool = False
    effort_rms: _Numbers = ()
    parameters: tuple[ParameterValue, ...] = ()
    elastic: Mapping[str, str] = field(default_factory=dict)

    def fit(self, num_steps: int, sizes: Mapping[str, int]) -> Facts:
        """Return what fits a motion; a file may say something else, and so may a problem of other steps.

        Parameters
        ----------
        num_steps : int
        sizes : mapping of str to int
            Numbers of "q", "v" and "u".
        """

        def fits_rate(key: str, bounds: tuple[Sequence[float], ...]) -> bool:
            return key in RATE_TERMS and {len(side) for side in bounds} == {sizes[RATE_TERMS[key].over]}

        def fits_steps(letter: str, sides: tuple[Sequence[Sequence[float]], ...]) -> bool:
            shapes = {(len(side), *{len(row) for row in side}) for side in sides}
            return letter in sizes and shapes == {(num_steps, sizes[letter])}

        return replace(
            self,
            via=tuple(place for place in self.via if 0 < place.node <= num_steps),
            phases=self.phases if _fill(self.phases, num_steps) else (),
            rates={key: bounds for key, bounds in self.rates.items() if fits_rate(key, bounds)},
            along={letter: sides for letter, sides in self.along.items() if fits_steps(letter, sides)},
            a_start=self.a_start if len(self.a_start) == sizes["v"] else (),
            u_start=self.u_start if len(self.u_start) == sizes["u"] else (),
            u_goal=self.u_goal if len(self.u_goal) == sizes["u"] else (),
            q_goal=self.q_goal if len(self.q_goal) == sizes["v"] else (),
            effort_rms=self.effort_rms if len(self.effort_rms) == sizes["u"] else (),
        )

    @property
    def limits_more_of_controls(self) -> bool:
        """Whether rates, powers or root mean squares of controls have limits."""
        return bool(self.effort_rms) or any(RATE_TERMS[key].over == "u" for key in self.rates)

    def bounds_of_rate(self, key: str) -> Array:
        """Lower and upper bounds of a key of `rates`, shape (2, n)."""
        return np.array(self.rates[key], dtype=np.float64)

    def limits_along(self, letter: str) -> Array | None:
        """Limits in the steps, or at the nodes 1..N, shape (2, N, n); None where all phases have the same."""
        sides = self.along.get(letter)
        return None if sides is None else np.array(sides, dtype=np.float64)


def _fill(phases: Sequence[PhasePlace], num_steps: int) -> bool:
    """Whether phases have all steps of a motion, one after the other."""
    ends = [0, *(phase.last for phase in phases)]
    begins = [*(phase.first for phase in phases), num_steps]
    return ends == begins and all(first < last for first, last in pairwise(ends))
