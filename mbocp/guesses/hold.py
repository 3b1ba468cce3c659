"""A guess that holds the start, with gravity compensated."""

from __future__ import annotations

import math

import numpy as np

from mbocp.formulation import Formulation, Motion
from mbocp.guesses.balance import balance, balances, required_force
from mbocp.problem import Problem
from mbocp.programme import Iterate

_EQUILIBRIUM = 1e-8  # relative part of the gravity force that the controls may leave uncompensated


def can_hold(problem: Problem) -> bool:
    """Whether controls and constraints, with what the first step holds, can keep the robot at its start."""
    robot, q, table = problem.robot, problem.q_start, problem.timeline.switches
    rest = np.zeros(robot.nv)
    G = robot.constraint_jacobian(q) if table is None else table.in_step(q, 0)
    u, lam = balance(robot, q, rest, rest, G)
    wanted = required_force(robot, q, rest, rest)
    left = wanted - robot.actuation_matrix(q) @ u + G.T @ lam
    return bool(np.abs(left).max(initial=0.0) <= _EQUILIBRIUM * (1.0 + np.abs(wanted).max(initial=0.0)))


def hold(formulation: Formulation, deadline: float = math.inf) -> Iterate:
    """Stay at the start, with the controls and multipliers that come nearest to balancing it."""
    problem, N = formulation.problem, formulation.problem.num_steps
    qs, vs = np.tile(problem.q_start, (N + 1, 1)), np.zeros((N + 1, problem.robot.nv))
    us, lams = balances(problem.robot, qs[1:], vs[1:], vs[1:], problem.timeline.switches, deadline)
    return formulation.iterate_of(Motion(qs, vs, us, problem.timeline.lengths()), lams)
