"""Accuracy of the controls against the time of an iteration, section 5.4 and Figure 12 of [Manara2017]_."""

from __future__ import annotations

import math
import multiprocessing
import warnings
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.formulation import Formulation
from mbocp.problem import Problem
from mbocp.robot import Robot
from mbocp.solvers import SolverResult, Status, zero_multipliers
from mbocp.solvers.nlp.interior_point import InteriorPoint
from mbocp_papers.so3.data import formulation
from mbocp_papers.so3.experiment import task_problem
from mbocp_papers.so3.motions import stretch_of, task_motion
from mbocp_papers.so3.request import Say
from mbocp_papers.so3.substeps import Method, SteppedProgramme, stepped_programme
from mbocp_papers.so3.timings import one_core

NUM_STEPS = 25  # N of section 5.4
EPSILON = 0.05  # of eq. (55)
REFERENCE = Method("rk4", "munthe_kaas", 25)
METHODS = (("euler", "Eul"), ("heun", "RK2"), ("rk4", "RK4"), ("rkf5", "RKF5"))
SUFFIXES = (("plain", ""), ("baumgarte", "+BG"), ("munthe_kaas", "-MK"))

SUBSTEPS: Mapping[str, tuple[int, ...]] = {
    "euler": (1, 2, 4, 8, 16, 32, 64),
    "heun": (1, 2, 4, 8, 16, 32),
    "rk4": (1, 2, 4, 8),
    "rkf5": (1, 2, 4, 6),
}
_QUICK: Mapping[str, tuple[int, ...]] = {"euler": (1, 8), "rk4": (1, 2)}
_TOLERANCE = 1e-10  # the accuracies of Figure 12 go down to 1e-12
_MOST_ITERATIONS = 200
_LONGEST = 30.0  # [s]
_REPETITIONS = 5  # of a solve, for its time
_LONG_ENOUGH = 0.5  # [s] of repeated solves


@dataclass(frozen=True)
class Point:
    """One solve.

    Attributes
    ----------
    substeps : int
        Integration steps in each interval.
    milliseconds : float
        Time of an iteration; NaN without one.
    accuracy : float
        Integral of the squared distance from the reference's controls.
    stretch : float
        Largest singular value of the representation less one, eq. (55).
    cost : float
    iterations : int
    status : str
    """

    substeps: int
    milliseconds: float
    accuracy: float
    stretch: float
    cost: float
    iterations: int
    status: str

    @property
    def is_meaningful(self) -> bool:
        """Whether the solver converged to a motion of a pendulum that keeps its shape."""
        return self.status == "converged" and self.stretch <= EPSILON

    def to_dict(self) -> dict[str, Any]:
        """As plain values, for JSON."""
        numbers = {name: value for name, value in vars(self).items() if isinstance(value, float)}
        shown = {name: value if math.isfinite(value) else None for name, value in numbers.items()}
        return {**vars(self), **shown, "is_meaningful": self.is_meaningful}


@dataclass(frozen=True)
class Curve:
    """Points of one integrator with one representation.

    Attributes
    ----------
    rotations : {"quaternion", "dcm"}
    scheme, lie : str
    points : tuple of Point
    """

    rotations: str
    scheme: str
    lie: str
    points: tuple[Point, ...]

    @property
    def label(self) -> str:
        """As in the paper: RK4+BG."""
        return dict(METHODS)[self.scheme] + dict(SUFFIXES)[self.lie]


def accuracy_curves(quick: bool = False, workers: int | None = None, say: Say = str) -> list[Curve]:
    """Solve everything that Figure 12 shows.

    Parameters
    ----------
    quick : bool
        Two schemes with two numbers of steps each.
    workers : int, optional
        Processes that compile; the solves are timed one after the other. Default: one a processor.
    say : callable
    """
    substeps = _QUICK if quick else SUBSTEPS
    wanted = [
        (rotations, scheme, lie)
        for rotations in ("quaternion", "dcm")
        for scheme in substeps
        for lie, _ in SUFFIXES
    ]
    _compile(wanted, workers, say)
    say("Figure 12: reference")
    found = reference()
    curves = []
    with one_core():
        for rotations, scheme, lie in wanted:
            say(f"Figure 12: {rotations} {scheme} {lie}")
            points = tuple(_points(rotations, scheme, lie, substeps[scheme], found))
            curves.append(Curve(rotations, scheme, lie, points))
    return curves


@dataclass(frozen=True, eq=False)
class Reference:
    """The most accurate solution.

    Attributes
    ----------
    qs : ndarray, shape (26, nq)
        Configurations, quaternions without jumps of their sign.
    speeds : ndarray, shape (26, ns)
    us : ndarray, shape (25, nu)
    """

    qs: Array
    speeds: Array
    us: Array

    def states(self, formulation: Formulation) -> Array:
        """Its states as a formulation takes them, shape (26, nx)."""
        at = formulation.layout
        xs = np.zeros((len(self.qs), at.nx))
        xs[:, at.z], xs[:, at.s] = formulation.space.coordinates(self.qs), self.speeds
        if at.nr:
            xs[1:, at.r] = self.us
        xs[0] = formulation.programme.x_start
        return xs


