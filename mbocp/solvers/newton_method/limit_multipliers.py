r"""Limits in Newton's method: a primal-dual barrier, [Waechter2006]_.

Every limit has a slack, which a logarithm of weight mu in the cost keeps between its bounds, and multipliers
of its own. The kernel eliminates them from the linear system, so that a step costs what it does without
limits, and says how large mu is (`newton.hpp`, `centring.hpp`). Here is where slacks and multipliers begin.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.exceptions import ProblemError
from mbocp.programme import StagewiseProgramme
from mbocp.programme.evaluation import call
from mbocp.programme.iterate import BoundMultipliers, Iterate
from mbocp.programme.kernel import kernel_programme
from mbocp.solvers.newton_method.newton import first_augmentation

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelNewton, KernelNewtonState, KernelProgramme

_ANY = 1.0  # barrier parameter, before it is known
_NONE = 1e-30  # the same, far below any product of a multiplier and its distance
_WARM_FACTOR, _WARM_MARGIN = 0.1, 1e-3  # of the barrier, and of the slacks, where multipliers are known
_REST_PART = 0.1  # of the mean product: 1 takes a little longer, 0.02 is in vain at times
_REST_MARGIN = 2.5e-3  # of the range between bounds, that slacks are inside, or first steps are short
_GRAIN = 8 * 2.0**-52  # of a bound: distances below it are round-off


def begin(
    newton: KernelNewton, programme: StagewiseProgramme, iterate: Iterate, threads: int = 1
) -> KernelNewtonState:
    """State at an iterate, and with a barrier if there are limits; threads share the stages.

    With the multipliers of a solution it goes on there, with the last barrier; with those of the rest of a
    motion with one that is as large as these are wrong there: between nodes, and a little beside the motion.

    Raises
    ------
    ProblemError
        If there are limits that the barrier cannot keep.
    """
    augmentation, native = first_augmentation(programme), _load(programme, iterate, threads)
    if iterate.bounds is None or not _has_limits(programme):
        return newton.begin(native, augmentation)
    for is_centred in (True, False):
        state = _resume(newton, native, programme, iterate, is_centred=is_centred)
        if newton.is_near(state):
            return state
    if iterate.is_rest:
        return _resume(newton, native, programme, iterate, is_centred=True, is_rest=True)
    barrier = _WARM_FACTOR * native.first_barrier()
    _start_warm(native, programme, iterate.bounds, barrier)
    return newton.resume(native, augmentation, barrier, is_free=barrier > 0.0)


def resume(
    newton: KernelNewton, programme: StagewiseProgramme, iterate: Iterate, *, is_centred: bool
) -> KernelNewtonState:
    """State at a solution, or near one, with the iterate's own multipliers and the last barrier.

    The slacks are where the rows are. With `is_centred` those that are too close to their bounds, and
    multipliers that are too small, are raised until no product of the two is below the barrier parameter: a
    Newton step makes up for that, and has room. Without, the state's residual is what the iterate leaves.

    Raises
    ------
    ProblemError
        If there are limits that the barrier cannot keep.
    """
    return _resume(newton, _load(programme, iterate), programme, iterate, is_centred=is_centred)


def _resume(
    newton: KernelNewton,
    native: KernelProgramme,
    programme: StagewiseProgramme,
    iterate: Iterate,
    *,
    is_centred: bool,
    is_rest: bool = False,
) -> KernelNewtonState:
    """The same, of a kernel programme that has the iterate.

    With `is_rest` the barrier is a part of the mean product of multipliers and distances, if that is larger.
    """
    barrier = 0.0
    if _has_limits(programme):
        barrier = newton.last_barrier(native)
        rows = _take_multipliers(native, programme, iterate, barrier)
        if is_rest:
            barrier = max(barrier, _REST_PART * _mean_product(native, rows))
            _take_multipliers(native, programme, iterate, barrier)
            native.slack = rows.inside(native.slack, _REST_MARGIN)
        if is_centred:
            _centre(native, rows, barrier)
        else:
            _drop_idle(native, rows)
    return newton.resume(native, first_augmentation(programme), barrier, is_free=False)


def at_solution(programme: StagewiseProgramme, iterate: Iterate) -> KernelProgramme:
    """Kernel programme at a solution, with its distances from limits and the multipliers of these.

    Raises
    ------
    ProblemError
        If there are limits that the barrier cannot keep.
    """
    native = _load(programme, iterate)
    if _has_limits(programme):
        _centre(native, _take_multipliers(native, programme, iterate, _NONE), _NONE)
    return native


def _take_multipliers(
    native: KernelProgramme, programme: StagewiseProgramme, iterate: Iterate, barrier: float
) -> _Rows:
    """Slacks where the rows are, and the multipliers that an iterate has."""
    rows = _Rows.of(programme)
    native.start_limits(barrier, 0.0)
    bounds = iterate.bounds
    known = np.zeros(rows.lower.size) if bounds is None else multipliers_in_rows(bounds, programme)
    native.z_lower = np.where(rows.is_equation, 0.0, np.maximum(-known, 0.0))
    native.z_upper = np.where(rows.is_equation, known, np.maximum(known, 0.0))
    return rows


def warm_barrier(
    programme: StagewiseProgramme, iterate: Iterate, barrier_of: Callable[[float, int], float]
) -> KernelProgramme:
    """Kernel programme at a solution with a larger barrier: slacks inside, multipliers of it at least.

    `barrier_of` is (cost, number of limits) -> barrier parameter. Without limits there is none.

    Raises
    ------
    ProblemError
        If there are limits that the barrier cannot keep.
    """
    native = _load(programme, iterate)
    if not _has_limits(programme):
        return native
    native.start_limits(_ANY, _WARM_MARGIN)
    barrier = barrier_of(native.evaluate().cost, native.num_limits)
    if iterate.bounds is None:
        native.start_limits(barrier, _WARM_MARGIN)
    else:
        _start_warm(native, programme, iterate.bounds, barrier)
    return native


def _start_warm(
    native: KernelProgramme, programme: StagewiseProgramme, bounds: BoundMultipliers, barrier: float
) -> None:
    """Slacks a little inside, and known multipliers where they are above those of the barrier."""
    rows, known = _Rows.of(programme), multipliers_in_rows(bounds, programme)
    native.start_limits(barrier, _WARM_MARGIN)
    native.z_lower = np.where(rows.is_equation, 0.0, np.maximum(native.z_lower, -known))
    native.z_upper = np.where(rows.is_equation, known, np.maximum(native.z_upper, known))


def largest_product(native: KernelProgramme, programme: StagewiseProgramme) -> float:
    """Of the multipliers of limits and the distances from them."""
    if not native.num_limits:
        return 0.0
    return float(max(np.abs(products).max() for products in _products(native, _Rows.of(programme))))


def _mean_product(native: KernelProgramme, rows: _Rows) -> float:
    """Of the multipliers of limits and the distances inside them."""
    products, sides = np.concatenate(_products(native, rows)), np.isfinite([rows.lower, rows.upper]).sum()
    return float(products.clip(0.0).sum() / max(sides, 1))


def _products(native: KernelProgramme, rows: _Rows) -> tuple[Array, Array]:
    """Of multipliers and distances, of lower and of upper limits; 0 where there are none."""
    lower, upper = rows.lower, rows.upper
    of_lower = native.z_lower * np.where(np.isfinite(lower), native.slack - lower, 0.0)
    of_upper = native.z_upper * np.where(np.isfinite(upper), upper - native.slack, 0.0)
    return of_lower, of_upper


def _drop_idle(native: KernelProgramme, rows: _Rows) -> None:
    """Leave out multipliers whose limit is farther than 1: less is left over without them."""
    is_far = rows.upper - native.slack > 1.0
    native.z_lower = np.where(native.slack - rows.lower > 1.0, 0.0, native.z_lower)
    native.z_upper = np.where(is_far & ~rows.is_equation, 0.0, native.z_upper)


def _centre(native: KernelProgramme, rows: _Rows, barrier: float) -> None:
    """Raise multipliers to the root of mu at most, and distances, until no product of them is below mu."""
    lower, upper = rows.lower, rows.upper
    slack, room = native.slack, 0.5 * (upper - lower)
    for side, name, inwards in ((lower, "z_lower", 1.0), (upper, "z_upper", -1.0)):
        is_limited = np.isfinite(side)
        grain = _GRAIN * np.maximum(1.0, np.abs(side))
        distance = np.where(is_limited, np.maximum(inwards * (slack - side), grain), 1.0)
        least = np.minimum(barrier / distance, math.sqrt(barrier))
        z = np.maximum(getattr(native, name), least)
        moved = side + inwards * np.maximum(distance, np.minimum(barrier / z, room))
        slack = np.where(is_limited, moved, slack)
        unlimited = np.where(rows.is_equation, getattr(native, name), 0.0)
        setattr(native, name, np.where(is_limited, z, unlimited))
    native.slack = slack


@dataclass(frozen=True, eq=False)
class _Rows:
    """The kernel's rows of limits.

    Attributes
    ----------
    lower, upper : ndarray, shape (num_limits,)
        Sides; infinite for equations.
    is_equation : ndarray of bool, shape (num_limits,)
    """

    lower: Array
    upper: Array
    is_equation: BoolArray

    @classmethod
    def of(cls, programme: StagewiseProgramme) -> _Rows:
        limited, guard = programme.bounds.has_limit, np.zeros(programme.num_guards)
        lower = np.concatenate([programme.bounds.lower[limited], guard])
        upper = np.concatenate([programme.bounds.upper[limited], guard + np.inf])
        is_equation = lower == upper
        lower, upper = np.where(is_equation, -np.inf, lower), np.where(is_equation, np.inf, upper)
        return cls(lower, upper, is_equation)

    def inside(self, slack: Array, margin: float) -> Array:
        """Slacks that are a part of the range between their sides inside, or of the size of the only one."""
        lower, upper = self.lower, self.upper
        side = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper, 0.0))
        size = np.maximum(1.0, np.abs(side))
        room = margin * np.where(np.isfinite(upper - lower), upper - lower, size)
        return np.where(self.is_equation, slack, np.clip(slack, lower + room, upper - room))


def _has_limits(programme: StagewiseProgramme) -> bool:
    return bool(programme.num_guards) or not programme.bounds.is_empty


def _load(programme: StagewiseProgramme, iterate: Iterate, threads: int = 1) -> KernelProgramme:
    """Kernel programme with its limits, if there are any, at an iterate."""
    iterate.check(programme)
    has_limits = _has_limits(programme)
    reason = explain_limits_not_kept(programme) if has_limits else None
    if reason:
        raise ProblemError(f'solver.method: "monolithic" {reason}; take "ipopt" or "fatrop"')
    native = kernel_programme(programme, has_limits=has_limits, threads=threads)
    iterate.load_into(native)
    return native


def explain_limits_not_kept(programme: StagewiseProgramme) -> str | None:
    """Message about limits that the barrier cannot keep, or None."""
    if not programme.kind.groups:
        return None
    bounds = programme.bounds
    has_states = np.isfinite([bounds.x_lower, bounds.x_upper]).any()
    if bounds.nh or has_states or programme.num_guards:
        return "keeps no path constraints in natural coordinates"
    return None


def compute_bounded_values(programme: StagewiseProgramme, iterate: Iterate) -> Array:
    """States, controls and path functions of an iterate, shape (N, nx + nu + nh)."""
    parts, nh = [iterate.xs[1:], iterate.us], programme.bounds.nh
    if nh:
        given = [*parts, programme.theta]
        parts.append(call(programme.functions, "path_values", programme.num_steps, given)[0].dense(nh))
    return np.hstack(parts)


def multipliers_in_rows(bounds: BoundMultipliers, programme: StagewiseProgramme) -> Array:
    """Multipliers in the order of the kernel's rows."""
    of_steps = np.hstack([bounds.xs[1:], bounds.us, bounds.path])
    return np.concatenate([of_steps[programme.bounds.has_limit], bounds.guard])


def multipliers_of(native: KernelProgramme, programme: StagewiseProgramme) -> BoundMultipliers:
    """Multipliers of the limits that a kernel programme holds."""
    bounds, kind, found = programme.bounds, programme.kind, native.limit_multipliers
    limited = bounds.has_limit
    of_steps, rows = np.zeros(limited.shape), found.size - programme.num_guards
    of_steps[limited] = found[:rows]
    xs, us, path = np.split(of_steps, [kind.nx, kind.nx + kind.nu], axis=1)
    xs = np.vstack([np.zeros((1, kind.nx)), xs])
    return BoundMultipliers(xs=xs, us=us, path=path, guard=found[rows:])
