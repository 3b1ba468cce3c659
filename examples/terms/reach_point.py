"""UR5: the tool ends at a point of the world, at rest, in whatever pose costs least."""

import mbocp
from mbocp.terms import end_condition


def tool_at(at):
    return at.position("tool0") - at["point"]


def at_rest(at):
    return at.v


terms = [end_condition(tool_at, point=[0.4, 0.3, 0.5]), end_condition(at_rest)]
start, cost = {"q": [0.0, -1.2, 1.5, -1.87, -1.57, 0.0]}, {"velocity": 0.1}
problem = mbocp.Problem.create("ur5", 1.0, 20, start=start, cost=cost, terms=terms)
solution = mbocp.solve(problem, check=True)
print(solution)
