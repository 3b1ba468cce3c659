"""The cost: weights and target of the running and of the terminal cost, and weights that suit a motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, dataclass, frozen_array
from mbocp.exceptions import DimensionMismatch, InvalidValue, ProblemError, suggest
from mbocp.problem._checks import check_finite, check_non_negative, check_number
from mbocp.robot import Robot
from mbocp.robot.large import make_working_data
from mbocp.terms.cost import RunningCost, WeightedCost
from mbocp.terms.kinds import COST_TERMS, EffortAboutGravity, Energy

_BEND = 0.7  # of every joint [rad, m]
_SHARE = 0.1  # of the weight with which a radian in the whole time costs as much as the largest force


@dataclass(frozen=True, kw_only=True, eq=False)
class Cost:
    r"""Weights and targets of Eqs. (7) to (9) of [Bijalwan2025]_, and of eq. (33) of [Manara2017]_.

    .. math::
        \mathcal{L}(y, u) &= \tfrac{\beta}{2} (y - y_d)^T Q (y - y_d) + \tfrac{1}{2} u^T \alpha u
            + \tfrac{1}{2} v^T W v + \tfrac{1}{2} \dot u^T C \dot u + \kappa V(q)   \\
        \psi(y_N) &= \tfrac{1}{2} (y_N - y_T)^T Q_T (y_N - y_T)

    Differences of configurations are taken in the tangent space of the robot's joints, so that every
    weight belongs to one of the `nv` directions of `q` or to one of the `nv` components of `p`. The terminal
    cost draws the end to the goal; if the goal is written with a velocity, its part of :math:`Q_T` is on `v`.

    The weight of the velocities is not in the papers. It is customary for robots: links of little inertia
    cost no effort to spin, and without it an optimum may turn them faster than the steps resolve. The last
    two terms are the second paper's, with :math:`C = 2 k_3` and :math:`\kappa = -k_2`. Controls are constant
    in each step; their rate is the difference of two neighbours over the length of a step, at the N - 1 nodes
    between steps.

    Attributes
    ----------
    effort : ndarray, shape (nu,)
        :math:`\alpha` >= 0, the weight of each control, or one number for all. Zero leaves a control
        undetermined unless it has a `control_rate` or limits.
    tracking : float
        :math:`\beta` >= 0, the weight of the running distance from the target.
    tracking_weights : ndarray, shape (2 nv,)
        Diagonal of Q on (q, p).
    target_q : ndarray, shape (nq,) or (N, nq)
        Configuration to track; row n - 1 of a trajectory belongs to the end of step n.
    target_p : ndarray, shape (nv,) or (N, nv)
        Momentum to track [kg m/s, N m s].
    velocity : ndarray, shape (nv,)
        Diagonal of W >= 0 on the velocities v, given by one number for all, too; zero by default.
    control_rate : ndarray, shape (nu,)
        Diagonal of C >= 0 on the rates of the controls, or one number for all; zero by default [s^2].
    potential : float
        :math:`\kappa`, of any sign: the weight of the potential energy V of gravity and force elements
        [1/J].
    terminal : float
        :math:`\beta_T` >= 0, the weight of the terminal cost.
    terminal_weights : ndarray, shape (2 nv,)
        Diagonal of :math:`Q_T` on (q, p), or on (q, v) if the goal gives a velocity.
    further : mapping of str to ndarray
        Weights of all other terms of `mbocp.terms.kinds.COST_TERMS` by name; those left out are zero.
    """

    effort: Array
    tracking: float
    tracking_weights: Array
    target_q: Array
    target_p: Array
    terminal: float
    terminal_weights: Array
    velocity: Array = field(default_factory=lambda: frozen_array(0.0))
    control_rate: Array = field(default_factory=lambda: frozen_array(0.0))
    potential: float = 0.0
    further: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for key in ("tracking", "terminal", "potential"):
            object.__setattr__(self, key, check_number(f"cost.{key}", getattr(self, key)))
        check_non_negative("cost.tracking", self.tracking)
        check_non_negative("cost.terminal", self.terminal)
        for key, name in _ARRAYS.items():
            value = frozen_array(getattr(self, key), name=name)
            check_finite(name, value)
            object.__setattr__(self, key, value)
        if self.velocity.ndim == 0:
            each = np.full(len(self.tracking_weights) // 2, self.velocity)
            object.__setattr__(self, "velocity", frozen_array(each))
        check_non_negative("cost.tracking_weights", self.tracking_weights)
        check_non_negative("cost.terminal_weights", self.terminal_weights)
        for key in ("velocity", *_ON_CONTROLS):
            check_non_negative(f"cost.{key}", getattr(self, key))
        object.__setattr__(self, "further", _check_weights(self.further))

    @property
    def is_trajectory(self) -> bool:
        """Whether the target of the running cost moves."""
        return bool(self.target_q.ndim == 2 or self.target_p.ndim == 2)

    def weight(self, key: str) -> Any:
        """Value of a field, or weights of a further term: zero where there is none."""
        if key in self.__dataclass_fields__:
            return getattr(self, key)
        return self.further.get(key, 0.0)

    @property
    def on_squares(self) -> Array:
        """Weights of half the squares of the controls: those of efforts, and losses of motors."""
        about_gravity = np.asarray(self.weight(EffortAboutGravity.key))
        return self.effort + about_gravity + 2.0 * Energy.losses_of(self)

    def with_weights(self, weights: Mapping[str, Any]) -> Cost:
        """The same with other weights, by their key in `[cost]`."""
        own = {key: value for key, value in weights.items() if key in self.__dataclass_fields__}
        more = {key: value for key, value in weights.items() if key not in own}
        if "potential" in own:
            own["potential"] = float(own["potential"])
        return replace(self, **own, further={**self.further, **more}) if weights else self

    def check_dimensions(self, nq: int, nv: int, num_steps: int) -> None:
        """Refuse arrays that do not fit a robot with `nq`, `nv` and a horizon of `num_steps`."""
        for key in ("tracking_weights", "terminal_weights"):
            if getattr(self, key).shape != (2 * nv,):
                raise DimensionMismatch(_file_key(key), getattr(self, key).shape, (2 * nv,), "on (q, p)")
        if self.velocity.shape != (nv,):
            raise DimensionMismatch("cost.velocity", self.velocity.shape, (nv,))
        for key, term in further_terms().items():
            weights = np.asarray(self.weight(key))
            if term.over == "v" and weights.shape not in ((), (nv,)):
                raise DimensionMismatch(f"cost.{key}", weights.shape, (nv,))
        for key, size in (("target_q", nq), ("target_p", nv)):
            shape = getattr(self, key).shape
            if shape not in ((size,), (num_steps, size)):
                hint = f"or ({num_steps}, {size}) for a trajectory with one row a step"
                raise DimensionMismatch(_file_key(key), shape, (size,), hint)

    def targets(self, num_steps: int) -> tuple[Array, Array]:
        """Return the target for every step, shapes (N, nq) and (N, nv)."""
        return (
            np.broadcast_to(self.target_q, (num_steps, self.target_q.shape[-1])),
            np.broadcast_to(self.target_p, (num_steps, self.target_p.shape[-1])),
        )

    def on_controls(self, nu: int) -> Cost:
        """Return the same with a weight for each of `nu` controls where one number stood for all."""
        for key in (*_ON_CONTROLS, *(key for key in self.further if further_terms()[key].over == "u")):
            shape = self.weight(key).shape
            if shape not in ((), (nu,)):
                raise DimensionMismatch(f"cost.{key}", shape, (nu,), "one weight for each control")
        spread: dict[str, Any] = {key: np.broadcast_to(getattr(self, key), (nu,)) for key in _ON_CONTROLS}
        return replace(self, **spread)

    def check_controls(self, bounded: BoolArray, names: Sequence[str]) -> None:
        """Refuse controls that nothing determines: without effort, rate and, as `bounded` says, limits."""
        free = (self.on_squares == 0.0) & (self.control_rate == 0.0) & ~bounded
        if not free.any():
            return
        listed = ", ".join(name for name, is_free in zip(names, free, strict=True) if is_free)
        raise InvalidValue(
            "cost.effort",
            "0.0" if free.all() else f"0.0 for {listed}",
            "a positive number: nothing else in the cost depends on the controls, which would not be "
            "determined; take a small one (1e-6) for nearly free controls, or give cost.control_rate or "
            "[limits]",
        )


def _file_key(name: str) -> str:
    return "cost." + name.replace("target_", "target.")


_ON_CONTROLS = ("effort", "control_rate")
_ARRAYS = {  # with their keys
    key: _file_key(key)
    for key in ("tracking_weights", "target_q", "target_p", "terminal_weights", "velocity", *_ON_CONTROLS)
}


@cache
def further_terms() -> dict[str, type[RunningCost]]:
    """Terms by name whose weights are no field of `Cost`."""
    return {
        term.key: term
        for term in COST_TERMS
        if issubclass(term, RunningCost) and term.key not in Cost.__dataclass_fields__
    }


@cache
def weights_by_key() -> dict[str, type[WeightedCost]]:
    """All terms that have nothing but weights, by their key in `[cost]`."""
    return {term.key: term for term in COST_TERMS if issubclass(term, WeightedCost)}


def _check_weights(further: Mapping[str, Any]) -> dict[str, Array]:
    """Weights of further terms as arrays; those that are zero are left out."""
    known, found = further_terms(), {}
    for key, value in further.items():
        if key not in known:
            raise ProblemError(f"cost.{key}: there is no such term: {suggest(key, known)}")
        weights = frozen_array(value, name=f"cost.{key}")
        check_finite(f"cost.{key}", weights)
        if not known[key].is_signed:
            check_non_negative(f"cost.{key}", weights)
        if weights.any():
            found[key] = weights
    return found


def typical_force(
    robot: Robot, q_start: Array, v_start: Array, q_goal: Array, is_asked: BoolArray, duration: float
) -> float:
    """Largest generalised force that gravity, or a motion from start to goal, takes [N, N m].

    Gravity is looked at in a bent pose, too: a pendulum that hangs takes none.

    Parameters
    ----------
    robot : Robot
    q_start, q_goal : ndarray, shape (nq,)
    v_start : ndarray, shape (nv,)
    is_asked : ndarray of bool, shape (nv,)
        Directions in which `q_goal` is where the motion goes.
    duration : float
        [s]
    """
    T = duration
    away = np.where(is_asked, np.abs(robot.difference(q_start, q_goal)), 0.0)
    accelerations = np.maximum(4.0 * away / T**2, np.abs(v_start) / T)
    data, still = make_working_data(robot.model), np.zeros(robot.nv)
    found = 0.0
    bent = robot.integrate(q_start, np.full(robot.nv, _BEND))
    for q in (q_start, np.asarray(q_goal), np.asarray(bent)):
        gravity = np.array(pin.rnea(robot.model, data, q, still, still))
        inertia = np.array(pin.rnea(robot.model, data, q, still, accelerations)) - gravity
        found = max(found, float(np.abs(gravity).max()), float(np.abs(inertia).max()))
    return found


def velocity_weight(robot: Robot, force: float, duration: float) -> Array:
    r"""Weight of each velocity, `cost.velocity = "auto"`, shape (nv,).

    .. math:: W = \tfrac{1}{10} F^2 T^2

    with the typical force F and the duration T. A detour of a radian then costs a tenth of what the largest
    force costs that is held all the time. So light links do not spin, heavy ones still save effort. Robots
    whose drives prescribe velocities get none: their controls are weighed already.
    """
    if robot.drives:
        return np.zeros(robot.nv)
    return np.full(robot.nv, _SHARE * (force * duration) ** 2)
