"""Estimation over a moving horizon: `MovingHorizonEstimator`."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, frozen_array
from mbocp._dataclass import dataclass
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem import Problem
from mbocp.problem._checks import check_integer
from mbocp.programme.native_modules import kernel
from mbocp.receding.estimator_functions import NUM_MOMENTS, EstimatorLayout, load_estimator_functions
from mbocp.receding.kalman import LinearStage, lower_root
from mbocp.receding.status import HorizonStatus
from mbocp.receding.unknowns import unknowns_of, with_payloads
from mbocp.robot import Robot, load_robot
from mbocp.robot.kinematics import difference

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelHorizon, KernelProgramme

_MICROSECOND = 1e-6  # [s]
_TOLERANCE = 1e-9  # of a Gauss-Newton step, in the units of states and noise
_FIRST = 2  # stages before the steps
_UNSEEN = 0.9  # of the standard deviation without any sample: above, samples say next to nothing
_ROUND_OFF = 1e-6  # of the length of a step
_LONGEST = 1e3  # [s] between samples
_GUESSED = 1.0  # standard deviation of the first configuration, where it is not measured [rad, m]
_FAR, _FARTHEST = 1e3, 1.0  # standard deviations and [rad, m] by which a sample is off: above, it is far
_MOST_STEPS, _MOST_ITERATIONS = 10_000, 1_000_000


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is known after a sample. Arrays are copies.

    Attributes
    ----------
    status : HorizonStatus
        As of a receding horizon.
    q : ndarray, shape (nq,)
        Configuration at the time of the sample [m, rad, unit quaternion xyzw].
    v : ndarray, shape (nv,)
        Velocity [m/s, rad/s].
    parameters : dict of str to float
        The unknown constants by name.
    """

    status: HorizonStatus
    q: Array
    v: Array
    parameters: dict[str, float]
    _root: Callable[[], Array]
    _unseen: Array

    @cached_property
    def standard_deviations(self) -> Array:
        """Of q along its tangent, of v, and of the constants, shape (2 nv + constants,).

        Worked out when they are first asked for.
        """
        return frozen_array(np.linalg.norm(self._root(), axis=0))

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviations of the constants by name."""
        of_all = self.standard_deviations[2 * self.v.size :]
        return dict(zip(self.parameters, of_all.tolist(), strict=True))

    @property
    def unobserved(self) -> tuple[str, ...]:
        """Constants that the samples so far say next to nothing of: they are what was assumed."""
        pairs = zip(self.deviations.items(), self._unseen, strict=True)
        return tuple(name for (name, deviation), unseen in pairs if deviation > _UNSEEN * unseen)


class MovingHorizonEstimator:
    r"""State and constants of a robot from the samples of the last moments, at their rate.

    The most likely motion and constants, where samples and torques have independent normal noise:

    .. math::

        \min\; \tfrac12 |x_0 \ominus \bar x|^2_{P^{-1}} + \tfrac12 \sum_n |w_n|^2
        + \tfrac12 \sum_i |q(t_i) \ominus y_i|^2_{\Sigma^{-1}}

    over steps of the mechanics with noise w. The first term is what older samples have left, by a Kalman
    filter's step about the estimate. A sample costs one Gauss-Newton step in one call of the kernel, which
    allocates nothing.

    Parameters
    ----------
    robot : Robot, Problem or str
        Without closed loops and drives. A payload that is to be found is one of its payloads, of any mass.
    horizon : float
        How far it looks back [s].
    steps : int
        Steps of the horizon, motions of constant acceleration. Any number of samples may lie in one.
    measured : mapping
        Standard deviations of samples: `q` along its tangent [rad, m] and, if it is measured, `v`
        [rad/s, m/s]; a number, or one for each component, `inf` for joints that are not measured, which
        begin near the first sample.
    unknowns : mapping of str to float, optional
        Constants to find, with the standard deviation of what the robot has for them:
        `robot.payload.NAME.mass` and `.com`, `robot.damping`, `robot.friction`, and of one joint
        `robot.joint.JOINT.damping` and `.friction`.
    drift : mapping of str to float, optional
        Standard deviation of the change of some of them in a second; 0 by default.
    disturbance : float or array_like, shape (nv,)
        Standard deviation of the impulse of unknown torques in a second [N m s, N s]: torques of s N m that
        are others in each sample of a period T have s sqrt(T).
    speed : float
        Standard deviation of the velocity at the start, where it is not measured [rad/s, m/s].
    iterations : int
        Gauss-Newton steps of a sample, at most.

    Attributes
    ----------
    names : tuple of str
        Of the constants.

    Raises
    ------
    ProblemError, InvalidValue
        For what cannot be estimated.
    """

    def __init__(
        self,
        robot: Robot | Problem | str,
        *,
        horizon: float = 0.2,
        steps: int = 20,
        measured: Mapping[str, Any],
        unknowns: Mapping[str, float] | None = None,
        drift: Mapping[str, float] | None = None,
        disturbance: Any,
        speed: float = 1.0,
        iterations: int = 1,
    ) -> None:
        self._robot = own = _robot_of(robot)
        unknowns, drift = dict(unknowns or {}), dict(drift or {})
        self._unknowns = unknowns_of(own, unknowns)
        self.names = tuple(unknown.name for unknown in self._unknowns)
        _check_words("measured", measured, ("q", "v"))
        _check_words("drift", drift, unknowns)
        if "q" not in measured:
            raise ProblemError("measured.q: missing; give the standard deviation of positions")
        self._iterations = check_integer("iterations", iterations, 1, _MOST_ITERATIONS)
        self._step = _deviations("horizon", horizon, 1)[0] / check_integer("steps", steps, 1, _MOST_STEPS)
        self._sigma = {
            key: _deviations(f"measured.{key}", value, own.nv, most=math.inf)
            for key, value in measured.items()
        }
        _check_whole(own, np.isinf(self._sigma["q"]))
        self._speed = _deviations("speed", speed, 1)[0]
        words = [unknown.group for unknown in self._unknowns]
        prior = [_deviations(f"unknowns.{word}", unknowns[word], 1) for word in words]
        moves = [_deviations(f"drift.{word}", drift.get(word, 0.0), 1, least=0.0) for word in words]
        self._prior, self._drift = np.ravel(prior), np.ravel(moves)
        self._layout = at = EstimatorLayout(own.nq, own.nv, own.nu, len(words))
        self._theta, self._rows = np.zeros(at.num_theta), np.zeros((_FIRST + steps, at.num_rho))
        self._of_all = {name: self._theta[where] for name, where in at.theta.items()}
        self._newest = {name: self._rows[-1, where] for name, where in at.rho.items()}
        for key, sigma in self._sigma.items():
            self._of_all[f"of_{key}"][:] = sigma**-2.0
        self._of_all["disturbance"][:] = _deviations("disturbance", disturbance, own.nv, least=0.0)
        self._of_all["drift"][:] = self._drift
        self._rows[:_FIRST, at.rho["arrives"]] = np.eye(_FIRST)
        self._rows[:, at.rho["reference"]] = own.q0
        self._functions = load_estimator_functions(own, self._unknowns, has_v="v" in measured)
        of = self._functions.stage_function
        self._linear, self._difference, self._retract = of("linear"), of("difference"), of("retract")
        self._programme, self._horizon = self._kernel()
        self._root = self._root_before = np.zeros((at.ndx, at.ndx))  # L of the first step, and of the newest
        self._x = self._start(own.q0, np.zeros(at.nv))  # mean at the first step
        self._u = np.zeros(at.nu)
        self._time = -1.0  # since the first sample; there is none yet
        self._time_far = 0.0  # for which all samples have been far from the estimate

    def update(
        self,
        q: Any,
        u: Any = None,
        *,
        v: Any = None,
        dt: float | None = None,
        iterations: int | None = None,
        time_limit: float | None = None,
    ) -> Estimate:
        """Take a sample and estimate anew. Nothing is raised: see `Estimate.status`.

        Parameters
        ----------
        q : array_like, shape (nq,), or None
            Measured configuration [m, rad, unit quaternion xyzw]; None: this sample was lost.
        u : array_like, shape (nu,), optional
            Controls since the sample before [N, N m]; those of that one by default.
        v : array_like, shape (nv,), optional
            Measured velocity [m/s, rad/s], where `measured` has it.
        dt : float, optional
            Time since the sample before [s]; one step of the horizon by default. The first needs none.
        iterations : int, optional
            Gauss-Newton steps at most, in place of those of the estimator.
        time_limit : float, optional
            Time that the kernel may take [us].
        """
        own, wrong = self._robot, list[str]()
        has_v, is_lost = "v" in self._sigma, q is None
        sample = None if is_lost else self._configuration(q, wrong)
        rate = _numbers("v", v, own.nv, wrong) if has_v and not is_lost else None
        if v is not None and not has_v:
            wrong.append("v: `measured` does not have it")
        if has_v and rate is None:
            sample = None
        given = None if u is None else _numbers("u", u, own.nu, wrong)
        self._u = self._u if given is None else given
        length = min(_time("dt", dt, self._step, wrong) or self._step, _LONGEST)
        if dt == 0:
            wrong.append("dt: got 0, expected the time since the sample before")
        limit = _time("time_limit", time_limit, math.inf, wrong) * _MICROSECOND
        count = self._iterations if iterations is None else iterations
        if not (isinstance(count, int) and 0 <= count <= _MOST_ITERATIONS):
            wrong.append(f"iterations: got {iterations}, expected 0 to {_MOST_ITERATIONS}")
            count = self._iterations
        shift = self._go_on(length, wrong)
        if self._time >= 0.0:
            self._add(sample, rate, length)
        elif sample is None:
            count = 0
            wrong.append("q: the first sample must have it")
        else:
            count = 0
            self._begin(sample, rate)
        self._of_all["arrival"][:] = self._root.T[np.triu_indices(len(self._root))]
        self._programme.set_parameters(self._theta, self._rows.ravel(), np.zeros(0))
        found = self._horizon.step(self._x, shift, count, limit)
        if sample is not None:
            self._time_far = self._time_far + length if self._is_far(sample) else 0.0
        return self._estimate(HorizonStatus.of(found, wrong))

    def robot(self) -> Robot:
        """Return the robot with the payloads of the last estimate, whose masses are not below zero."""
        p = self._horizon.x[-1, self._layout.nq + self._layout.nv :].tolist()
        return with_payloads(self._robot, self._unknowns, p)

    def _kernel(self) -> tuple[KernelProgramme, KernelHorizon]:
        native, at, of = kernel(), self._layout, self._functions.stage_function
        kind = native.Kind(
            nx=at.nx,
            ndx=at.ndx,
            ny=0,
            nu=at.nw,
            nr=at.num_rho,
            values=of("values"),
            jacobian=of("jacobian"),
            complete=of("complete"),
            scale_c=np.ones(at.ndx),
            scale_y=np.zeros(0),
            scale_m=np.ones(at.ndx),
            scale_ru=np.ones(at.nw),
        )
        end = native.Terminal(ng=0, values=of("terminal_values"), complete=of("terminal_complete"))
        programme = native.Programme(len(self._rows), kind, end, of("retract"), of("difference"))
        horizon = native.RecedingHorizon(
            programme, tolerance=_TOLERANCE, barrier=0.0, shift_unit=1.0, augmentation=0.0
        )
        return programme, horizon

    def _configuration(self, q: Any, wrong: list[str]) -> Array | None:
        found = _numbers("q", q, self._robot.nq, wrong)
        if found is None or self._robot.is_vector_space:
            return found
        on_group: Array = pin.normalize(self._robot.model, found)
        if np.isfinite(on_group).all():
            return on_group
        wrong.append("q: a quaternion or a pair of cosine and sine is zero")
        return None

    def _start(self, q: Array, v: Array) -> Array:
        """Return a state with what the robot has for the constants, from which all nodes begin."""
        x = np.concatenate([q, v, [unknown.value for unknown in self._unknowns]])
        self._programme.x = np.tile(x, len(self._rows) + 1)
        return x

    def _begin(self, q: Array, v: Array | None) -> None:
        """Take the first sample for what is known before; for what is not measured it is a guess."""
        at, sigma = self._layout, self._sigma
        measured = {key: np.isfinite(values) for key, values in sigma.items()}
        std_q = np.where(measured["q"], sigma["q"], _GUESSED)
        std_v, rate = np.full(at.nv, self._speed), np.zeros(at.nv)
        if v is not None:
            std_v = np.where(measured["v"], sigma["v"], self._speed)
            rate = np.where(measured["v"], v, 0.0)
        self._x = self._start(q, rate)
        self._root = self._root_before = np.diag(np.concatenate([std_q, std_v, self._prior]))
        self._time = 0.0

    def _has_room(self, dt: float) -> bool:
        """Return whether so much time fits into the newest step; a new one takes any."""
        h = float(self._newest["h"][0])
        return h == 0.0 or h + dt <= (1.0 + _ROUND_OFF) * self._step

    def _go_on(self, dt: float, wrong: list[str]) -> float:
        """Return by how many steps the horizon moves on for so much time; where it cannot, it begins anew."""
        if self._time_far > self._step * (len(self._rows) - _FIRST):
            self._forget()
            wrong.append("the estimate was far from all samples of a horizon, and begins anew")
        if self._time < 0.0 or self._has_room(dt):
            return 0.0
        if self._make_room():
            return 1.0
        wrong.append("the estimate was not finite, and begins anew")
        return 0.0

    def _make_room(self) -> bool:
        """Begin a new step, and let the first stages begin where the oldest one ends, as its samples say.

        Where that is not finite nothing is kept, and False returned.
        """
        rows, x, mean = self._rows, self._horizon.x, self._x
        before, root = lower_root(self._root_after_newest()()), self._root
        if rows[_FIRST, self._layout.rho["moves"]][0]:
            (off,) = self._difference.evaluate([np.array(x[_FIRST]), mean], 1, False)
            moved, columns = _filter(self._stage(_FIRST), off, root)
            if np.isfinite(moved).all():
                (mean,) = self._retract.evaluate([np.array(x[_FIRST + 1]), moved], 1, False)
            root = lower_root(columns)
        if not (np.isfinite(before).all() and np.isfinite(root).all()):
            self._forget()
            return False
        self._x, self._root, self._root_before = mean, root, before
        rows[_FIRST:-1] = rows[_FIRST + 1 :]
        rows[-1] = 0.0
        return True

    def _forget(self) -> None:
        """Leave out all samples, so that the next one is the first."""
        self._rows[_FIRST:] = 0.0
        self._rows[_FIRST:, self._layout.rho["reference"]] = self._robot.q0
        self._time, self._time_far = -1.0, 0.0

    def _is_far(self, q: Array) -> bool:
        """Return whether the newest estimate is far from a sample."""
        off = difference(self._robot.model, self._horizon.x[-1, : self._layout.nq], q)
        most = np.where(np.isinf(self._sigma["q"]), np.inf, np.minimum(_FAR * self._sigma["q"], _FARTHEST))
        return not bool(np.all(np.abs(off) <= most))

    def _add(self, q: Array | None, v: Array | None, dt: float) -> None:
        """Make the newest step longer by the time to a sample, and add the sample."""
        row = self._newest
        before = float(row["h"][0])
        t = before + dt
        self._time += dt
        if before == 0.0:
            row["reference"][:] = self._horizon.x[-1, : self._layout.nq]
        row["h"][0], row["rate"][0], row["moves"][0] = t, 1.0 / t, 1.0
        row["u"][:] = (before * row["u"] + dt * self._u) / t
        if q is None:
            return
        row["moments"] += t ** np.arange(NUM_MOMENTS)
        off = difference(self._robot.model, row["reference"], q)
        for values, weights, key in ((off, (1.0, t, t * t / 2), "of_q"), (v, (1.0, t), "of_v")):
            if values is not None:
                row[key] += np.outer(weights, values).ravel()
                row["squares"] += self._of_all[key] @ values**2 / 2

    def _stage(self, stage: int) -> Callable[[], LinearStage]:
        """A stage as it is now, to be evaluated when it is asked for."""
        x, u = self._horizon.x, self._horizon.u
        given = [np.array(value) for value in (x[stage], x[stage + 1], u[stage], self._rows[stage])]
        return partial(LinearStage.at, self._linear, self._layout, self._theta, *given)

    def _root_after_newest(self) -> Callable[[], Array]:
        """A root R of the covariance R'R of what is estimated now."""
        stage, root = self._stage(len(self._rows) - 1), self._root_before
        return lambda: _filter(stage, np.zeros(len(root)), root)[1]

    def _estimate(self, status: HorizonStatus) -> Estimate:
        at, x = self._layout, self._horizon.x[-1]
        q, v, p = np.split(np.array(x), [at.nq, at.nq + at.nv])
        return Estimate(
            status,
            q,
            v,
            dict(zip(self.names, p.tolist(), strict=True)),
            self._root_after_newest(),
            np.sqrt(self._prior**2 + max(self._time, 0.0) * self._drift**2),
        )


