"""Find a motion of a UR5 that tells most about its masses and friction, out and back, clear of a box."""

from __future__ import annotations

import mbocp
from mbocp.identification import information

HOME = [0.0, -1.57, 1.0, -1.57, 0.5, 0.0]  # [rad]


def main() -> mbocp.Solution:
    noise = [0.1, 0.1, 0.1, 0.03, 0.03, 0.03]  # of torques [N m]
    problem = mbocp.Problem.create(
        "ur5",
        duration=5.0,
        steps=100,
        start={"q": HOME},
        goal={"q": HOME, "v": 0.0},
        limits={"position": True, "velocity": 2.0, "acceleration": 8.0, "effort": True},
        obstacle=[{"name": "box", "shape": "box", "size": [0.2, 0.2, 0.5], "position": [0.6, 0.0, 0.1]}],
        scheme="gauss2",
    )
    solution = mbocp.excite(problem, torque_noise=noise)
    print(information(solution, torque_noise=noise))
    print(solution.status, solution.advice)
    return solution


if __name__ == "__main__":
    main()
