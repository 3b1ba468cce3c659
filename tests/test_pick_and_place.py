"""Examples of holds: an arm picks up a box and puts it down elsewhere, a linkage wipes along a table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp import Problem, Solution
from mbocp._arrays import Array

pytestmark = pytest.mark.slow  # compiling takes minutes

EXAMPLES = Path(__file__).parents[1] / "examples"
FROM, TO = np.array([0.45, -0.25, 0.14]), np.array([0.30, 0.45, 0.14])  # [m] the box on its tables
MASS = 1.0  # [kg] of the box


@pytest.fixture(scope="module")
def problem() -> Problem:
    return mbocp.load_problem(EXAMPLES / "arms" / "pick_and_place.toml")


@pytest.fixture(scope="module")
def solved(problem: Problem) -> Solution:
    return mbocp.solve(problem, check=True)


def nodes(problem: Problem, name: str) -> slice:
    """Of a phase, both ends included."""
    names = [phase.name for phase in problem.phase]
    ends = np.cumsum([0, 21, 32, 21])  # steps with impacts and partings
    k = names.index(name)
    return slice(int(ends[k]), int(ends[k + 1]) + 1)


def test_newtons_method_solves_it_alone(solved: Solution) -> None:
    assert [phase.name for phase in solved.phases if phase.iterations] == ["monolithic"]


def test_the_box_goes_from_table_to_table(problem: Problem, solved: Solution) -> None:
    box = solved.qs[:, 6:9]
    np.testing.assert_allclose(box[nodes(problem, "approach")], np.tile(FROM, (22, 1)), atol=1e-9)
    np.testing.assert_allclose(box[nodes(problem, "retreat")], np.tile(TO, (22, 1)), atol=1e-9)
    assert box[:, 2].min() > 0.14 - 1e-3  # never inside a table


def test_the_cup_holds_it_on_the_way(problem: Problem, solved: Solution) -> None:
    robot = problem.robot
    held = [
        robot.frame_placement("arm/tool0", q).actInv(robot.frame_placement("box/body", q))
        for q in solved.qs[nodes(problem, "carry")]
    ]
    np.testing.assert_allclose(held[0].translation, [0.0, 0.0, 0.16], atol=1e-6)
    for placed in held:
        assert np.linalg.norm(placed.translation - held[0].translation) < 1e-9
        assert np.linalg.norm(pin.log3(held[0].rotation.T @ placed.rotation)) < 1e-8


def test_the_arm_comes_from_above_and_rests(problem: Problem, solved: Solution) -> None:
    robot = problem.robot
    for name in ("at the box", "at its place"):
        node = next(point.node for point in problem.timeline.waypoints if point.name == name)
        assert np.abs(solved.vs[node, :6]).max() < 1e-8
        assert robot.frame_placement("arm/tool0", solved.qs[node]).rotation[2, 2] == pytest.approx(
            -1.0, abs=1e-9
        )


def forces_of(problem: Problem, solved: Solution, constraint: str) -> Array:
    contact = next(one for one in problem.contacts if one.contact.constraint == constraint)
    return np.asarray(contact.wrenches(solved.lams))


def test_tables_push_and_the_cup_pulls_no_more_than_it_can(problem: Problem, solved: Solution) -> None:
    table = forces_of(problem, solved, "on the table")
    at_rest = table[1:19]  # the box stands still, whatever the arm does
    np.testing.assert_allclose(at_rest[:, 0], 9.81 * MASS, rtol=1e-9)
    grip = forces_of(problem, solved, "grip")
    assert grip[:, 0].min() >= -20.0 - 1e-6
    assert np.linalg.norm(grip[:, :3], axis=1).max() <= 25.0 + 1e-6
    assert solved.limit_violation < 1e-6


def test_a_tip_wipes_along_a_table() -> None:
    problem = mbocp.load_problem(EXAMPLES / "loops" / "polish.toml")
    solution = mbocp.solve(problem, check=True)
    wipe = slice(30, 82)  # 50 steps and a parting
    tip = np.array([problem.robot.frame_placement("linkage/left_tip", q).translation for q in solution.qs])
    np.testing.assert_allclose(tip[wipe, 2], 0.45, atol=1e-9)
    assert tip[:, 2].min() > 0.45 - 2e-3
    force = forces_of(problem, solution, "table")[30:81, 0]
    force[-2] += force[-1] / (solution.t[80] - solution.t[79])  # the parting's impulse is part of it
    assert force[:-1].min() == pytest.approx(20.0, abs=1e-5)  # it presses
    assert force[:-1].max() <= 40.0 + 1e-6
    soft = problem.timeline.switches.in_step(solution.qs[30], 30) @ solution.vs[30]  # type: ignore[union-attr]
    assert abs(soft[-1]) < 1e-8  # it lands without a knock
    assert np.abs(problem.robot.closure_along(solution.qs)[0][:, list(problem.robot.kept_rows)]).max() < 1e-9
