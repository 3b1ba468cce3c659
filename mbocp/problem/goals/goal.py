"""The goal: the end of the motion, and how strictly it is enforced; one of several."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import field
from functools import partial
from typing import Literal, TypeVar

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass, frozen_array, frozen_mask
from mbocp._text import warn_caller
from mbocp.exceptions import DimensionMismatch, ProblemError, UnreachableGoal, reword_errors
from mbocp.problem._checks import ProblemWarning, check_bool, check_choice, check_finite
from mbocp.problem.goals.end_control import EndControl
from mbocp.problem.goals.periodic import Periodic
from mbocp.terms.frame_goal import FrameGoal

Enforce = Literal["exact", "penalty", "both", "none"]
Rate = Literal["p", "v"]
Redundant = Literal["drop", "keep"]
AccelerationRule = Literal["given", "free", "rest"]

ENFORCE: tuple[Enforce, ...] = ("exact", "penalty", "both", "none")
RATES: tuple[Rate, ...] = ("p", "v")
REDUNDANT: tuple[Redundant, ...] = ("drop", "keep")
RULES: tuple[AccelerationRule, ...] = ("given", "free", "rest")
P = TypeVar("P")


@dataclass(frozen=True, kw_only=True, eq=False)
class Goal:
    r"""End condition :math:`\gamma\, g_T(y(T)) = 0` of Eq. (6) of [Bijalwan2025]_.

    Only what is written is enforced: a goal without `v` and `p` leaves the end velocity free.

    Attributes
    ----------
    q : ndarray, shape (nq,)
        Configuration at the end [m, rad, unit quaternion xyzw]. Entries that are not active hold a
        configuration that the constraints allow.
    q_active : ndarray of bool, shape (nv,)
        Which tangent directions of `q` are asked for.
    q_is_reached : bool
        Whether entries of `q` that are not active are those with which a motion ends, and no guess of them.
    rate : {"p", "v"}
        Whether `value` is a momentum [kg m/s, N m s] or a velocity [m/s, rad/s].
    value : ndarray, shape (nv,)
        Momentum or velocity at the end.
    rate_active : ndarray of bool, shape (nv,)
        Which components of `value` are asked for.
    a : ndarray, shape (nv,), optional
        Accelerations at the end [m/s^2, rad/s^2]: the mean of the last step, or where jerks are limited what
        that may become in half a step.
    a_active : ndarray of bool, shape (nv,), optional
        Which components of `a` are asked for; default: none, or all that are given.
    a_rule : {"given", "free", "rest"}
        Why: as it is ``given``; or nothing is asked for, and all shall be ``free``; or a `Problem` asks for
        a = 0 of the joints that stop, since their jerk is limited: ``rest``, see
        `mbocp.problem.goals.end_conditions`.
    u : EndControl
        Controls after the end: limits of their rates lead to these.
    frames : tuple of FrameGoal
        Poses and velocities of frames. Where they ask for a pose, entries of `q` that are not active hold a
        configuration at it, one near the start; see `mbocp.problem.goals.frames`.
    enforce : {"exact", "penalty", "both", "none"}
        ``exact``: gamma = 1, null-space projected where the system has constraints, Eq. (14);
        ``penalty``: gamma = 0, the terminal cost draws the end to the goal, Eq. (9); ``both``; or
        ``none``: the goal is at most the target of the tracking cost.
    guard : bool
        For explicit schemes: keep rotations at the end within a right angle of the goal,
        tr(R_d^T R) >= 1 and cos >= 0. The projected end condition also admits half-turns.
    periodic : Periodic, optional
        The end is the start, moved by this symmetry: in the place of `q`, `v` and `p`.
    redundant : {"drop", "keep"}
        For explicit schemes: what becomes of end conditions that the dynamics meet by themselves, such as the
        spin of a symmetric top about its axis. Kept ones make the constraints of the problem dependent.
    """

    q: Array
    q_active: BoolArray
    rate: Rate = "p"
    value: Array
    rate_active: BoolArray
    frames: tuple[FrameGoal, ...] = ()
    enforce: Enforce = "exact"
    guard: bool = True
    redundant: Redundant = "drop"
    periodic: Periodic | None = None
    a: Array = field(default_factory=lambda: frozen_array(np.zeros(0)))
    a_active: BoolArray = field(
        default_factory=lambda: frozen_mask(np.zeros(0, dtype=np.bool_), size=0, name="a")
    )
    a_rule: AccelerationRule = "given"
    q_is_reached: bool = False
    u: EndControl = field(default_factory=EndControl)

    def __post_init__(self) -> None:
        for key, name in (("q", "goal.q"), ("value", f"goal.{self.rate}")):
            array = frozen_array(getattr(self, key), shape=(None,), name=name)
            check_finite(name, array)
            object.__setattr__(self, key, array)
        nv = self.value.size
        object.__setattr__(self, "q_active", frozen_mask(self.q_active, size=nv, name="goal.q_active"))
        object.__setattr__(
            self, "rate_active", frozen_mask(self.rate_active, size=nv, name="goal.rate_active")
        )
        self._take_accelerations(nv)
        object.__setattr__(self, "frames", tuple(self.frames))
        check_choice("goal.enforce", self.enforce, ENFORCE)
        check_choice("goal.rate", self.rate, RATES)
        check_choice("goal.redundant", self.redundant, REDUNDANT)
        check_bool("goal.guard", self.guard)
        self._check_periodic()
        for frame in self.frames:
            if frame.has_tolerance and not self.is_exact:
                raise ProblemError(
                    f'goal.frame {frame.name!r}: a tolerance is for enforce = "exact" or "both", got '
                    f'"{self.enforce}"; leave it out, or take one of them'
                )
        if self.enforce != "none" and self.is_empty:
            raise ProblemError(
                f'goal: enforce = "{self.enforce}" needs something to enforce; give q or frame, and v or '
                'p for the end velocity, or say enforce = "none"'
            )

    def _check_periodic(self) -> None:
        """Refuse other words for the end beside a periodic motion, and a cost in its place."""
        if self.periodic is None:
            return
        if self.enforce != "exact":
            raise ProblemError(
                f'goal.periodic: is an end condition, for enforce = "exact", got "{self.enforce}"; leave '
                "it out, or take that"
            )
        if self.q_active.any() or self.rate_active.any():
            key = "q" if self.q_active.any() else self.rate
            raise ProblemError(
                f"goal.periodic: says what q and v are at the end, and goal.{key} does, too; give them in "
                "[start], or leave one of the two out"
            )

    def _take_accelerations(self, nv: int) -> None:
        asked = np.asarray(self.a)
        a = frozen_array(asked if asked.size else np.zeros(nv), shape=(nv,), name="goal.a")
        check_finite("goal.a", a)
        mask = np.asarray(self.a_active)
        mask = mask if mask.size else np.full(nv, asked.size > 0)
        check_choice("goal.a_rule", self.a_rule, RULES)
        if self.a_rule == "rest" and not self.is_exact:  # follows from an exact end, and goes with it
            mask = np.zeros(nv, dtype=np.bool_)
        object.__setattr__(self, "a", a)
        object.__setattr__(self, "a_active", frozen_mask(mask, size=nv, name="goal.a_active"))
        if self.a_active.any() and not self.is_exact:
            raise ProblemError(
                f'goal.a: is an end condition, for enforce = "exact" or "both", got "{self.enforce}"; leave '
                "it out, or take one of them"
            )

    @property
    def is_empty(self) -> bool:
        """Whether nothing at all is asked for."""
        says = (self.q_active, self.rate_active, self.a_active)
        return not (any(mask.any() for mask in says) or self.frames or self.periodic is not None)

    @property
    def says_where(self) -> bool:
        """Whether something is asked of the configuration, so that `q` is one of those at the end."""
        return bool(self.q_active.any() or self.poses or self.periodic is not None)

    @property
    def poses(self) -> tuple[FrameGoal, ...]:
        """Goals of frames that ask for a pose, or a part of one."""
        return tuple(frame for frame in self.frames if frame.has_pose)

    @property
    def conditions(self) -> tuple[FrameGoal, ...]:
        """Goals of frames without what has a tolerance."""
        return tuple(exact for frame in self.frames if (exact := frame.conditions) is not None)

    @property
    def is_exact(self) -> bool:
        """Whether gamma = 1: an end condition with a multiplier eta."""
        return self.enforce in ("exact", "both")

    @property
    def is_penalised(self) -> bool:
        """Whether the terminal cost acts."""
        return self.enforce in ("penalty", "both")

    def check_dimensions(self, nq: int, nv: int) -> None:
        """Refuse arrays that do not fit a robot with `nq` and `nv`."""
        if self.q.shape != (nq,):
            raise DimensionMismatch("goal.q", self.q.shape, (nq,))
        if self.value.shape != (nv,):
            raise DimensionMismatch(f"goal.{self.rate}", self.value.shape, (nv,))


def of_member(place: int) -> AbstractContextManager[None]:
    """Name the member in every error from the block that names the goal."""
    return reword_errors(partial(_name, place))


def check_goals(goals: Sequence[Goal]) -> None:
    """Refuse members that ask for nothing, and penalties that do not weigh the same of all."""
    for place, goal in enumerate(goals):
        if goal.enforce == "none":
            raise ProblemError(
                f"goal.any.{place}: asks for nothing, so that it would be the best; give q, v, p or frame"
            )
    if any(goal.is_penalised for goal in goals):
        first = goals[0]
        for place, goal in enumerate(goals):
            masks = ((goal.q_active, first.q_active), (goal.rate_active, first.rate_active))
            if goal.rate != first.rate or not all(np.array_equal(*pair) for pair in masks):
                raise ProblemError(
                    f"goal.any.{place}: gives other components of q, v or p than goal.any.0, and "
                    "cost.terminal weighs the same of all; give the same ones, or say enforce = "
                    '"exact"'
                )


def reachable_members(goals: Sequence[Goal], resolve: Callable[[Goal], P]) -> tuple[tuple[int, P], ...]:
    """Place and problem of each goal that is not out of reach; the others are left out with a warning.

    Parameters
    ----------
    goals : sequence of Goal
    resolve : callable
        Makes the problem of one of them.

    Raises
    ------
    UnreachableGoal
        If all are out of reach.
    """
    check_goals(goals)
    found: list[tuple[int, P]] = []
    refused: list[UnreachableGoal] = []
    told: dict[str, type[Warning]] = {}
    for place, goal in enumerate(goals):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                with of_member(place):
                    found.append((place, resolve(goal)))
            except UnreachableGoal as error:
                if not str(error).startswith("goal"):
                    raise  # a via point
                refused.append(error)
                told[f"{error}; this goal is left out"] = ProblemWarning
        told |= {_name(place, str(entry.message)): entry.category for entry in caught}
    if not found:
        raise UnreachableGoal(
            f"goal.any: all {len(goals)} goals are out of reach; {'; '.join(map(str, refused))}"
        ) from refused[0]
    for message, category in told.items():
        warn_caller(message, category)
    return tuple(found)


def _name(place: int, message: str) -> str:
    return message.replace("goal", f"goal.any.{place}", 1) if message.startswith("goal") else message
