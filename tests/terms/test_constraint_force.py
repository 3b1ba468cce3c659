"""`cost.constraint_force`: what feet that stand press with, and where there are no feet."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import mbocp
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.terms import running_cost, terminal_cost
from tests.problem.file.test_ground import solo as on_phases
from tests.terms.contacts import BODY, FOOT, GRAVITY, hopper


def test_the_ground_bears_what_the_leg_pushes(tmp_path: Path) -> None:
    """The force on the foot is the leg's and the foot's weight, so that either weight leads to one motion."""
    costs = ({"effort": 1e-3}, {"effort": 1e-9, "constraint_force": 1e-3})
    pushed, borne = (mbocp.solve(hopper(tmp_path, cost=cost), check=True) for cost in costs)
    np.testing.assert_allclose(borne.qs, pushed.qs, atol=1e-6)
    assert borne.cost > 1.1 * pushed.cost  # of the foot's weight, too
    assert -np.mean(borne.lams) == pytest.approx(GRAVITY * (BODY + FOOT), rel=1e-6)


def stepping(**words: Any) -> Problem:
    """Two feet stand, and all: an impact in between."""
    phase = [
        {"name": name, "steps": 4, "duration": 0.1, "contacts": feet}
        for name, feet in (("two", ["FR", "HL"]), ("all", ["FL", "FR", "HL", "HR"]))
    ]
    cost = {"effort": 1.0, "velocity": 0.01, "constraint_force": 0.02}
    return on_phases(phase, **{"cost": cost, "limits": {"position": True}, **words})


def test_the_cost_by_hand() -> None:
    problem = stepping()
    solution = mbocp.solve(problem, check=True)
    dts, timed, total = problem.timeline.lengths(), ~problem.timeline.is_impact, 0.0
    for n in np.flatnonzero(timed):
        u, v, lam = solution.us[n], solution.vs[n + 1], solution.lams[n]
        total += dts[n] / 2 * (u @ u + 0.01 * v @ v + 0.02 * lam @ lam)
    assert solution.cost == pytest.approx(total, rel=1e-9)
    assert (np.abs(solution.lams[timed][:4]).max(axis=0) > 0.0).sum() == 6  # of feet in the air there is none
    assert problem_to_toml(parse_problem(problem_to_toml(problem))) == problem_to_toml(problem)


def test_terms_of_ones_own_look_at_forces() -> None:
    """The same cost, foot by foot; and one that keeps forces within cones, as a penalty."""
    weighs, asks = stepping(), stepping(cost={"effort": 1.0, "velocity": 0.01})
    feet = ("FL", "FR", "HL", "HR")

    def pressed(at):
        return sum(ca.sumsqr(at.force(foot)) for foot in feet) / 2

    def slips(at):
        forces = [at.force(foot) for foot in feet]
        return sum(ca.fmax(ca.norm_2(f[:2] + 1e-9) - at["friction"] * f[2], 0) ** 2 for f in forces)

    expected = mbocp.solve(weighs)
    found = mbocp.solve(asks.with_(terms=[running_cost(pressed, weight=0.02)]), check=True)
    assert found.cost == pytest.approx(expected.cost, rel=1e-9)
    np.testing.assert_allclose(found.lams, expected.lams, atol=1e-6)
    free, kept = (
        mbocp.solve(asks.with_(terms=[running_cost(slips, weight=weight, friction=0.05)]))
        for weight in (0.0, 1e3)
    )
    timed = ~asks.timeline.is_impact
    beyond = [
        np.max(np.hypot(lam[:, 0::3], lam[:, 1::3]) - 0.05 * np.abs(lam[:, 2::3]))
        for lam in (free.lams[timed], kept.lams[timed])
    ]
    assert kept.converged
    assert beyond[1] < 0.2 * beyond[0]


def test_forces_that_are_not_there_are_refused() -> None:
    def presses(at):
        return at.force("nose")[2] ** 2

    with pytest.raises(ProblemError, match=r"terms: presses: robot .* has no constraint 'nose'"):
        stepping(terms=[running_cost(presses)])
    with pytest.raises(ProblemError, match="terms: presses: robot 'double_pendulum' has no constraints"):
        Problem.create("double_pendulum", 1.0, 5, scheme="se1", terms=[running_cost(presses)])
    with pytest.raises(ProblemError, match=r'terms: presses: scheme = "rk4".*se1'):
        Problem.create("double_pendulum", 1.0, 5, scheme="rk4", terms=[running_cost(presses)])
    with pytest.raises(ProblemError, match="presses: a terminal cost has no forces of constraints"):
        stepping(terms=[terminal_cost(presses)])


def test_what_is_refused() -> None:
    words: dict[str, Any] = {"goal": {"q": [1, 1], "v": 0}, "cost": {"constraint_force": 1.0}}
    with pytest.raises(ProblemError, match="constraint_force: robot 'double_pendulum' has no constraints"):
        Problem.create("double_pendulum", 1.0, 5, scheme="se1", **words)
    with pytest.raises(ProblemError, match=r'constraint_force: scheme = "rk4".*se1'):
        Problem.create("double_pendulum", 1.0, 5, scheme="rk4", **words)
    with pytest.raises((ProblemError, InvalidValue), match="constraint_force"):
        stepping(cost={"constraint_force": -1.0})