def _filter(stage: Callable[[], LinearStage], mean: Array, root: Array) -> tuple[Array, Array]:
    """Mean and root after a stage; NaN where its functions are not finite or its steps have no solution."""
    try:
        return stage().filter(mean, root)
    except (np.linalg.LinAlgError, RuntimeError):
        return np.full_like(mean, np.nan), np.full_like(root, np.nan)


def _robot_of(given: Robot | Problem | str) -> Robot:
    robot = load_robot(given) if isinstance(given, str) else getattr(given, "robot", given)
    if not isinstance(robot, Robot):
        raise TypeError(f"robot: got {given!r}, expected a Robot, a Problem or a name")
    for what, is_there in {"closed loops": robot.nc > 0, "drives": bool(robot.drives)}.items():
        if is_there:
            raise ProblemError(f"estimator: robot {robot.name!r} has {what}, which it does not know")
    return robot


def _check_whole(robot: Robot, is_unmeasured: BoolArray) -> None:
    """Refuse a part of an attitude or pose: its logarithm needs the rest of it."""
    for name in robot.joint_names:
        of_v, of_q = robot.velocity_indices(name), robot.configuration_indices(name)
        is_vector = of_q.stop - of_q.start == of_v.stop - of_v.start
        if is_unmeasured[of_v].any() and not (is_vector or is_unmeasured[of_v].all()):
            raise ProblemError(
                f"measured.q: joint {name!r} has some components that are inf; give all or none"
            )


