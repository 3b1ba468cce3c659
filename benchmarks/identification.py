"""How often true parameters are within their stated 95 %: `python -m benchmarks.identification --runs 100`.

Logs of robots with other inertias than their files are simulated, with friction and with noise in positions
and torques, each run with another robot, motion and noise. Stated intervals are those of the base parameters,
from the log alone, by themselves and together (their ellipsoid), and those of all parameters of real bodies,
which hold the file for a measurement. Squares of errors by the inverse covariance, over the number of
parameters, are 1 in the mean and the sharpest test: whatever correlates, they are independent. Beside them,
the errors of a regression along the smoothed positions.
Shares are given with the standard error of their mean: errors of one log are correlated, so that few logs say
little, however many parameters they have. With `--short` logs are short, for many runs in little time.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import chi2

from benchmarks.machine import header, one_core
from benchmarks.tables import Table, show
from mbocp import identify, load_robot
from mbocp._arrays import Array
from mbocp.identification import Identification, Log, simulate_log
from mbocp.identification.likelihood import knots_for, regression, smooth
from mbocp.identification.of_log import measure_log
from tests.identification.logs import changed, true_values

FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
CASES: dict[str, dict[str, Any]] = {
    "ur5": {"duration": 12.0},
    "panda": {"duration": 12.0, "amplitude": 0.6},
    "four_bar": {"duration": 6.0, "period": 6.0},
    "five_bar": {"duration": 10.0, "period": 5.0, "amplitude": 0.4},
    "delta": {"duration": 10.0, "period": 5.0, "amplitude": 0.3, "rate": 50.0},
}
COLUMNS = (
    *("base parameters in 95 %", "together", "all in 95 %", "squares by covariance", "error by deviation"),
    *("that of a regression", "held out by noise", "time [s]"),
)


def run(name: str, seed: int, position_noise: float, *, short: bool = False) -> tuple[float, ...]:
    """Numbers of the columns for one log."""
    robot = load_robot(name, lock=FINGERS if name == "panda" else None)
    truth = changed(robot, seed)
    case = CASES[name]
    if short:
        case = {**case, "duration": case.get("period", 10.0), "rate": 50.0}
    log = simulate_log(truth, seed=seed, position_noise=position_noise, **case)
    start = time.perf_counter()
    found = identify(robot, log)
    taken = time.perf_counter() - start
    true = true_values(found, truth)
    errors = found.base_values - found.base.combinations @ true
    off, distance = errors / found.base_sd, errors @ np.linalg.solve(found.base_covariance, errors)
    plain = (regress(found, log) - found.base.combinations @ true) / found.base_sd
    inside = np.abs(found.values - true) < 1.96 * found.sd
    left = float(np.max(found.held_out.rms / found.torque_noise))
    return (
        float(np.mean(np.abs(off) < 1.96)),
        float(distance < chi2.ppf(0.95, len(off))),
        float(inside.mean()),
        distance / len(off),
        float(np.mean(off**2)),
        float(np.mean(plain**2)),
        left,
        taken,
    )


def regress(found: Identification, log: Log) -> Array:
    """Base parameters by a regression that takes the smoothed motion for true."""
    data, dynamics = measure_log(log, found.dynamics, {}, []), found.dynamics
    data = data.part(slice(len(found.fitted.t)))
    y, yd, ydd, _ = smooth(data, knots_for(data))
    motion = dynamics.motion(y, yd, ydd, dynamics.follow(y))
    return regression(dynamics, found.unknowns, found.base, motion, data.u)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="seed of the first run")
    parser.add_argument("--position-noise", type=float, default=1e-4)
    parser.add_argument("--short", action="store_true", help="logs of one period at 50 Hz")
    parser.add_argument("--robots", nargs="+", choices=CASES, default=list(CASES))
    asked = parser.parse_args(arguments)
    one_core()
    show(header())
    for name in asked.robots:
        seeds = range(asked.first, asked.first + asked.runs)
        rows = np.array([run(name, seed, asked.position_noise, short=asked.short) for seed in seeds])
        errors = rows.std(axis=0, ddof=1) / np.sqrt(asked.runs)
        *shares, squares, off, plain, left, taken = rows.mean(axis=0)
        numbers = (
            *(f"{100 * share:.1f} +- {100 * e:.1f} %" for share, e in zip(shares, errors, strict=False)),
            f"{squares:.2f} +- {errors[3]:.2f}",
            f"{off**0.5:.2f}",
            f"{plain**0.5:.2f}",
        )
        show(
            Table(
                f"{name}, {asked.runs} runs",
                COLUMNS,
                [(*numbers, f"{left:.2f}", f"{taken:.1f}")],
            )
        )


if __name__ == "__main__":
    main()
