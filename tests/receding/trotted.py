"""A trot under a receding horizon, in MuJoCo: `python -m tests.receding.trotted`.

The loop is that of `examples/receding/solo12_trot.py`. MuJoCo knows the ground as a plane with friction, and
feet as spheres; it is told nothing of the phases.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections import Counter
from collections.abc import Sequence

import mujoco
import numpy as np

import mbocp
from mbocp._arrays import Array
from mbocp.receding import RecedingHorizon
from tests.receding.test_moving import TROT, example
from tests.sent.walked import Simulator


class InMujoco:
    """A plant as the example asks for one."""

    def __init__(self, problem: mbocp.Problem) -> None:
        self.simulator = Simulator.of(problem.robot)
        self.simulator.put(problem.q_start, problem.v_start)

    @property
    def q(self) -> Array:
        return self.simulator.state[0]

    @property
    def v(self) -> Array:
        return self.simulator.state[1]

    def push(self, speed: float) -> None:
        """Push the base to the left."""
        self.simulator.data.qvel[1] += speed

    def land(self, feet: Sequence[str]) -> None:
        """Feet land where they come to the ground."""

    def go_on(self, torque: Array) -> Array:
        """Go on for a millisecond; forces of what touches the ground, x and y across and z along it [N]."""
        model, data = self.simulator.model, self.simulator.data
        self.simulator.step(torque)
        forces, wrench = np.zeros((data.ncon, 3)), np.zeros(6)
        for k in range(data.ncon):
            mujoco.mj_contactForce(model, data, k, wrench)
            forces[k] = wrench[[1, 2, 0]]
        return forces


def main() -> int:
    """Print how it trots."""
    parser = argparse.ArgumentParser(prog="python -m tests.receding.trotted", description=__doc__)
    parser.add_argument("--seconds", type=float, default=2.4)
    parser.add_argument("--speed", type=float, default=0.3, help="[m/s]")
    parser.add_argument("--push", type=float, default=0.15, help="of the base to the left [m/s]")
    parser.add_argument("--iterations", type=int, default=2)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    problem = mbocp.load_problem(TROT)
    horizon, plant = RecedingHorizon(problem, iterations=options.iterations), InMujoco(problem)
    states, forces, told = example().trot(
        horizon,
        options.seconds,
        lambda t: [min(t, options.speed), 0.0, 0.0],
        options.push,
        plant,
    )
    qs = np.array([q for q, _ in states])
    round_ = problem.timeline.num_timed_steps
    speed = (qs[-1, 0] - qs[-1 - round_, 0]) / problem.duration
    tilt = np.abs(qs[:, 3:5]).max()
    print(dict(Counter(status.state for status in told)))
    print(
        f"{speed:.3f} m/s in the last cycle, y {qs[-1, 1]:.3f} m, "
        f"z {qs[:, 2].min():.3f} to {qs[:, 2].max():.3f} m"
    )
    print(f"tilt {tilt:.3f}, |f_t| at most {np.linalg.norm(forces[:, :2], axis=1).max():.1f} N")
    return 0 if qs[:, 2].min() > 0.2 and tilt < 0.1 else 1


if __name__ == "__main__":
    sys.exit(main())
