"""How often true parameters are within their stated 95 %: `python -m benchmarks.identification --runs 100`.

Logs of robots with other inertias than their files are simulated, with friction and with noise in positions
and torques, each run with another robot, motion and noise. Stated intervals are those of the base parameters,
from the log alone, and those of all parameters of real bodies, which hold the file for a measurement.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.machine import header, one_core
from benchmarks.tables import Table, show
from mbocp import identify, load_robot
from mbocp.identification import simulate_log
from tests.identification.logs import changed, true_values

FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
CASES: dict[str, dict[str, Any]] = {
    "ur5": {"duration": 12.0},
    "panda": {"duration": 12.0, "amplitude": 0.6},
    "four_bar": {"duration": 6.0, "period": 6.0},
    "five_bar": {"duration": 10.0, "period": 5.0, "amplitude": 0.4},
    "delta": {"duration": 10.0, "period": 5.0, "amplitude": 0.3, "rate": 50.0},
}
COLUMNS = ("base parameters in 95 %", "all in 95 %", "error by deviation", "held out by noise", "time [s]")


def run(name: str, seed: int) -> tuple[float, float, float, float, float]:
    """Shares within 95 %, of base parameters and of all; errors and residuals by deviations; time."""
    robot = load_robot(name, lock=FINGERS if name == "panda" else None)
    truth = changed(robot, seed)
    log = simulate_log(truth, seed=seed, **CASES[name])
    start = time.perf_counter()
    found = identify(robot, log)
    taken = time.perf_counter() - start
    true = true_values(found, truth)
    off = (found.base_values - found.base.combinations @ true) / found.base_sd
    inside = np.abs(found.values - true) < 1.96 * found.sd
    left = float(np.max(found.held_out.rms / found.torque_noise))
    return (
        float(np.mean(np.abs(off) < 1.96)),
        float(inside.mean()),
        float(np.sqrt(np.mean(off**2))),
        left,
        taken,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--robots", nargs="+", choices=CASES, default=list(CASES))
    asked = parser.parse_args(arguments)
    one_core()
    show(header())
    for name in asked.robots:
        rows = np.array([run(name, seed) for seed in range(asked.runs)])
        base, every, off, left, taken = rows.mean(axis=0)
        shares = (f"{100 * base:.1f} %", f"{100 * every:.1f} %")
        show(
            Table(
                f"{name}, {asked.runs} runs",
                COLUMNS,
                [(*shares, f"{off:.2f}", f"{left:.2f}", f"{taken:.1f}")],
            )
        )


if __name__ == "__main__":
    main()
