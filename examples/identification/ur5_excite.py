"""Find a motion of a UR5 that tells most about its masses and friction, out and back above a table."""

from __future__ import annotations

import mbocp
from mbocp.identification import information

HOME = [0.0, -1.57, 1.0, -1.57, 0.5, 0.0]  # [rad]


def main() -> mbocp.Solution:
    problem = mbocp.Problem.create(
        "ur5",
        duration=5.0,
        steps=100,
        start={"q": HOME},
        goal={"q": HOME, "v": 0.0},
        limits={"position": True, "velocity": 2.0, "acceleration": 8.0, "effort": True},
        obstacle=[{"kind": "half_space", "normal": [0.0, 0.0, 1.0], "offset": -0.1}],
        scheme="gauss2",
    )
    solution = mbocp.excite(problem, torque_noise=[0.1, 0.1, 0.1, 0.03, 0.03, 0.03])
    print(information(solution, torque_noise=[0.1, 0.1, 0.1, 0.03, 0.03, 0.03]))
    return solution


if __name__ == "__main__":
    main()
