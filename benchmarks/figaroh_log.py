"""Identification of the same logs by FIGAROH: `pip install figaroh`, `python -m benchmarks.figaroh_log`.

FIGAROH filters positions and torques (Butterworth, both ways), differentiates, and solves weighted least
squares for base parameters; of some cut-off frequencies the best counts. Friction is viscous: its dry
friction is F sign(v), that of simulated logs F tanh(v / 0.1). The measure is the torque that is wrong along
another motion without noise.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.machine import header, one_core
from benchmarks.tables import Table, show
from mbocp import identify, load_robot
from mbocp._arrays import Array
from mbocp.identification import Log, simulate_log
from mbocp.identification.dynamics import InverseDynamics, JointMotion
from mbocp.robot import Robot
from tests.identification.logs import changed

RATE, CUT_OFF = 100.0, (2.5, 5.0, 10.0)  # [1/s]
COLUMNS = ("position noise [rad]", "mbocp [N m]", "FIGAROH [N m]", "its cut-off [1/s]", "torque, rms [N m]")


def clean_motion(dynamics: InverseDynamics, seed: int) -> JointMotion:
    """Another motion, as it is."""
    still = simulate_log(dynamics.robot, position_noise=0.0, torque_noise=0.0, seed=seed, rate=RATE)
    y = np.stack([still.joints[name]["q"] for name in dynamics.names], axis=1)
    yd = np.gradient(y, 1.0 / RATE, axis=0)
    ydd = np.gradient(yd, 1.0 / RATE, axis=0)
    return dynamics.motion(y, yd, ydd, dynamics.follow(y))


def by_figaroh(robot: Robot, log: Log, other: JointMotion, cut_off: float) -> Array:
    """Torques along another motion, by what FIGAROH finds in a log."""
    from figaroh.identification import identification_tools as tools
    from figaroh.tools import qrdecomposition as qr
    from figaroh.tools.regressor import build_regressor_basic, build_regressor_reduced, get_index_eliminate

    own = SimpleNamespace(model=robot.model, data=robot.model.createData())
    config: dict[str, Any] = {"has_friction": True, "ts": 1.0 / RATE, "act_idxv": [*range(robot.nv)]}
    # Its filter takes half the product of time step and frequency for what is twice that.
    config["cut_off_frequency_butterworth"] = 4.0 * cut_off
    q, tau = (
        tools.low_pass_filter_data(np.stack([c[kind] for c in log.joints.values()], axis=1), config)
        for kind in ("q", "tau")
    )
    q, v, a = tools.calculate_first_second_order_differentiation(robot.model, q, config)
    tau = tau[: len(q)].T.ravel()  # one joint after the other
    config["idx_tau_stop"] = [len(q) * (k + 1) for k in range(robot.nv)]
    W = build_regressor_basic(own, q, v, a, config)
    names = dict.fromkeys(map(str, range(W.shape[1])), 0.0)
    left, kept = get_index_eliminate(W, names)
    index = qr.get_baseIndex(build_regressor_reduced(W, left), kept)
    W_b = qr.build_baseRegressor(build_regressor_reduced(W, left), index)
    found = np.linalg.lstsq(W_b, tau, rcond=None)[0]
    found = tools.weigthed_least_squares(own, found, W_b, tau, W_b @ found, config)
    there = build_regressor_basic(own, other.qs, other.v, other.a, config)
    there = qr.build_baseRegressor(build_regressor_reduced(there, left), index)
    return np.asarray((there @ found).reshape(robot.nv, -1).T)


def run(robot: Robot, seed: int, noise: float) -> tuple[float, float, float, float]:
    """Errors of both, the best cut-off, and the size of torques."""
    truth = changed(robot, seed)
    viscous = (dataclasses.replace(loss, friction=0.0) for loss in truth.resistances)
    truth = dataclasses.replace(truth, resistances=tuple(viscous))
    log = simulate_log(truth, duration=12.0, rate=RATE, position_noise=noise, seed=seed)
    true = InverseDynamics(truth)
    other = clean_motion(true, seed + 1000)
    right = true.regressor(other) @ true.values

    def error(torques: Array) -> float:
        return float(np.sqrt(np.mean((torques - right) ** 2)))

    found = identify(robot, log)
    values = found.unknowns.known + found.unknowns.shares @ found.values
    own = error(found.dynamics.regressor(other) @ values)
    theirs = {error(by_figaroh(robot, log, other, cut_off)): cut_off for cut_off in CUT_OFF}
    best = min(theirs)
    return own, best, theirs[best], float(np.sqrt(np.mean(right**2)))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=5)
    asked = parser.parse_args(arguments)
    one_core()
    show(header())
    robot, rows = load_robot("ur5"), []
    for noise in (1e-4, 1e-3):
        found = np.median([run(robot, seed, noise) for seed in range(asked.runs)], axis=0)
        rows.append((f"{noise:g}", *(f"{number:.3g}" for number in found)))
    show(Table(f"UR5, 12 s, medians of {asked.runs} logs", COLUMNS, rows))


if __name__ == "__main__":
    main()
