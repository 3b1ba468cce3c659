"""Multipliers that Newton begins with where states are curved."""

from __future__ import annotations

import numpy as np
import pytest

import mbocp
from mbocp.formulation import formulate
from mbocp.guesses import make_guess
from mbocp.problem import Problem
from mbocp.programme.kernel import kernel_programme
from mbocp.solvers import GlobalisedNewton


def flight() -> Problem:
    robot = mbocp.load_robot("hector", actuated=["root_joint"], damping=False)
    goal = robot.integrate(robot.q0, np.array([1.0, -0.5, 0.7, 0.4, -0.8, 1.2]))
    cost = {"effort": 1.0, "velocity": 1.0}
    return Problem.create(robot, 1.5, 30, goal={"q": goal, "v": np.zeros(6)}, cost=cost, scheme="se1")


def reach() -> Problem:
    q, v = [0.5, -1.0, 0.8, 0.1, 0.3, 0.0], np.zeros(6)
    return Problem.create(
        "ur5", 1.0, 20, goal={"q": q, "v": v}, cost={"effort": 1.0, "velocity": 1.0}, scheme="se1"
    )


def test_where_states_are_curved_multipliers_explain_the_gradient() -> None:
    formulation = formulate(flight())
    programme = formulation.programme
    guess, _ = make_guess("line", formulation)
    bare = kernel_programme(programme)
    guess.load_into(bare)
    plain = bare.evaluate()
    state = GlobalisedNewton(control_weight=programme.control_weight).init(programme, guess)
    assert state.evaluation.dual <= 0.2 * plain.dual
    assert state.evaluation.primal == pytest.approx(plain.primal, rel=1e-12)
    assert np.array_equal(state.native.x, bare.x)


def test_plain_states_begin_without() -> None:
    formulation = formulate(reach())
    guess, _ = make_guess("line", formulation)
    programme = formulation.programme
    state = GlobalisedNewton(control_weight=programme.control_weight).init(programme, guess)
    assert not state.native.m.any()
