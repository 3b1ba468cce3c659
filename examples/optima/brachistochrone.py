"""A bead gets from one point to another in the least time, no faster than its fall makes it: 0.824759143 s.

Bernoulli's bead slides on a wire, which pushes it across its way and takes no energy. Here any force may push
it, and its kinetic energy is at most what it has lost in height. In the least time it uses all of that, which
is the motion on the best wire: an arc of a cycloid.
"""

from pathlib import Path

import casadi as ca

import mbocp
from mbocp.terms import path_constraint

GRAVITY = 9.8  # m/s^2


def energy(at):
    return ca.sumsqr(at.v) / 2 + GRAVITY * at.q[1]  # of 1 kg; the start is at height zero


def problem(steps):
    return mbocp.Problem.create(
        {"name": str(Path(__file__).parent / "robots" / "bead.urdf"), "gravity": [0, 0, -GRAVITY]},
        {"min": 0.1, "max": 10.0},
        steps,
        goal={"q": [2.0, -2.0]},
        cost={"time": 1.0, "effort": 0.0},
        limits={"effort": True},
        terms=[path_constraint(energy, upper=0.0, unit="J")],
        scheme="midpoint",
        name="brachistochrone",
    )


if __name__ == "__main__":
    print(mbocp.solve(problem(200), check=True))
