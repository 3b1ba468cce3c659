"""Limits of accelerations, jerks, rates of controls and powers: with their numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mbocp._arrays import Array, BoolArray, IntArray, dataclass, frozen_array
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem.limits import LIMITS, Bounds
from mbocp.robot import Label, Robot
from mbocp.terms.bounded import BoundedTerm, SidesInSteps
from mbocp.terms.rates import RATE_TERMS, ControlRateAtEnd, JerkAtEnd, RateTerm
from mbocp.terms.span import Span


@dataclass(frozen=True, eq=False)
class RateLimit(BoundedTerm):
    """Bounds on rates that hold in every step, see `mbocp.terms.rates.RateTerm`.

    Attributes
    ----------
    key : str
        In `[limits]`.
    term : RateTerm
        Its structure.
    labels : tuple of Label
        Name and unit of each row.
    lower, upper : ndarray, shape (rows,)
    scale : float
        Power of two near the largest bound; solvers see values by it.
    columns : ndarray of int, shape (rows,)
        Of the velocities or controls.
    """

    key: str
    term: RateTerm
    labels: tuple[Label, ...]
    lower: Array
    upper: Array
    scale: float
    columns: IntArray

    span = Span()

    @property
    def name(self) -> str:
        """The key of the file."""
        return f"limits.{self.key}"

    @property
    def inner_bounds(self) -> tuple[Array, Array]:
        """Bounds of the expression."""
        return np.asarray(self.lower) / self.scale, np.asarray(self.upper) / self.scale

    @property
    def numbers(self) -> dict[str, Array]:
        """Parameters of the expression by name."""
        return {"scale": np.array([self.scale])}

    def sides_in_steps(
        self, num_steps: int, dt: float, limits: Mapping[str, tuple[Array, Array]] | None, *, is_inner: bool
    ) -> SidesInSteps | None:
        """All steps, where phases have limits of their own."""
        if limits is None:
            return None
        scale = self.scale if is_inner else 1.0
        lower, upper = limits[self.term.letter]
        return slice(None), lower[:, self.columns] / scale, upper[:, self.columns] / scale

    def slopes(self, values: Array) -> Array:
        """Derivatives of the expression in the values."""
        return np.full_like(values, 1.0 / self.scale)

    def values_of(self, rates: Mapping[str, Array], dts: Array) -> Array:
        """Values in steps of these lengths [s], shape (N, rows), from `rates_along`."""
        return rates[self.key][:, self.columns]


@dataclass(frozen=True, eq=False)
class EndRateLimit(RateLimit):
    """Bounds on the rate with which values become those at the end, after the last step's middle.

    Attributes
    ----------
    goal : ndarray, shape (rows,)
        Accelerations or controls at the end [m/s^2, rad/s^2, N, N m].
    length : float
        Of the last step, or what lengths that are found are counted in [s].
    of : str
        What becomes those, see `RateAtEnd`.
    """

    goal: Array
    length: float
    of: str

    @property
    def numbers(self) -> dict[str, Array]:
        """Parameters of the expression by name."""
        return {**super().numbers, "length": np.array([self.length]), "goal": self.goal}

    def nodes(self, num_steps: int, dt: float) -> BoolArray:
        """The last one alone."""
        return np.repeat((np.arange(num_steps) == num_steps - 1)[:, None], self.rows, axis=1)

    def sides_in_steps(
        self, num_steps: int, dt: float, limits: Mapping[str, tuple[Array, Array]] | None, *, is_inner: bool
    ) -> SidesInSteps | None:
        """None: they are those of the last phase."""
        return None

    def values_of(self, rates: Mapping[str, Array], dts: Array) -> Array:
        """Values as if each step were the last."""
        lengths = np.where(dts > 0.0, dts, self.length)[:, None]
        return (self.goal_of(rates) - rates[self.of][:, self.columns]) / (lengths / 2.0)

    def goal_of(self, rates: Mapping[str, Array]) -> Array:
        """Values at the end, shape (rows,)."""
        return self.goal


@dataclass(frozen=True, eq=False)
class EndHoldLimit(EndRateLimit):
    """Bounds on the rate with which controls become those that hold the robot where it ends."""

    def goal_of(self, rates: Mapping[str, Array]) -> Array:
        """Of `rates["held"]`, shape (nu,) or (N, nu)."""
        return rates["held"][..., self.columns]


def rate_limits(robot: Robot, bounds: Bounds) -> tuple[RateLimit, ...]:
    """The limits of rates among bounds, one for each key that limits something."""
    found = []
    for term in RATE_TERMS.values():
        if term.letter in bounds.letters:
            columns = np.flatnonzero(bounds.finite(term.letter))
            found.append(RateLimit(**_limit(robot, bounds, term, columns)))
    return tuple(found)


def end_jerk_limit(
    robot: Robot, bounds: Bounds, goal: Array, asked: BoolArray, length: float
) -> tuple[EndRateLimit, ...]:
    """The limit of jerks at the end, of the velocities whose accelerations are asked for there, if any is.

    Parameters
    ----------
    robot : Robot
    bounds : Bounds
        Limits at the end.
    goal : ndarray, shape (nv,)
        Accelerations at the end [m/s^2, rad/s^2].
    asked : ndarray of bool, shape (nv,)
    length : float
        Of the last step, or what lengths that are found are counted in [s].
    """
    columns = np.flatnonzero(asked & bounds.finite("j"))
    if not columns.size:
        return ()
    limit = _limit(robot, bounds, JerkAtEnd, columns)
    return (EndRateLimit(**limit, goal=frozen_array(goal[columns]), length=length, of="acceleration"),)


_SHARE = 0.01  # of a step, in which linear controls become those after the end


def end_control_limit(
    robot: Robot, bounds: Bounds, goal: Array | None, length: float, *, is_linear: bool
) -> tuple[EndRateLimit, ...]:
    """The limit of rates with which controls become those after the end, if there is any.

    Parameters
    ----------
    robot : Robot
    bounds : Bounds
        Limits at the end.
    goal : ndarray, shape (nu,), optional
        Controls after the end [N, N m]; None: those that hold the robot, see `ControlRateAtEnd`.
    length : float
        Of the last step, or what lengths that are found are counted in [s].
    is_linear : bool
        Whether controls are linear in steps: these are those at the end then.
    """
    columns = np.flatnonzero(bounds.finite("du"))
    if not columns.size:
        return ()
    limit = _limit(robot, bounds, ControlRateAtEnd, columns)
    limit |= {"length": 2.0 * _SHARE * length if is_linear else length, "of": "control"}
    if goal is not None:
        return (EndRateLimit(**limit, goal=frozen_array(goal[columns])),)
    limit["term"] = replace(limit["term"], holds=True)
    return (EndHoldLimit(**limit, goal=frozen_array(np.zeros(len(columns)))),)


def _limit(robot: Robot, bounds: Bounds, term: type[RateTerm], columns: IntArray) -> dict[str, Any]:
    labels = robot.v_labels if term.over == "v" else robot.u_labels
    lower, upper = (side[columns] for side in bounds.sides(term.letter))
    sizes = np.abs(np.concatenate([lower, upper]))
    largest = float(sizes[np.isfinite(sizes)].max())
    # Speeds begin with the velocities that no control prescribes.
    place = {dof: i for i, dof in enumerate(robot.undriven if robot.drives else range(robot.nv))}
    entries = [place.get(int(i), -1) for i in columns] if term.over == "v" else [int(i) for i in columns]
    return {
        "key": term.key,
        "term": term(tuple(entries)),
        "labels": tuple(Label(term.row_name(labels[i].name), term.unit(labels[i].unit)) for i in columns),
        "lower": frozen_array(lower),
        "upper": frozen_array(upper),
        "scale": 2.0 ** round(math.log2(largest)) if largest > 0.0 else 1.0,
        "columns": columns,
    }


def check_rates(robot: Robot, limits: Bounds) -> None:
    """Refuse limits of what a control prescribes, and rates of which a motion cannot begin.

    Raises
    ------
    ProblemError
        If an acceleration or a jerk is limited of a velocity that a control prescribes, or the power of such
        a control.
    InvalidValue
        If a rate of a control cannot be zero, as it is in the first step.
    """
    for term in (term for term in RATE_TERMS.values() if term.letter in limits.letters):
        for i in np.flatnonzero(limits.finite(term.letter)):
            _check_one(robot, limits, term, int(i))


def _check_one(robot: Robot, bounds: Bounds, term: type[RateTerm], i: int) -> None:
    key = LIMITS[term.letter]
    if term.over == "v" and robot.drives and i in set(robot.driven):
        raise ProblemError(
            f"{key}: {robot.v_labels[i].name!r} is prescribed by a control; limit the rate of the control "
            "(limits.effort_rate)"
        )
    if term.key == "power" and i >= robot.nu - len(robot.drives):
        raise ProblemError(
            f"{key}: the control {robot.u_labels[i].name!r} prescribes a motion and has no power; limit the "
            "control (limits.effort), or its rate (limits.effort_rate)"
        )
    if term.key == "effort_rate":
        lower, upper = (float(side[i]) for side in bounds.sides(term.letter))
        if not lower <= 0.0 <= upper:
            name = robot.u_labels[i].name
            raise InvalidValue(
                f"{key}.{name}", [lower, upper], "a range with zero in it: the first step has no rate"
            )
