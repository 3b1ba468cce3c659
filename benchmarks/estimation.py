"""An arm's payload and friction from its encoders, at 1 kHz: python -m benchmarks.estimation.

Motions of a UR5 of a second, with noise of encoders and torques, joints that rub and 3 kg that it takes up
half way. Wall time of each call of `MovingHorizonEstimator.update` and of the kernel in it; errors of the
estimate, and how many of them are within 1.96 of its standard deviations. What others do on the machine is in
the largest times.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.machine import one_core
from benchmarks.tables import Table, show
from mbocp.robot import Robot

__all__ = ["estimated"]

PERIOD = 1e-3  # [s]
_NOISE, _SUBSTEPS = 1e-4, 2  # [rad]
_TORQUE_NOISE = np.array([0.3, 0.3, 0.3, 0.1, 0.1, 0.02])  # [N m], others in each period
_FRICTION = np.array([3.0, 3.0, 2.0, 0.5, 0.5, 0.3])  # [N m s/rad]
_MASS = 3.0  # [kg]
_START = np.array([0.0, -1.3, 1.4, -1.6, -1.5, 0.0])  # [rad]
_AMPLITUDE = np.array([0.5, 0.4, 0.5, 0.6, 0.6, 0.8])  # [rad]


def _arm(mass: float) -> Robot:
    load = {"frame": "tool0", "name": "load", "mass": mass, "com": [0.0, 0.0, 0.05]}
    return mbocp.load_robot("ur5", payload=[load])


def _torque(robot: Robot, q: np.ndarray, v: np.ndarray, t: float, turns: np.ndarray) -> np.ndarray:
    """Torque that follows sines of given angular frequencies [rad/s]."""
    off = _START + _AMPLITUDE * (1.0 - np.cos(turns * t)) - q
    rate, wanted = _AMPLITUDE * turns * np.sin(turns * t), _AMPLITUDE * turns**2 * np.cos(turns * t)
    a = wanted + 400.0 * off + 40.0 * (rate - v)
    return pin.rnea(robot.model, robot.model.createData(), q, v, a) + _FRICTION * v


def estimated(steps: int, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times [s], errors and standard deviations, a row a sample: (n, 2), (n, 19), (n, 19)."""
    rng, light, heavy = np.random.default_rng(seed), _arm(0.0), _arm(_MASS)
    estimator = mbocp.MovingHorizonEstimator(
        light,
        horizon=0.2,
        steps=steps,
        measured={"q": _NOISE},
        unknowns={"robot.payload.load.mass": 3.0, "robot.damping": 3.0},
        drift={"robot.payload.load.mass": 3.0},
        disturbance=_TORQUE_NOISE * np.sqrt(PERIOD),
    )
    turns, q, v, u = rng.uniform(1.5, 4.5, 6), _START, np.zeros(6), np.zeros(6)
    times, errors, deviations = np.zeros((samples, 2)), np.zeros((samples, 19)), np.zeros((samples, 19))
    for k in range(samples):
        sample = q + _NOISE * rng.standard_normal(6)
        begun = time.perf_counter()
        found = estimator.update(sample, u, dt=PERIOD)
        times[k] = time.perf_counter() - begun, found.status.seconds
        truth = np.concatenate([q, v, [_MASS if 2 * k > samples else 0.0], _FRICTION])
        errors[k] = np.concatenate([found.q, found.v, list(found.parameters.values())]) - truth
        deviations[k] = found.standard_deviations
        robot = light if 2 * k < samples else heavy
        u = _torque(robot, q, v, k * PERIOD, turns)
        force, data = u + _TORQUE_NOISE * rng.standard_normal(6), robot.model.createData()
        for h in [PERIOD / _SUBSTEPS] * _SUBSTEPS:
            middle = v + h / 2 * pin.aba(robot.model, data, q, v, force - _FRICTION * v)
            at_middle = q + h / 2 * v
            v = v + h * pin.aba(robot.model, data, at_middle, middle, force - _FRICTION * middle)
            q = q + h * middle
    return times, errors, deviations


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--motions", type=int, default=30)
    parser.add_argument("--steps", type=int, nargs="+", default=[20, 50])
    asked = parser.parse_args()
    one_core()
    rows, half = [], asked.samples // 2
    for steps in asked.steps:
        runs = [estimated(steps, asked.samples, seed) for seed in range(asked.motions)]
        times, errors, deviations = (np.array(values) for values in zip(*runs, strict=True))
        inside = np.abs(errors) < 1.96 * deviations
        settled = inside[:, [half - 1, -1]].mean(axis=1)  # before the payload comes, and at the end
        rms = np.sqrt((errors[:, -1] ** 2).mean(axis=0))
        found = [np.argmax(np.abs(error[half + 2 :, 12]) < 0.1 * _MASS) + 2 for error in errors]
        kernel, call = times[:, 1:, 1], times[:, 1:, 0]
        rows.append(
            (
                str(steps),
                *(f"{1e3 * np.median(part):.3f}" for part in (call, kernel)),
                f"{1e3 * np.percentile(kernel, 99):.3f}",
                f"{1e6 * rms[:6].mean():.0f}",
                f"{1e3 * rms[6:12].mean():.1f}",
                f"{rms[12]:.2f}",
                f"{(rms[13:] / _FRICTION).max():.1%}",
                f"{np.median(found):.0f}",
                *(f"{settled[:, part].mean():.1%}" for part in (slice(0, 12), slice(12, 19))),
            )
        )
    heads = (
        "steps in 0.2 s",
        "call, median [ms]",
        "kernel, median [ms]",
        "kernel, 99 % [ms]",
        "q [urad]",
        "v [mrad/s]",
        "mass [kg]",
        "friction",
        "3 kg within a tenth after [ms]",
        "within 95 %: q, v",
        "constants",
    )
    show(Table("A UR5 takes up 3 kg", heads, tuple(rows)), markdown=False)


if __name__ == "__main__":
    main()
