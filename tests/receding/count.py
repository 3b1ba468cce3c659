"""Heap allocations of a hundred steps of a horizon, of the kernel and with Python around it."""

from __future__ import annotations

import ctypes
import math
import sys

import numpy as np

import mbocp

STEPS = 100


def main() -> None:
    count = ctypes.CDLL(None).num_allocations
    count.restype = ctypes.c_long
    horizon = mbocp.RecedingHorizon(sys.argv[1], iterations=2)
    q, v = np.array(horizon.problem.q_start), np.array(horizon.problem.v_start)
    goal, state = q + 0.1, np.concatenate([q, v])
    for _ in range(5):
        horizon.step(q, v, goal=goal, target=goal, dt=0.003)
        count()
    before = count()
    for _ in range(STEPS):
        horizon._native.step(state, 0.3, 2, math.inf)
    between = count()
    for _ in range(STEPS):
        horizon.step(q, v, dt=0.003)
    print(between - before, count() - between)


if __name__ == "__main__":
    main()
