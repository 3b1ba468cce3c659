"""Parameters of the robot that are found with the motion, and those that are uncertain."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field

import numpy as np

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp.exceptions import ProblemError
from mbocp.mechanisms.consistent_states import tangent_space
from mbocp.problem.goals.free_start import FreeStart
from mbocp.robot import Robot
from mbocp.robot.named_numbers import OF_ROBOT, number_of, open_numbers, take, with_numbers

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


@dataclass(frozen=True)
class ParameterCost:
    """What a parameter p costs: linear p + square (p - reference)^2."""

    linear: float = 0.0
    square: float = 0.0
    reference: float = 0.0

    def of(self, value: float) -> float:
        """Return the cost of a value."""
        return self.linear * value + self.square * (value - self.reference) ** 2


@dataclass(frozen=True)
class Parameter:
    """A number that is found.

    Attributes
    ----------
    words : tuple of str
        Numbers of the robot that have its value, see `mbocp.robot.named_numbers`.
    unit : str
    lower, upper : float
    start : float
        Where the search begins; in a solution, what was found.
    cost : ParameterCost
    multiplier : float
        Of its bounds, in a solution.
    """

    words: tuple[str, ...]
    unit: str
    lower: float
    upper: float
    start: float
    cost: ParameterCost = field(default_factory=ParameterCost)
    multiplier: float = math.nan

    @property
    def name(self) -> str:
        """The first of its words, as a file has it."""
        return OF_ROBOT + self.words[0]

    @property
    def least_cost(self) -> float:
        """What it costs at least between its bounds."""
        cost = self.cost
        lowest = cost.reference - cost.linear / (2.0 * cost.square) if cost.square else self.lower
        return min(map(cost.of, (self.lower, self.upper, min(max(lowest, self.lower), self.upper))))


def open_robot(robot_of_file: Robot, parameter: Sequence[Parameter]) -> Robot:
    """Return the robot with parameters at their starts, whose functions take them."""
    if not parameter:
        return robot_of_file
    at_start = with_values(robot_of_file, parameter, [one.start for one in parameter])
    return open_numbers(at_start, [word for one in parameter for word in one.words])


def with_values(robot: Robot, parameters: Sequence[Parameter], values: Sequence[float] | Array) -> Robot:
    """Return the robot in which parameters have these values."""
    pairs = zip(parameters, values, strict=True)
    given = {word: float(value) for one, value in pairs for word in one.words}
    return with_numbers(robot, {w: v for w, v in given.items() if v != number_of(robot, w)})


def start_of_loops(robot: Robot, parameters: Sequence[Parameter]) -> FreeStart | None:
    """Return what a start is free in where parameters move the robot's loops: all joints without motors.

    Raises
    ------
    ProblemError
        If joints with motors do not say where the others are.
    """
    if not (robot.nc and any(take(robot, word).moves for one in parameters for word in one.words)):
        return None
    free = ~np.abs(robot.actuation.selection).max(axis=1, initial=0.0).astype(bool)
    basis = tangent_space(robot, robot.q0)
    if np.count_nonzero(~free) != basis.shape[1] or np.linalg.matrix_rank(basis[~free]) < basis.shape[1]:
        raise ProblemError(
            f"parameter: {parameters[0].name} moves the loops of robot {robot.name!r}, and its joints with "
            "motors do not say where the others begin; give start.free"
        )
    return FreeStart(q=free, v=np.zeros(robot.nv, dtype=np.bool_))
