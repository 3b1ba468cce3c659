"""UR5: the axis of the tool stays within 5 degrees of the vertical."""

import numpy as np

import mbocp
from mbocp.terms import path_constraint


def upright(at):
    return -at.rotation("tool0")[2, 2]  # cosine of the angle between the tool's axis and down


start, goal = [0.0, -1.2, 1.5, -1.87, -1.57, 0.0], [1.2, -1.6, 2.0, -1.97, -1.57, 0.5]
ends, cost = {"start": {"q": start}, "goal": {"q": goal, "v": 0}}, {"velocity": 0.1}
problem = mbocp.Problem.create("ur5", 1.0, 20, cost=cost, **ends)
within = path_constraint(upright, lower=np.cos(np.deg2rad(5.0)))
free = mbocp.solve(problem, check=True)
solution = mbocp.solve(problem.with_(terms=[within]), check=True)
print(solution)
