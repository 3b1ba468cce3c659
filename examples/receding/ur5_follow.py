"""UR5 in a control loop: noise, a delay of one period, a goal that moves, torques within limits.

    python ur5_follow.py [--live] [--seconds 4] [--replay ur5_follow.html]

`--live` shows the robot in a browser while it runs, as fast as a clock on the wall.
"""

import argparse
import contextlib
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pinocchio as pin

import mbocp
from mbocp.view.live_robot import LiveRobot
from mbocp.view.replay import write_replay

PERIOD, SIMULATED = 4e-3, 1e-3  # [s] of the loop, and of the simulation in it
POSITION_NOISE, VELOCITY_NOISE = 1e-4, 2e-3  # [rad, rad/s], standard deviations


def goal_at(goal, t):
    return goal + 0.3 * np.sin(0.8 * t) * np.array([1.0, 1.0, -1.0, 0.5, 0.5, 1.0])


parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--live", action="store_true")
parser.add_argument("--seconds", type=float, default=4.0)
parser.add_argument("--replay", default="ur5_follow.html")
asked = parser.parse_args()

problem = mbocp.load_problem(Path(__file__).with_suffix(".toml"))
horizon = mbocp.RecedingHorizon(problem, iterations=2)
robot, rng = problem.robot, np.random.default_rng(0)
data = robot.model.createData()
q, v, u = np.array(problem.q_start), np.array(problem.v_start), np.array(horizon.first.u)
qs, off, told, kernel = [q], [], Counter(), []
with LiveRobot(robot, q) if asked.live else contextlib.nullcontext() as live:
    begun = time.perf_counter()
    for k in range(round(asked.seconds / PERIOD)):
        goal = goal_at(np.asarray(problem.goal.q), k * PERIOD)
        measured = q + POSITION_NOISE * rng.standard_normal(6), v + VELOCITY_NOISE * rng.standard_normal(6)
        found = horizon.step(*measured, goal=goal, target=goal, dt=PERIOD, time_limit=2000)
        for _ in range(round(PERIOD / SIMULATED)):  # with the control of the period before
            v = v + SIMULATED * pin.aba(robot.model, data, q, v, u)
            q = robot.integrate(q, SIMULATED * v)
        u = horizon.control_for(PERIOD)
        qs.append(q), off.append(np.abs(q - goal).max()), kernel.append(found.status.seconds)
        told[found.status.state] += 1
        if live is not None and k % 8 == 0:
            live.show(q)
            time.sleep(max(0.0, k * PERIOD - (time.perf_counter() - begun)))

print("steps:", ", ".join(f"{count} {state}" for state, count in told.items()))
print(f"from the goal at the end: {off[-1]:.4f} rad; in the kernel: {1e6 * np.median(kernel):.0f} us, median")
print("replay:", write_replay(robot, PERIOD * np.arange(len(qs)), qs, asked.replay, title="UR5 follows"))
