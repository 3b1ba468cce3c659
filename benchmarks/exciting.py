"""What exciting motions tell beside random ones and Fourier series.

`python -m benchmarks.exciting --starts 20`; `--robot delta --starts 3 --passes 5`: along closed loops, beside
random motions alone. All keep the same limits and last as long. Fourier sums have five harmonics, begin and
end at rest, and are improved by the same search, but have their limits at the times of a grid. Standard
deviations are stated by the information, and by `identify` from a simulated log of 100 Hz with noise in
positions and torques.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from scipy.linalg import null_space

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.tables import Table, show
from mbocp._arrays import Array
from mbocp.identification import information
from mbocp.identification.exciting import Information, _log_det, _Search
from tests.identification.logs import log_of

HARMONICS, NOISE, HOME = 5, 0.05, [0.0, -1.57, 1.0, -1.57, 0.5, 0.0]
COLUMNS = ("log det", "condition", "median sd", "largest sd", "median sd of a log")


def problem_of_delta() -> mbocp.Problem:
    """A delta robot that leaves its middle and comes back."""
    robot = mbocp.load_robot("delta")
    limits = {"effort": True, "velocity": {f"arm_{k}": 8.0 for k in (1, 2, 3)}}
    return mbocp.Problem.create(
        robot, 5.0, 100, start={"q": robot.q0}, goal={"q": robot.q0, "v": 0.0}, limits=limits
    )


def problem_of_arm() -> mbocp.Problem:
    """A UR5 that leaves a pose and comes back."""
    limits = {"position": True, "velocity": 2.0, "acceleration": 8.0, "effort": True}
    return mbocp.Problem.create(
        "ur5", 5.0, 100, start={"q": HOME}, goal={"q": HOME, "v": 0.0}, limits=limits, scheme="gauss2"
    )


PROBLEMS = {"ur5": problem_of_arm, "delta": problem_of_delta}


class Fourier(_Search):
    """The search in Fourier series whose first period begins at rest."""

    def __init__(self, problem: mbocp.Problem) -> None:
        super().__init__(problem, NOISE, "both", 2 * HARMONICS)
        at_start = np.array([self.functions(np.zeros(1), k)[0] for k in range(3)])
        self.mix = null_space(at_start)  # position, velocity and acceleration are zero there
        grid = np.linspace(0.0, problem.duration, 201)
        self.values, self.hulls = ([self.basis(t, k) for k in range(3)] for t in (self.times, grid))
        self.line = np.vstack([self.line[0], np.zeros((self.mix.shape[1], self.dynamics.n))])
        self.free = np.arange(len(self.line)) > 0

    def functions(self, t: Array, k: int) -> Array:
        """One, cosines and sines, or their derivatives."""
        w = 2.0 * np.pi / self.problem.duration * np.arange(1, HARMONICS + 1)
        phase = np.outer(t, w) + 0.5 * np.pi * k
        return np.hstack([np.full((len(t), 1), float(k == 0)), w**k * np.cos(phase), w**k * np.sin(phase)])

    def basis(self, t: Array, k: int) -> Array:
        """A constant, and what is at rest at the begin."""
        return np.hstack([np.full((len(t), 1), float(k == 0)), self.functions(t, k) @ self.mix])

    def course(self, c: Array, t: Array) -> list[Array]:
        """Values and derivatives at times."""
        return [self.basis(t, k) @ c for k in range(3)]


def course(search: _Search, c: Array, t: Array) -> list[Array]:
    """Values and derivatives of a spline."""
    return [search.spline.derivative(k)(t) @ c for k in range(3)]


def sd_of_log(search: _Search, moved: list[Array], t: Array, seed: int) -> float:
    """Median of the standard deviations that `identify` states."""
    dynamics, robot = search.dynamics, search.problem.robot
    motion = dynamics.motion(*moved, dynamics.follow(moved[0], search.problem.q_start))
    return float(np.median(mbocp.identify(robot, log_of(dynamics, motion, t, seed, NOISE)).base_sd))


def row(name: str, told: Information, log: float | None) -> tuple[str, ...]:
    """Measures of a motion."""
    numbers = (told.log_det, told.condition, float(np.median(told.sd)), float(told.sd.max()))
    return (name, *(f"{number:.4g}" for number in numbers), "-" if log is None else f"{log:.4g}")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", choices=PROBLEMS, default="ur5")
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--passes", type=int, default=60, help="linear programmes from each start, at most")
    asked = parser.parse_args(arguments)
    one_core()
    show(header())
    problem, rng = PROBLEMS[asked.robot](), np.random.default_rng(0)
    spline = _Search(problem, NOISE, "both", 15)
    t, rows = np.arange(round(100 * problem.duration)) / 100.0, []
    random = [spline.begin(rng) for _ in range(asked.starts)]
    values = [_log_det(spline.matrix(spline.motion(c))) for c in random]
    for name, c in (
        ("random spline, the median", random[int(np.argsort(values)[len(values) // 2])]),
        ("random spline, the best", random[int(np.argmax(values))]),
        ("optimal spline", max((spline.climb(c, asked.passes) for c in random), key=lambda pair: pair[0])[1]),
    ):
        log = sd_of_log(spline, course(spline, c, t), t, 1)
        rows.append(row(name, Information(spline.base, spline.matrix(spline.motion(c))), log))
    solution = mbocp.solve(spline.problem_near(c))
    rows.append(
        row(f"the solution near it ({solution.status})", information(solution, torque_noise=NOISE), None)
    )
    if not problem.robot.nc:
        fourier = Fourier(problem)
        climbs = (fourier.climb(fourier.begin(rng), asked.passes) for _ in random)
        best = max(climbs, key=lambda pair: pair[0])[1]
        log = sd_of_log(fourier, fourier.course(best, t), t, 1)
        rows.append(
            row(
                "optimal Fourier series", Information(fourier.base, fourier.matrix(fourier.motion(best))), log
            )
        )
    show(Table(f"{asked.robot}, {asked.starts} starts, {problem.duration:g} s", ("motion", *COLUMNS), rows))


if __name__ == "__main__":
    main()
