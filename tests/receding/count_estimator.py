"""Heap allocations of the kernel in a thousand samples of an estimator: of a robot with a load at a frame."""

from __future__ import annotations

import ctypes
import math
import sys

import numpy as np

import mbocp

SAMPLES = 1000


def main(robot: str, frame: str) -> None:
    count = ctypes.CDLL(None).num_allocations
    count.restype = ctypes.c_long
    arm = mbocp.load_robot(robot, payload=[{"frame": frame, "name": "load", "mass": 1.0}])
    estimator = mbocp.MovingHorizonEstimator(
        arm, measured={"q": 1e-4}, unknowns={"robot.payload.load.mass": 1.0}, disturbance=0.01
    )
    q, rng = np.array(arm.q0), np.random.default_rng(0)
    for _ in range(30):
        estimator.update(q + 1e-4 * rng.standard_normal(arm.nq), np.zeros(arm.nv), dt=0.01)
    native, theta, x = estimator._horizon, estimator._theta, estimator._x
    rho = estimator._samples.rows.ravel()
    none = np.zeros(0)
    before = count()
    for k in range(SAMPLES):
        estimator._programme.set_parameters(theta, rho, none)
        native.step(x, float(k % 2), 2, math.inf)
    print(count() - before)


if __name__ == "__main__":
    main(*sys.argv[1:])
