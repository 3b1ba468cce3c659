"""Identification of a real UR10e from its motor currents: `python -m benchmarks.real_log FOLDER`.

FOLDER is a copy of https://github.com/shamilmamedov/dynamic_calibration (S. Mamedov, S. Mikhel, Practical
Aspects of Model-Based Collision Detection, Frontiers in Robotics and AI 2020): its URDF, a log of 30 s along
twelve harmonics, from which all is found, and one of point-to-point motions, along which torques are
predicted. Torques are currents times the drive gains that its `main.m` takes from the literature. Beside the
fit, a regression along the smoothed positions of the same log. The friction speed is found from the fit's
log, and beside that it is the default; with `--swap` the logs change places.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.identification import regress
from benchmarks.machine import header, one_core
from benchmarks.tables import Table, show
from mbocp import identify, load_robot
from mbocp._arrays import Array
from mbocp.identification import Identification, Log
from mbocp.identification.likelihood import knots_for, smooth
from mbocp.identification.of_log import measure_log
from mbocp.robot import Robot

GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)  # [N m/A]
LOGS = (  # samples without those at rest, as the scripts of the repository take them
    ("identification_data/ur-20_02_10-30sec_12harm.csv", slice(634, 3510)),
    ("validation_data/ur-20_01_17-ptp_10_points.csv", slice(699, 4200)),
)
COLUMNS = ("joint", "torque, rms [N m]", "left, by the URDF", "by a regression", "by mbocp", "of the torque")


def read(folder: Path, robot: Robot, name: str, kept: slice) -> Log:
    """Positions and torques; the columns are time, positions, velocities, currents and what was asked for."""
    rows = np.loadtxt(folder / "dataset_ur10e" / name, delimiter=",")[kept]
    joints = {
        joint: {"q": rows[:, 1 + k], "tau": GAINS[k] * rows[:, 13 + k]}
        for k, joint in enumerate(robot.joint_names)
    }
    return Log(rows[:, 0] - rows[0, 0], joints, name)


def left_by(found: Identification, beta: Array, log: Log) -> Array:
    """Root mean squares of what base parameters leave of the torques of a log, by joint [N m]."""
    dynamics, unknowns = found.dynamics, found.unknowns
    data = measure_log(log, dynamics, {}, [])
    y, yd, ydd, _ = smooth(data, knots_for(data))
    full = dynamics.regressor(dynamics.motion(y, yd, ydd, dynamics.follow(y)))
    left = data.u - full @ (unknowns.known + unknowns.shares[:, found.base.chosen] @ beta)
    return np.asarray(np.sqrt((left**2).mean(axis=0)))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--friction-speed", type=float, nargs="+", default=[0.1], help="beside that found")
    parser.add_argument("--swap", action="store_true", help="fit the second log, predict the first")
    asked = parser.parse_args(arguments)
    one_core()
    show(header())
    robot = load_robot(asked.folder / "URe" / "urdf" / "ur10e.urdf")
    log, other = (read(asked.folder, robot, *each) for each in (LOGS[::-1] if asked.swap else LOGS))
    for speed in (None, *asked.friction_speed):
        found = identify(robot, log, held_out=other, friction_speed=speed)
        by_regression, held = left_by(found, regress(found, log), other), found.held_out
        rows = []
        for k, joint in enumerate(found.joints):
            size = float(np.sqrt((held.torques[:, k] ** 2).mean()))
            left = (held.rms_before[k], by_regression[k], held.rms[k])
            rows.append((joint, f"{size:.1f}", *(f"{x:.2f}" for x in left), f"{100 * left[-1] / size:.0f} %"))
        numbers = (f"{x:.4f} +- {1.96 * sd:.4f}" for x, sd in zip(found.speeds, found.speed_sd, strict=True))
        words = ", ".join(numbers) if speed is None else f"{speed:g}"
        title = f"Held out, friction speed {words} rad/s; left of the fit's log "
        show(Table(title + ", ".join(f"{x:.2f}" for x in found.fitted.rms), COLUMNS, rows))


if __name__ == "__main__":
    main()
