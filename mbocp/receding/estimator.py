"""Estimation over a moving horizon: `MovingHorizonEstimator`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.problem import Problem
from mbocp.problem._checks import check_integer
from mbocp.receding.estimate import Estimate
from mbocp.receding.estimator_functions import EstimatorLayout, load_estimator_functions, make_kernel
from mbocp.receding.given import (
    MICROSECOND,
    MOST_ITERATIONS,
    check_whole,
    check_words,
    deviations_of,
    iterations_of,
    numbers_of,
    robot_of,
    time_of,
)
from mbocp.receding.kalman import FIRST, LinearStage, Samples, filter_stage, lower_root
from mbocp.receding.status import HorizonStatus
from mbocp.receding.unknowns import unknowns_of, with_payloads
from mbocp.robot import Robot
from mbocp.robot.kinematics import difference

_LONGEST = 1e3  # [s] between samples
_GUESSED = 1.0  # standard deviation of the first configuration, where it is not measured [rad, m]
_FAR, _FARTHEST = 1e3, 1.0  # standard deviations and [rad, m] by which a sample is off: above, it is far
_MOST_STEPS = 10_000


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
        self._robot = own = robot_of(robot)
        unknowns, drift = dict(unknowns or {}), dict(drift or {})
        self._unknowns = unknowns_of(own, unknowns)
        self.names = tuple(unknown.name for unknown in self._unknowns)
        check_words("measured", measured, ("q", "v"))
        check_words("drift", drift, unknowns)
        if "q" not in measured:
            raise ProblemError("measured.q: missing; give the standard deviation of positions")
        self._iterations = check_integer("iterations", iterations, 1, MOST_ITERATIONS)
        self._step = deviations_of("horizon", horizon, 1)[0] / check_integer("steps", steps, 1, _MOST_STEPS)
        self._sigma = {
            key: deviations_of(f"measured.{key}", value, own.nv, most=math.inf)
            for key, value in measured.items()
        }
        check_whole(own, np.isinf(self._sigma["q"]))
        self._speed = deviations_of("speed", speed, 1)[0]
        words = [unknown.group for unknown in self._unknowns]
        prior = [deviations_of(f"unknowns.{word}", unknowns[word], 1) for word in words]
        moves = [deviations_of(f"drift.{word}", drift.get(word, 0.0), 1, least=0.0) for word in words]
        self._prior, self._drift = np.ravel(prior), np.ravel(moves)
        self._layout = at = EstimatorLayout(own.nq, own.nv, own.nu, len(words))
        self._theta = np.zeros(at.num_theta)
        self._of_all = {name: self._theta[where] for name, where in at.theta.items()}
        for key, sigma in self._sigma.items():
            self._of_all[f"of_{key}"][:] = sigma**-2.0
        self._samples = Samples(own, at, steps, {key: self._of_all[f"of_{key}"] for key in self._sigma})
        self._of_all["disturbance"][:] = deviations_of("disturbance", disturbance, own.nv, least=0.0)
        self._of_all["drift"][:] = self._drift
        self._functions = load_estimator_functions(own, self._unknowns, has_v="v" in measured)
        of = self._functions.stage_function
        self._linear, self._difference, self._retract = of("linear"), of("difference"), of("retract")
        self._programme, self._horizon = make_kernel(self._functions, at, len(self._samples.rows))
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
        wrong = list[str]()
        sample = self._read_sample(q, v, wrong)
        given = None if u is None else numbers_of("u", u, self._robot.nu, wrong)
        self._u = self._u if given is None else np.array(given)
        length = min(time_of("dt", dt, self._step, "s", wrong) or self._step, _LONGEST)
        if dt == 0:
            wrong.append("dt: got 0, expected the time since the sample before")
        limit = time_of("time_limit", time_limit, math.inf, "us", wrong) * MICROSECOND
        count = iterations_of(iterations, self._iterations, wrong)
        shift = self._go_on(length, wrong)
        if self._time >= 0.0:
            self._time += length
            self._samples.add(sample, self._u, length, self._q)
        elif sample:
            count = 0
            self._begin(sample)
        else:
            count = 0
            wrong.append("q: the first sample must have it")
        self._of_all["arrival"][:] = self._root.T[np.triu_indices(len(self._root))]
        self._programme.set_parameters(self._theta, self._samples.rows.ravel(), np.zeros(0))
        found = self._horizon.step(self._x, shift, count, limit)
        if sample:
            self._time_far = self._time_far + length if self._is_far(sample["q"]) else 0.0
        return self._estimate(HorizonStatus.of(found, wrong))

    def robot(self) -> Robot:
        """Return the robot with the payloads of the last estimate, whose masses are not below zero."""
        p = self._horizon.x[-1, self._layout.nq + self._layout.nv :].tolist()
        return with_payloads(self._robot, self._unknowns, p)

    @property
    def _q(self) -> Array:
        """The newest configuration."""
        return np.array(self._horizon.x[-1, : self._layout.nq])

    def _read_sample(self, q: Any, v: Any, wrong: list[str]) -> dict[str, Array]:
        """A sample's numbers; none if it was lost, or some of it cannot be."""
        own, has_v = self._robot, "v" in self._sigma
        if v is not None and not has_v:
            wrong.append("v: `measured` does not have it")
        if q is None:
            return {}
        found = numbers_of("q", q, own.nq, wrong)
        if found is not None and not own.is_vector_space:
            found = pin.normalize(own.model, found)
            if not np.isfinite(found).all():
                wrong.append("q: a quaternion or a pair of cosine and sine is zero")
                return {}
        rate = numbers_of("v", v, own.nv, wrong) if has_v else np.zeros(0)
        if found is None or rate is None:
            return {}
        return {"q": found, "v": rate} if has_v else {"q": found}

    def _start(self, q: Array, v: Array) -> Array:
        """Return a state with what the robot has for the constants, from which all nodes begin."""
        x = np.concatenate([q, v, [unknown.value for unknown in self._unknowns]])
        self._programme.x = np.tile(x, len(self._samples.rows) + 1)
        return x

    def _begin(self, sample: Mapping[str, Array]) -> None:
        """Take the first sample for what is known before; for what is not measured it is a guess."""
        unmeasured = np.full(self._layout.nv, np.inf)
        of_q, of_v = (self._sigma.get(key, unmeasured) for key in "qv")
        std_q, std_v = (np.where(np.isinf(s), d, s) for s, d in ((of_q, _GUESSED), (of_v, self._speed)))
        rate = np.where(np.isinf(of_v), 0.0, sample.get("v", 0.0))
        self._x = self._start(sample["q"], rate)
        self._root = self._root_before = np.diag(np.concatenate([std_q, std_v, self._prior]))
        self._time = 0.0

    def _go_on(self, dt: float, wrong: list[str]) -> float:
        """Return by how many steps the horizon moves on for so much time; where it cannot, it begins anew."""
        if self._time_far > self._step * (len(self._samples.rows) - FIRST):
            self._forget()
            wrong.append("the estimate was far from all samples of a horizon, and begins anew")
        if self._time < 0.0 or self._samples.has_room(dt, self._step):
            return 0.0
        if self._make_room():
            return 1.0
        wrong.append("the estimate was not finite, and begins anew")
        return 0.0

    def _make_room(self) -> bool:
        """Begin a new step, and let the first stages begin where the oldest one ends, as its samples say.

        Where that is not finite nothing is kept, and False returned.
        """
        x, mean = self._horizon.x, self._x
        before, root = lower_root(self._root_after_newest()()), self._root
        if self._samples.rows[FIRST, self._layout.rho["moves"]][0]:
            (off,) = self._difference.evaluate([np.array(x[FIRST]), mean], 1, False)
            moved, columns = filter_stage(self._stage(FIRST), off, root)
            if np.isfinite(moved).all():
                (mean,) = self._retract.evaluate([np.array(x[FIRST + 1]), moved], 1, False)
            root = lower_root(columns)
        if not (np.isfinite(before).all() and np.isfinite(root).all()):
            self._forget()
            return False
        self._x, self._root, self._root_before = mean, root, before
        self._samples.begin_step()
        return True

    def _forget(self) -> None:
        """Leave out all samples, so that the next one is the first."""
        self._samples.forget()
        self._time, self._time_far = -1.0, 0.0

    def _is_far(self, q: Array) -> bool:
        """Return whether the newest estimate is far from a sample."""
        off = difference(self._robot.model, self._q, q)
        most = np.where(np.isinf(self._sigma["q"]), np.inf, np.minimum(_FAR * self._sigma["q"], _FARTHEST))
        return not bool(np.all(np.abs(off) <= most))

    def _stage(self, stage: int) -> Callable[[], LinearStage]:
        """A stage as it is now, to be evaluated when it is asked for."""
        x, u = self._horizon.x, self._horizon.u
        given = [np.array(value) for value in (x[stage], x[stage + 1], u[stage], self._samples.rows[stage])]
        return partial(LinearStage.at, self._linear, self._layout, self._theta, *given)

    def _root_after_newest(self) -> Callable[[], Array]:
        """A root R of the covariance R'R of what is estimated now."""
        stage, root = self._stage(len(self._samples.rows) - 1), self._root_before
        return lambda: filter_stage(stage, np.zeros(len(root)), root)[1]

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
