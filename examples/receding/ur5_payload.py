"""UR5 follows a goal and takes up 3 kg that nobody has told it of, with joints that rub.

    python ur5_payload.py [--seconds 2]

An estimator finds state, payload and friction from noisy encoders alone, at 1 kHz; a receding horizon goes by
what it says, every 4 ms. The same loop without the estimator's payload and friction ends elsewhere.
"""

import argparse
from pathlib import Path

import numpy as np
import pinocchio as pin

import mbocp

PERIOD, CONTROL = 1e-3, 4  # [s] between samples, and samples between controls
NOISE = 1e-4  # [rad] of encoders
FRICTION = np.array([3.0, 3.0, 2.0, 0.5, 0.5, 0.3])  # [N m s/rad]


def arm_with(mass):
    load = {"frame": "tool0", "name": "load", "mass": mass, "com": [0, 0, 0.05]}
    return mbocp.load_robot("ur5", payload=[load])


def follow(seconds, goes_by_estimate):
    light, heavy, rng = arm_with(0.0), arm_with(3.0), np.random.default_rng(0)
    problem = mbocp.load_problem(Path(__file__).with_name("ur5_follow.toml")).with_(robot=light)
    horizon = mbocp.RecedingHorizon(problem, iterations=2)
    estimator = mbocp.MovingHorizonEstimator(
        problem,
        horizon=0.1,
        steps=25,  # as long as a control holds
        measured={"q": NOISE},
        unknowns={"robot.payload.load.mass": 3.0, "robot.damping": 3.0},
        drift={"robot.payload.load.mass": 3.0},
        disturbance=0.02,
    )
    data, q, v = light.model.createData(), np.array(problem.q_start), np.zeros(6)
    u, planned, off = np.zeros(6), np.array(horizon.first.u), []
    goal, friction = np.asarray(problem.goal.q), np.zeros(6)
    for k in range(round(seconds / PERIOD)):
        found = estimator.update(q + NOISE * rng.standard_normal(6), u, dt=PERIOD)
        if k % CONTROL == 0:
            moved = goal + 0.3 * np.sin(0.8 * k * PERIOD)
            told = {"robot": estimator.robot()} if goes_by_estimate and k % (10 * CONTROL) == 0 else {}
            planned = np.array(
                horizon.step(found.q, found.v, goal=moved, target=moved, dt=CONTROL * PERIOD, **told).u
            )
            if goes_by_estimate:
                friction = np.array(list(found.parameters.values()))[1:]
        u = planned + friction * found.v
        model = (light if 2 * k * PERIOD < seconds else heavy).model
        middle = v + PERIOD / 2 * pin.aba(model, data, q, v, u - FRICTION * v)
        at_middle = light.integrate(q, PERIOD / 2 * v)
        v = v + PERIOD * pin.aba(model, data, at_middle, middle, u - FRICTION * middle)
        q = light.integrate(q, PERIOD * middle)
        off.append(np.abs(q - moved).max())
    return found, np.max(off[-round(0.2 / PERIOD) :])


parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--seconds", type=float, default=2.0)
asked = parser.parse_args()
_, without = follow(asked.seconds, goes_by_estimate=False)
found, off = follow(asked.seconds, goes_by_estimate=True)
for name, value in found.parameters.items():
    print(f"{name}: {value:.3f} +- {found.deviations[name]:.3f}")
print(f"from the goal at the end: {off:.4f} rad, and {without:.4f} rad without the estimate")