def _check_words(name: str, given: Mapping[str, Any], known: Collection[str]) -> None:
    for word in given:
        if word not in known:
            raise ProblemError(f"{name}: got {word!r}, expected some of: {', '.join(known) or 'none'}")


def _deviations(name: str, value: Any, size: int, *, least: float = 1e-300, most: float = 1e300) -> Array:
    """Numbers of shape (size,), from one or so many."""
    try:
        numbers = np.broadcast_to(np.asarray(value, dtype=np.float64), (size,))
    except (TypeError, ValueError):
        numbers = np.full(size, np.nan)
    if not np.all((numbers >= least) & (numbers <= most)):
        wanted = "positive" if least else "not negative"
        raise InvalidValue(name, value, f"a number that is {wanted}" + f", or {size} of them" * (size > 1))
    return numbers


def _numbers(name: str, value: Any, size: int, wrong: list[str]) -> Array | None:
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        wrong.append(f"{name}: not an array of numbers")
        return None
    if numbers.shape == (size,) and np.isfinite(numbers).all():
        return numbers
    is_size = numbers.shape == (size,)
    wrong.append(
        f"{name}: not finite" if is_size else f"{name}: got shape {numbers.shape}, expected ({size},)"
    )
    return None


def _time(name: str, value: Any, default: float, wrong: list[str]) -> float:
    """Time of zero or more; else the default, and words."""
    try:
        time = default if value is None else float(value)
    except (TypeError, ValueError):
        time = -1.0
    if time >= 0.0:
        return time
    wrong.append(f"{name}: got {value}, expected a time >= 0")
    return default
