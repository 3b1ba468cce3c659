"""Path constraints and obstacles of a motion as it is sent, and motions of schemes of first order."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import typer

import mbocp
from mbocp import Problem, Solution
from mbocp.cli.results import export
from mbocp.exceptions import LimitsExceeded
from mbocp.solution.sent import compute_motion_sent
from mbocp.solution.sent_checks import check_sent, path_excesses
from mbocp.solution.sent_states import Follower

EXAMPLES = Path(__file__).parents[2] / "examples"
LINE = EXAMPLES / "arms" / "straight_line.toml"
SLALOM = EXAMPLES / "arms" / "slalom.toml"


def test_a_line_that_is_left_between_nodes_is_told(tmp_path: Path) -> None:
    """The largest distance is that of Pinocchio's own kinematics, in a closer look."""
    problem = mbocp.load_problem(LINE).with_(steps=10, integrator={"scheme": "rk4"})  # no rows within steps
    solution = mbocp.solve(problem)
    assert "between nodes the path constraint line of tool0" in solution.advice
    sent = compute_motion_sent(solution, 1000.0)
    (found,), unseen = path_excesses(Follower.of(sent, problem.robot), problem)
    assert not unseen
    robot, frame = problem.robot, problem.robot.frame_id("tool0")
    places = []
    for q in sent.curves.at(np.linspace(0.0, solution.duration, 4001))[0]:
        pin.framesForwardKinematics(robot.model, data := robot.model.createData(), q)
        places.append(data.oMf[frame].translation.copy())
    ways = np.array(places) - places[0]
    along = ways[-1] / np.linalg.norm(ways[-1])
    away = np.linalg.norm(ways - np.outer(ways @ along, along), axis=1).max()
    assert (found.name, found.bound) == ("line of tool0", 0.001)
    assert found.value == pytest.approx(away, rel=0.02)
    assert found.value > 0.0015
    assert found.words.endswith(" beyond 0.001")
    given = {"kind": None, "rate": 500.0, "interpolation": None, "fit": True, "check": True, "quiet": True}
    result, table = tmp_path / "a.h5", tmp_path / "a.csv"
    warned = pytest.warns(UserWarning, match=r"line of tool0 leaves its limits: 0\.00\d+ m at")
    with pytest.warns(UserWarning, match="under_resolved"), warned, pytest.raises(typer.Exit):
        export(solution.save(result), table, **given)
    assert not table.exists()
    fine = mbocp.solve(mbocp.load_problem(LINE), check=True)
    export(fine.save(result), table, **given)
    assert table.exists()


def bend(more: float = 0.0) -> dict[str, Any]:
    """A path from where the tool is at the start, longer by so much [m]."""
    points = [[0, 0, 0], [0.02, 0.1, 0.05], [0, 0.2 + more, 0]]
    return {"kind": "follow", "frame": "tool0", "points": points, "relative": True, "tolerance": 0.002}


def smooth_bend(scheme: str, steps: int) -> Solution:
    """A tool along a bend in the least time, jerks limited."""
    return mbocp.solve(
        Problem.create(
            "ur5",
            {"min": 0.3, "max": 8, "guess": 1.5},
            steps,
            start={"q": [0, -1.57, 1.57, -1.57, -1.57, 0]},
            goal={"v": 0},
            path=[bend()],
            cost={"time": 1.0, "effort": 1e-5, "velocity": 1e-2},
            limits={"acceleration": 15.0, "jerk": 150.0},
            scheme=scheme,
        ),
        check=True,
    )


def test_what_smoothing_leaves_of_a_path_falls_with_the_steps_as_advice_says(tmp_path: Path) -> None:
    """Jerks of a scheme with one acceleration in each step are kept by a mean over one step, to the end."""
    table = tmp_path / "a.csv"
    with pytest.raises(LimitsExceeded, match='take scheme = "midpoint" and controls = "constant"'):
        smooth_bend("gauss2", 12).export(table, rate=1000)
    with pytest.raises(LimitsExceeded, match=r"follow of tool0: 0\.0026.*take about 30 steps"):
        smooth_bend("midpoint", 12).export(table, rate=1000)
    fine = smooth_bend("midpoint", 20)
    assert compute_motion_sent(fine, 1000.0, fit=True).mean == pytest.approx(fine.t[1], rel=1e-6)
    assert fine.export(table, rate=1000).exists()


def test_what_is_sent_may_end_a_thousandth_of_a_path_before_it() -> None:
    """Round-off of a smooth motion is no excess; a millimetre is one."""
    solution = smooth_bend("midpoint", 20)
    follower = Follower.of(compute_motion_sent(solution, 1000.0, fit=True), solution.load_robot())
    for more, is_left in ((1e-6, False), (2e-3, True)):
        problem = solution.load_problem().with_(path=[bend(more)])
        found, _ = path_excesses(follower, problem)
        assert any(one.name.endswith(".end") for one in found) == is_left


def test_a_constraint_is_looked_at_while_it_holds() -> None:
    problem = mbocp.load_problem(LINE).with_(steps=10, integrator={"scheme": "rk4"})  # no rows within steps
    solution = mbocp.solve(problem)
    sent = compute_motion_sent(solution, 1000.0)
    (whole,), _ = path_excesses(Follower.of(sent, problem.robot), problem)
    tables = {"kind": "line", "frame": "tool0", "tolerance": 0.001}
    before = whole.time * 10 // 1.5 * 0.15 - 0.15  # the node before the step before that
    for until, is_left in ((before, False), (None, True)):
        path = [tables | ({} if until is None else {"until": until})]
        (line,) = problem.with_(path=path).path
        found, _ = path_excesses(Follower.of(sent, problem.robot), dataclasses.replace(problem, path=(line,)))
        assert ((found[0].value if found else 0.0) == whole.value) == is_left


