"""UR5: a motion that stays away from poses in which the tool cannot move in every direction."""

import casadi as ca

import mbocp
from mbocp.terms import running_cost


def manipulability(at):
    J = at.jacobian("tool0")
    return -ca.sqrt(ca.det(J @ J.T) + 1e-6)


start, goal = [0.0, -1.2, 1.5, -1.87, -1.57, 0.0], [1.2, -1.6, 2.0, -1.97, -0.4, 0.5]
ends, cost = {"start": {"q": start}, "goal": {"q": goal, "v": 0}}, {"velocity": 0.1}
problem = mbocp.Problem.create("ur5", 1.0, 20, cost=cost, **ends)
free = mbocp.solve(problem, check=True)
solution = mbocp.solve(problem.with_(terms=[running_cost(manipulability, weight=1e4)]), check=True)
print(solution)
