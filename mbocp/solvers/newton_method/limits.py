r"""Limits in Newton's method: a primal-dual barrier, [Waechter2006]_.

Every limit has a slack, which a logarithm of weight mu in the cost keeps between its bounds, and multipliers
of its own. The kernel eliminates them from the linear system, so that a step costs what it does without
limits. Here is how large mu is. Steps choose it by prediction while that goes well, see
`mbocp.solvers.newton_method.centring`. Else it falls as soon as the conditions of the barrier problem hold to
a multiple of it: far where that takes few iterations, and less far, but earlier, where it takes many.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.exceptions import ProblemError
from mbocp.programme import StagewiseProgramme
from mbocp.programme.iterate import BoundMultipliers, Iterate
from mbocp.programme.kernel import kernel_programme
from mbocp.solvers.newton_method.centring import Centring, aimed_barrier, may_correct
from mbocp.solvers.newton_method.newton import NewtonState, first_filter, new_state, start
from mbocp.solvers.tolerances import SOLVER_TOLERANCE

if TYPE_CHECKING:
    from mbocp.programme.native import Evaluation, KernelDirection, KernelFilter, KernelProgramme

_BARRIER_BY_COST = 0.1  # initial sum of mu over all limits, by the cost of the guess ...
_MIN_BARRIER, _MAX_BARRIER = 1e-5, 1.0  # ... within these
_MARGIN = 0.1  # first distance of a slack from its bounds, relative to them and to their gap
_WARM_FACTOR, _WARM_MARGIN = 0.1, 1e-3  # of the barrier, and of the slacks, where multipliers are known
_SLOW = 12  # iterations with one mu, after which it falls earlier, and less
_GRAIN = 8 * 2.0**-52  # of a bound: distances below it are round-off
_SHARE = 0.1  # of the tolerance, for what multipliers times distances come to in the end
_NEARLY = 100.0  # tolerances: with a residual below them the last barrier parameter is taken
_RAISE = 10.0  # from one last barrier to the next


def init_barrier(
    programme: StagewiseProgramme,
    iterate: Iterate,
    tolerance: float = SOLVER_TOLERANCE,
    threads: int = 1,
) -> NewtonState:
    """State at an iterate, evaluated, and with a barrier if there are limits; threads share the stages.

    With the multipliers of a solution it goes on there, with the last barrier.

    Raises
    ------
    ProblemError
        If there are limits that the barrier cannot keep.
    """
    if not _has_limits(programme):
        return start(programme, iterate, threads)
    if iterate.bounds is not None:
        state = resume(programme, iterate, tolerance, is_centred=True, threads=threads)
        if state.evaluation.residual <= _NEARLY * tolerance:
            return state
    native = _load(programme, iterate, threads)
    native.start_limits(_MIN_BARRIER, _MARGIN)
    barrier = _first_barrier(native)
    if iterate.bounds is None:
        native.start_limits(barrier, _MARGIN)
    else:
        barrier *= _WARM_FACTOR
        _start_warm(native, programme, iterate.bounds, barrier)
    state = new_state(programme, native, native.evaluate())._replace(barrier=barrier)
    return state._replace(centring=Centring(barrier, state.filter)) if barrier else state


def resume(
    programme: StagewiseProgramme, iterate: Iterate, tolerance: float, *, is_centred: bool, threads: int = 1
) -> NewtonState:
    """State at a solution, or near one, with the iterate's own multipliers and the last barrier.

    The slacks are where the rows are. With `is_centred` those that are too close to their bounds, and
    multipliers that are too small, are raised until no product of the two is below the barrier parameter: a
    Newton step makes up for that, and has room. Without, the state's residual is what the iterate leaves.

    Raises
    ------
    ProblemError
        If there are limits that the barrier cannot keep.
    """
    if not _has_limits(programme):
        return start(programme, iterate, threads)
    native, rows = _load(programme, iterate, threads), _Rows.of(programme)
    barrier = _last_barrier(native, tolerance)
    native.start_limits(barrier, 0.0)
    known = (
        np.zeros(native.slack.size)
        if iterate.bounds is None
        else multipliers_in_rows(iterate.bounds, programme)
    )
    native.z_lower = np.where(rows.is_equation, 0.0, np.maximum(-known, 0.0))
    native.z_upper = np.where(rows.is_equation, known, np.maximum(known, 0.0))
    if is_centred:
        _centre(native, rows, barrier)
    else:
        _drop_idle(native, rows)
    return new_state(programme, native, native.evaluate())._replace(barrier=barrier)


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
    if not _has_limits(programme):
        return start(programme, iterate).native
    native = _load(programme, iterate)
    native.start_limits(_MIN_BARRIER, _WARM_MARGIN)
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
    rows = _Rows.of(programme)
    lower, upper = rows.lower, rows.upper
    of_lower = native.z_lower * np.where(np.isfinite(lower), native.slack - lower, 0.0)
    of_upper = native.z_upper * np.where(np.isfinite(upper), upper - native.slack, 0.0)
    return float(max(np.abs(of_lower).max(), np.abs(of_upper).max()))


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
        limited, guard = programme.bounds.limited, np.zeros(programme.num_guards)
        lower = np.concatenate([programme.bounds.lower[limited], guard])
        upper = np.concatenate([programme.bounds.upper[limited], guard + np.inf])
        is_equation = lower == upper
        lower, upper = np.where(is_equation, -np.inf, lower), np.where(is_equation, np.inf, upper)
        return cls(lower, upper, is_equation)


def _first_barrier(native: KernelProgramme) -> float:
    """Barrier parameter of a guess; 0: there are equations alone."""
    if not native.num_limits:
        return 0.0
    barrier = _BARRIER_BY_COST * abs(native.evaluate().cost) / native.num_limits
    return min(max(barrier, _MIN_BARRIER), _MAX_BARRIER) if math.isfinite(barrier) else _MAX_BARRIER


def _last_barrier(native: KernelProgramme, tolerance: float) -> float:
    return _SHARE * tolerance / math.sqrt(max(1, native.num_limits))


def _last_of(state: NewtonState, tolerance: float) -> float:
    return max(_last_barrier(state.native, tolerance), state.least_barrier)


def _has_limits(programme: StagewiseProgramme) -> bool:
    return bool(programme.num_guards) or not programme.bounds.is_empty


def _load(programme: StagewiseProgramme, iterate: Iterate, threads: int = 1) -> KernelProgramme:
    """Kernel programme with its limits at an iterate."""
    iterate.check(programme)
    reason = why_limits_cannot_be_kept(programme)
    if reason:
        raise ProblemError(f'solver.method: "monolithic" {reason}; take "ipopt" or "fatrop"')
    native = kernel_programme(programme, has_limits=True, threads=threads)
    iterate.load_into(native)
    return native


def why_limits_cannot_be_kept(programme: StagewiseProgramme) -> str | None:
    """Message about limits that the barrier cannot keep, or None."""
    bounds = programme.bounds
    if programme.kind.groups and (bounds.nh or bounds.limited_x.any() or programme.num_guards):
        return "keeps no path constraints in natural coordinates"
    return None


def update_barrier(state: NewtonState, tolerance: float) -> NewtonState:
    """State with the smallest barrier parameter that the iterate allows; a new one starts a new filter.

    Where steps choose it, see `aim_barrier`, that is left to them while they make progress.
    """
    if state.centring is not None and state.reference is None:
        state = _recentre(state, state.centring, tolerance)
        if state.is_free:
            return state
    is_slow = state.iteration - state.barrier_since > _SLOW
    evaluation = state.native.lower_barrier(state.evaluation, _last_of(state, tolerance), is_slow)
    return state if state.native.barrier == state.barrier else _after(state, evaluation)


def _recentre(state: NewtonState, centring: Centring, tolerance: float) -> NewtonState:
    """State with barrier parameters free or fixed, as the last step suggests; a free one may be the last."""
    if state.is_free and not predicts(state, tolerance):
        last = _last_of(state, tolerance)
        if state.barrier == last:
            return state
        return _after(state, state.native.weigh(last), state.filter.without_corners())
    is_newtons = state.regularisation == 0.0 and state.step_length == 1.0 and state.shift == 0.0
    after = centring.update(state.evaluation.residual, state.barrier, is_newtons=is_newtons)
    if after.is_free and not centring.is_free:
        return state._replace(centring=after, filter=after.bounds)
    if centring.is_free and not after.is_free:
        return fix_barrier(state, tolerance)
    return state._replace(centring=after)


def predicts(state: NewtonState, tolerance: float) -> bool:
    """Whether the next step chooses its barrier parameter; with a small residual it is the last one."""
    return state.is_free and state.evaluation.residual > _NEARLY * tolerance


def _with_barrier(state: NewtonState, barrier: float) -> NewtonState:
    return _after(state, state.native.weigh(barrier))


def _after(state: NewtonState, evaluation: Evaluation, cleared: KernelFilter | None = None) -> NewtonState:
    """State after a change of the barrier parameter, which the kernel has."""
    return state._replace(
        barrier=state.native.barrier,
        barrier_since=state.iteration,
        evaluation=evaluation,
        filter=cleared or first_filter(evaluation),
        reference=None,
    )


def fix_barrier(state: NewtonState, tolerance: float) -> NewtonState:
    """State with a barrier parameter that falls by the rule; for good if the first step was in trouble."""
    assert state.centring is not None  # for the type checker: only a free parameter is fixed
    barrier = state.centring.fixed_barrier(state.native.mean_product())
    centring = state.centring.fix() if state.iteration else None
    return _with_barrier(state._replace(centring=centring), max(barrier, _last_of(state, tolerance)))


def aim_barrier(state: NewtonState, tolerance: float) -> tuple[NewtonState, KernelDirection]:
    """State with the barrier parameter that a step without barrier suggests, and the step with that.

    The kernel holds a factorisation, made with no barrier in the right-hand side.
    """
    native, centring, error = state.native, state.centring, state.evaluation.barrier_error
    assert centring is not None  # for the type checker, see `predicts`
    found = native.solve()
    if not found.finite:
        native.aim(state.barrier)
        return state, found
    wanted = aimed_barrier(native.mean_product(), native.mean_product(1.0, found.longest_dual))
    barrier = max(wanted, centring.least_barrier(error), _last_of(state, tolerance))
    evaluation = native.aim(barrier, may_correct(found.longest))
    is_same = barrier == state.barrier
    state = state._replace(
        barrier=barrier,
        barrier_since=state.iteration,
        evaluation=evaluation,
        filter=state.filter if is_same else state.filter.without_corners(),
    )
    return state, native.solve()


def raise_barrier(state: NewtonState, tolerance: float) -> NewtonState:
    """State with a larger last barrier parameter, for one that makes the system singular; or the same state.

    A limit with the multiplier z adds z^2 / mu to the Hessian. Where that is 1e16 times the curvature of a
    small cost, round-off leaves nothing of the latter. The tolerance, relative to a cost above one, is the
    largest last one: each product of a multiplier and its distance is below it, if not all of them together.
    """
    barrier = min(_RAISE * state.barrier, tolerance * max(1.0, abs(state.evaluation.cost)))
    if barrier <= state.barrier:
        return state
    evaluation = state.native.weigh(barrier)
    return state._replace(
        barrier=barrier,
        least_barrier=barrier,
        centring=None,
        evaluation=evaluation,
        filter=first_filter(evaluation),
        reference=None,
    )


def multipliers_in_rows(bounds: BoundMultipliers, programme: StagewiseProgramme) -> Array:
    """Multipliers in the order of the kernel's rows."""
    of_steps = np.hstack([bounds.xs[1:], bounds.us, bounds.path])
    return np.concatenate([of_steps[programme.bounds.limited], bounds.guard])


def multipliers_of(native: KernelProgramme, programme: StagewiseProgramme) -> BoundMultipliers:
    """Multipliers of the limits that a kernel programme holds."""
    bounds, kind, found = programme.bounds, programme.kind, native.limit_multipliers
    limited = bounds.limited
    of_steps, rows = np.zeros(limited.shape), found.size - programme.num_guards
    of_steps[limited] = found[:rows]
    xs, us, path = np.split(of_steps, [kind.nx, kind.nx + kind.nu], axis=1)
    xs = np.vstack([np.zeros((1, kind.nx)), xs])
    return BoundMultipliers(xs=xs, us=us, path=path, guard=found[rows:])