def test_what_is_touched_as_it_is_sent_is_told() -> None:
    problem = mbocp.load_problem(SLALOM)
    blind = mbocp.solve(problem.with_(obstacle=[]), check=True)
    excesses, _ = check_sent(compute_motion_sent(blind, 1000.0), problem)
    (nearest,) = [one for one in excesses if one.kind == "path"]
    assert nearest.name.split(" and ")[1] in ("box", "ball")
    assert nearest.value < 0.0
    clear = mbocp.solve(problem, check=True)
    assert check_sent(compute_motion_sent(clear, 1000.0), problem) == ((), ())


def test_forces_and_bodies_that_are_not_sent_are_named() -> None:
    problem = mbocp.load_problem(EXAMPLES / "arms" / "pick_and_place.toml")
    solution = mbocp.solve(problem)
    excesses, unseen = path_excesses(
        Follower.of(compute_motion_sent(solution, 1000.0), problem.robot), problem
    )
    assert {"level", "contact_force of grip"} <= set(unseen)
    assert "straight down" not in unseen
    assert not excesses


@pytest.mark.parametrize("steps", [20, 60])
def test_a_motion_of_first_order_has_the_accelerations_of_its_scheme(steps: int) -> None:
    """Cubics through the nodes have four times as large ones; those through the middles have its own."""
    problem = mbocp.load_problem(EXAMPLES / "arms" / "ur5_fastest.toml").with_(
        steps=steps, scheme="se1", limits={"acceleration": 20.0}
    )
    solution = mbocp.solve(problem, check=True)
    accelerations = np.diff(solution.vs, axis=0) / np.diff(solution.t)[:, None]
    assert np.abs(accelerations).max() == pytest.approx(20.0, rel=1e-3)
    sent = compute_motion_sent(solution)
    assert sent.excesses == ()
    assert sent.lag == pytest.approx(solution.t[1] / 2.0)
    assert sent.curves.nodes[-1] == pytest.approx(solution.duration)
    found = sent.curves.places(4)[1][2][1::5]
    np.testing.assert_allclose(found, accelerations, atol=1e-6)
    positions = sent.curves.at(sent.times_of(solution.t[1:-1]))[0]
    apart = np.abs(positions - solution.qs[1:-1]).max()
    assert apart < 20.0 * solution.t[1] ** 2 / 8.0 * 1.001  # of a chord from a parabola


def test_a_motion_of_first_order_that_ends_in_motion_ends_where_it_does() -> None:
    problem = mbocp.load_problem(EXAMPLES / "arms" / "ur5_reach.toml").with_(
        steps=30, scheme="se1", goal={"q": [0.6, -1.2, 1.0, -1.3, -1.5, 0.3], "v": [0.1] * 6}
    )
    solution = mbocp.solve(problem, check=True)
    curves = compute_motion_sent(solution).curves
    np.testing.assert_array_equal(curves.q[-1], solution.qs[-1])
    np.testing.assert_array_equal(curves.v[-1], solution.vs[-1])
    assert curves.nodes[-1] == pytest.approx(solution.duration + solution.t[1] / 2.0)


@pytest.mark.parametrize("has_rest", [True, False])
def test_a_motion_of_first_order_that_begins_in_motion_has_little_more_than_its_accelerations(
    *, has_rest: bool
) -> None:
    """Four times as much before; the scheme's own after ten steps, and at the start a fifth more."""
    v = [0.3, -0.5, 0.4, 0.2, -0.3, 0.5]
    problem = mbocp.load_problem(EXAMPLES / "arms" / "ur5_reach.toml")
    problem = problem.with_(
        steps=60,
        scheme="se1",
        start={"q": problem.q_start, "v": v},
        goal={"q": problem.goal.q, "v": [0.0] * 6 if has_rest else v},
        limits={"acceleration": 20.0},
    )
    solution = mbocp.solve(problem, check=True)
    h = solution.t[1]
    accelerations = np.diff(solution.vs, axis=0) / h
    first = np.abs(accelerations[0])
    assert first.max() > 19.0  # nearly at its limit from the start
    sent = compute_motion_sent(solution)
    curves = sent.curves
    assert sent.lag == 0.0
    ends = (0, len(solution.t) - 1)
    np.testing.assert_allclose(curves.q[[0, -1]], solution.qs[list(ends)], atol=1e-9)
    np.testing.assert_allclose(curves.v[[0, -1]], solution.vs[list(ends)], atol=1e-9)
    steps = curves.places(4)[1][2].reshape(len(curves.nodes) - 1, 5, 6)
    np.testing.assert_allclose(steps[10:60], np.repeat(accelerations[10:, None], 5, axis=1), atol=1e-6)
    assert (np.abs(steps[:10]).max(axis=(0, 1)) < np.abs(accelerations[:11]).max(axis=0) + 0.22 * first).all()
    positions = curves.at(solution.t[1:])[0]
    assert (np.abs(positions - solution.qs[1:]).max(axis=0) < 0.8 * first * h**2 + 20.0 * h**2 / 8.0).all()
