"""Steps and times to an error, and the rival: the same equations as Gauss's methods of mbocp."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbocp
from benchmarks.collocation import Collocation
from benchmarks.newton import EXAMPLES
from benchmarks.work_precision import SYSTEMS, Log, Point, measure, reached
from mbocp.formulation import formulate
from mbocp.guesses import guess_candidates, make_guess


def points(order: float, first: float) -> list[Point]:
    """Errors that fall with a power of the steps, times that grow with it."""
    return [Point(n, 1e-5 * n, 1, first * (10 / n) ** order, 0.0, 0.0) for n in (10, 20, 40, 80)]


@given(st.floats(1.0, 6.0), st.floats(1e-3, 1.0))
def test_steps_to_an_error(order: float, first: float) -> None:
    asked = 3e-4
    steps, seconds, mark = reached(points(order, first), asked)
    assert steps == pytest.approx(10 * (first / asked) ** (1 / order), rel=1e-9)
    assert seconds == pytest.approx(1e-5 * steps, rel=1e-9)
    assert mark == ("~" if steps > 80.0 else "")


def test_errors_that_are_small_from_the_first_steps_on_or_do_not_fall() -> None:
    assert reached(points(2.0, 1e-5), 1e-4) == (10, 1e-4, "<")
    flat = [replace(p, cost=0.1) for p in points(2.0, 1.0)]
    assert np.isnan(reached(flat, 1e-4)[0])
    assert np.isnan(reached([], 1e-4)[0])


SMALL = SYSTEMS[0]  # the elastic pendulum


def test_points_are_known_from_then_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    schemes, path = ("midpoint", "gauss2/stages", "ipopt/gauss2"), tmp_path / "points.jsonl"
    found = measure(SMALL, schemes, 3, Log(path))
    assert [len(points) for points in found.values()] == [3, 3, 3]
    own, rival = found["midpoint"][-1], found["ipopt/gauss2"][-1]
    assert own.functions == 0.0
    assert 0.0 < rival.functions < rival.seconds
    assert rival.motion < own.motion  # order four in place of two
    assert len(path.read_text().splitlines()) == 9

    def solve(*_: object) -> None:
        raise AssertionError("a point that is known is measured again")

    monkeypatch.setattr("benchmarks.work_precision.mbocp.solve", solve)
    monkeypatch.setattr(Collocation, "solve", solve)
    assert str(measure(SMALL, schemes, 3, Log(path))) == str(found)  # with NaN


def test_what_would_take_too_long_is_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "points.jsonl"
    found = measure(SMALL, ("midpoint",), 4, Log(path), limit=1e-6)
    assert [point.steps for point in found["midpoint"]] == [20]
    assert "midpoint: 40 steps and more would take over 1e-06 s" in capsys.readouterr().out
    assert "left out" in json.loads(path.read_text().splitlines()[-1])


def test_systems_exist() -> None:
    for system in SYSTEMS:
        problem = system.problem
        assert problem.goal.is_exact
        assert not problem.inequalities


@pytest.mark.parametrize("controls", ["constant", "stages"])
@pytest.mark.parametrize(("file", "steps"), [("paper/elastic_pendulum", 10), ("optima/cart_pole", 20)])
def test_the_rival_solves_the_same_problem(file: str, steps: int, controls: str) -> None:
    """With constant masses the very same equations; else with errors of a higher order between them."""
    problem = mbocp.load_problem(EXAMPLES / f"{file}.toml", [f"horizon.steps={steps}"])
    problem = problem.with_(scheme="gauss2", controls=controls, limits={})
    own = mbocp.solve(problem, check=True)
    formulation = formulate(problem)
    begin = formulation.motion_of(make_guess(guess_candidates(problem)[0], formulation)[0])
    rival = Collocation(problem, 2, at_stages=controls == "stages", is_compiled=False).solve(begin)
    assert rival.converged
    assert rival.cost == pytest.approx(own.cost, rel=1e-8 if "elastic" in file else 5e-3)
