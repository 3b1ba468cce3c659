"""Guesses go around obstacles, and the solvers from there agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mbocp
from benchmarks.scenes import scene
from mbocp.guesses import around as search
from mbocp.guesses.around import around, has_no_way
from mbocp.guesses.ways import straight
from mbocp.problem import Problem, load_problem
from mbocp.solution import Solution
from mbocp.view.marks import marks_of, marks_of_result

SLALOM = Path(__file__).parents[2] / "examples/arms/slalom.toml"


@pytest.fixture(scope="module")
def slalom() -> Problem:
    return load_problem(SLALOM, ["integrator.scheme=se1", "horizon.steps=30"])


@pytest.fixture(scope="module")
def solved(slalom: Problem) -> Solution:
    return mbocp.solve(slalom, solver="monolithic")


def least(problem: Problem, qs: np.ndarray) -> float:
    return float((problem.clearance.values_along(problem.robot, qs, qs, qs) - problem.clearance.lower).min())


def test_the_way_is_clear_and_the_line_is_not(slalom):
    shares = np.linspace(0.0, 1.0, 300)
    assert least(slalom, straight(slalom)(slalom.q_start, shares)) < -0.05
    qs = around(slalom)(slalom.q_start, shares)
    assert least(slalom, qs) > 0.0
    np.testing.assert_allclose(qs[[0, -1]], [slalom.q_start, slalom.goal.q], atol=1e-12)
    assert np.abs(np.diff(qs, axis=0)).max() < 0.1
    np.testing.assert_array_equal(around(slalom)(slalom.q_start, shares), qs)


def test_without_an_obstacle_in_between_there_is_no_search(slalom):
    assert around(slalom.with_(obstacle=slalom.obstacle[2:])) is None
    assert around(slalom.with_(obstacle=())) is None


def test_monolithic_goes_around(slalom, solved):
    assert solved.converged
    assert solved.guess_used == "a way around obstacles, inverse dynamics"
    assert solved.limit_violation < 1e-8
    assert solved.clearance > 0.01
    assert solved.clearance_between in ("wrist_3_link and box", "wrist_3_link and ball")
    active = [limit for limit in solved.active_limits if limit.kind == "path"]
    assert active
    assert all("from box" in limit.name or "from ball" in limit.name for limit in active)
    free = mbocp.solve(slalom.with_(obstacle=()), solver="monolithic")
    assert free.cost < solved.cost
    assert least(slalom, free.qs) < -0.05


def test_ipopt_agrees(slalom, solved):
    """There is more than one optimum: what each of them finds, the other keeps."""
    other = mbocp.solve(slalom, solver="ipopt")
    assert other.converged
    for start, solver in ((solved, "ipopt"), (other, "monolithic")):
        again = mbocp.solve(slalom, solver=solver, warm_start=start)
        assert again.converged
        assert again.cost == pytest.approx(start.cost, rel=1e-6)
        np.testing.assert_allclose(again.qs, start.qs, atol=1e-4)


def test_a_saved_result_has_clearance_and_obstacles(slalom, solved, tmp_path):
    loaded = Solution.load(solved.save(tmp_path / "slalom.h5"))
    assert loaded == solved
    assert loaded.to_dict()["clearance"] == solved.clearance
    drawn = marks_of_result(loaded, slalom.robot).obstacles
    assert [o.name for o in drawn] == [o.name for o in marks_of(slalom).obstacles] == ["box", "ball", "floor"]
    for one, other in zip(drawn, slalom.obstacle, strict=True):
        np.testing.assert_array_equal(one.sizes, other.sizes)
        np.testing.assert_array_equal(one.position, other.position)


def test_where_no_way_is_found_the_result_says_so():
    shut = scene("ur5", 47)
    assert around(shut) is None
    assert has_no_way(shut)
    solution = mbocp.solve(shut, solver="monolithic")
    assert not solution.converged
    assert solution.advice.endswith("no way around the obstacles: there may be none")


def test_of_a_clear_line_nobody_says_that_there_is_no_way(slalom):
    assert not has_no_way(slalom)
    assert not has_no_way(slalom.with_(obstacle=slalom.obstacle[2:]))


def test_a_second_search_looks_farther(monkeypatch):
    """The first finds nothing between these obstacles."""
    assert around(scene("ur5", 27)) is not None
    monkeypatch.setattr(search, "_LONGER", 1)
    assert around(scene("ur5", 27)) is None


def test_a_warm_start_keeps_rows_and_room(slalom, solved):
    warm = mbocp.solve(slalom, warm_start=solved, check=True)
    assert warm.iterations <= 1
    assert warm.cost == pytest.approx(solved.cost, rel=1e-9)


def test_further_pairs_take_rows_that_are_free():
    clearance = scene("ur5", 0).clearance
    every = range(clearance.num_pairs)
    filled = clearance.fill([5], [k for k in every if k != 5])
    assert 5 in filled
    assert 1 < len(filled) < clearance.num_pairs
    assert clearance.of_pairs(filled).rows == clearance.of_pairs([5]).rows
    assert clearance.fill(every, []) == tuple(every)