@lru_cache(maxsize=1)
def reference() -> Reference:
    """Solution by `REFERENCE`, reached from N = 100 by way of four steps in each of 25 intervals.

    Raises
    ------
    ProblemError
        If it is not found.
    """
    motion = task_motion("DCM RK-MK")
    problem, fine = _problem("dcm"), motion.solution
    robot, every = problem.robot, fine.num_steps // NUM_STEPS
    nodes = slice(None, None, every)
    pairs = zip(fine.qs[nodes], fine.vs[nodes], strict=True)
    found = Reference(
        qs=fine.qs[nodes],
        speeds=np.array([np.linalg.lstsq(robot.speed_map(q), v, rcond=None)[0] for q, v in pairs]),
        us=fine.us.reshape(NUM_STEPS, every, -1).mean(axis=1),
    )
    for method in (Method("rk4", "munthe_kaas", every), REFERENCE):
        stepped = stepped_programme(problem, method)
        result, at = _solve(stepped, found), stepped.formulation.layout
        if result.status is not Status.CONVERGED:
            raise ProblemError(f"Figure 12: no reference solution, {result.status}: {result.advice}")
        xs = result.iterate.xs
        qs = _continuous(robot, stepped.formulation.space.configurations(xs[:, at.z]), problem.q_start)
        found = Reference(qs, xs[:, at.s], result.iterate.us)
    return found


def _problem(rotations: str) -> Problem:
    """Task of Figure 12; the scheme is what compiles fastest, see `stepped_programme`."""
    label = "Q RK" if rotations == "quaternion" else "DCM RK"
    settings = {"integrator.scheme": "euler", "horizon.steps": NUM_STEPS}
    return task_problem(formulation(label), settings=settings)


def _points(
    rotations: str, scheme: str, lie: str, substeps: Sequence[int], found: Reference
) -> Iterator[Point]:
    problem = _problem(rotations)
    for count in substeps:
        stepped = stepped_programme(problem, Method(scheme, lie, count))
        results = [_solve(stepped, found)]
        while len(results) < _REPETITIONS and sum(r.record.wall_time_s for r in results) < _LONG_ENOUGH:
            results.append(_solve(stepped, found))
        yield _point(stepped, results, found)


def _solve(stepped: SteppedProgramme, start: Reference) -> SolverResult:
    """Solve from the reference, which keeps a solver near it."""
    solver = InteriorPoint("ipopt", _TOLERANCE, _MOST_ITERATIONS, _LONGEST)
    programme = stepped.programme
    xs, ys = start.states(stepped.formulation), np.zeros((programme.num_steps, 0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return solver.run(programme, zero_multipliers(programme, xs, ys, start.us))


def _point(stepped: SteppedProgramme, results: Sequence[SolverResult], found: Reference) -> Point:
    """Point of several runs of the same solve; the shortest is least disturbed."""
    result = min(results, key=lambda one: one.record.wall_time_s)
    problem, us = stepped.problem, result.iterate.us
    with np.errstate(all="ignore"):  # what diverges overflows
        zs = stepped.simulate(us)[:, stepped.formulation.layout.z]
        stretch = stretch_of(problem, zs)
    iterations = result.record.iteration
    seconds = result.record.wall_time_s
    return Point(
        substeps=stepped.method.substeps,
        milliseconds=1e3 * seconds / iterations if iterations else math.nan,
        accuracy=float(problem.dt * np.sum((us - found.us) ** 2)),
        stretch=stretch,
        cost=float(result.record.cost),
        iterations=iterations,
        status=str(result.status),
    )


def _continuous(robot: Robot, qs: Array, start: Array) -> Array:
    """Configurations with the pendulum's quaternion on the side where the one before it is."""
    turn, before = robot.configuration_indices("pendulum"), start
    out: Array = qs.copy()
    for q in out:
        if q[turn] @ before[turn] < 0:
            q[turn] = -q[turn]
        before = q
    return out


def _compile(wanted: Sequence[tuple[str, str, str]], workers: int | None, say: Say) -> None:
    """Fill the cache of compiled functions in several processes, one for each kind of step."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        pending = [pool.submit(_prepare, *one) for one in wanted]
        for done, future in enumerate(pending, start=1):
            future.result()
            say(f"Figure 12: compiling, {done} of {len(wanted)}")


def _prepare(rotations: str, scheme: str, lie: str) -> None:
    stepped_programme(_problem(rotations), Method(scheme, lie, 1))
