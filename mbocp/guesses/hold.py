"""A guess that holds the start, with gravity compensated."""

from __future__ import annotations

import numpy as np

from mbocp.formulation import Formulation, Motion, given_lengths
from mbocp.guesses.balance import balance, required_force
from mbocp.problem import Problem
from mbocp.programme import Iterate

__all__ = ["can_hold", "hold"]

_EQUILIBRIUM = 1e-8  # relative part of the gravity force that the controls may leave uncompensated


def can_hold(problem: Problem) -> bool:
    """Whether controls and constraints can keep the robot at its start."""
    robot, q = problem.robot, problem.q_start
    rest = np.zeros(robot.nv)
    G = robot.constraint_jacobian(q)
    u, lam = balance(robot, q, rest, rest, G)
    wanted = required_force(robot, q, rest, rest)
    left = wanted - robot.actuation_matrix(q) @ u + G.T @ lam
    return bool(np.abs(left).max(initial=0.0) <= _EQUILIBRIUM * (1.0 + np.abs(wanted).max(initial=0.0)))


def hold(formulation: Formulation) -> Iterate:
    """Stay at the start."""
    problem, N = formulation.problem, formulation.problem.num_steps
    robot = problem.robot
    still, G = np.zeros(robot.nv), robot.constraint_jacobian(problem.q_start)
    u, lam = balance(robot, problem.q_start, still, still, G)
    qs, vs, us = np.tile(problem.q_start, (N + 1, 1)), np.tile(still, (N + 1, 1)), np.tile(u, (N, 1))
    motion = Motion(qs, vs, us, given_lengths(problem))
    return formulation.iterate_of(motion, np.tile(lam, (N, 1)))
