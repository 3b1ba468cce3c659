"""As few steps as an accuracy needs: fewer than equal ones, and errors just below what was asked for."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.accuracy.costs import CostLimit
from mbocp.accuracy.errors import step_errors
from mbocp.accuracy.mesh import ErrorTargets, lengths_for
from mbocp.accuracy.rounds import Round
from mbocp.accuracy.solution_accuracy import motion_of
from mbocp.cli.solution_summary import solution_rows
from tests.phases.test_partings import thrown

EXAMPLES = Path(__file__).parents[2] / "examples"
COSTS = json.loads((Path(__file__).parents[1] / "data/reference_costs.json").read_text())


def problem(file: str, **changes: Any) -> mbocp.Problem:
    return mbocp.load_problem(EXAMPLES / f"{file}.toml").with_(**changes)


def away(s: mbocp.Solution, name: str) -> float:
    return float(abs(s.cost / COSTS[name]["cost"] - 1.0))


@pytest.mark.parametrize(
    ("file", "scheme", "controls"),
    [
        ("paper/elastic_pendulum", "gauss2", "stages"),
        ("paper/rigid_pendulum", "lobatto3", "stages"),
        ("paper/rigid_pendulum", "lobatto3", "constant"),
        ("optima/cart_pole", "gauss2", "stages"),
        pytest.param("arms/ur5_reach", "gauss2", "stages", marks=pytest.mark.slow),
        pytest.param("loops/four_bar", "lobatto3", "stages", marks=pytest.mark.slow),
    ],
)
def test_fewer_steps_than_equal_ones_and_errors_just_below(file: str, scheme: str, controls: str) -> None:
    """As many equal steps are less exact, and what is told is the error."""
    name, asked = Path(file).name, 1e-6
    case = problem(file, limits={}, scheme=scheme, controls=controls)
    s = mbocp.solve(case.with_(accuracy=asked))
    assert s.converged, s.advice
    told = s.accuracy
    assert told.local_error <= asked
    assert told.cost_error <= asked
    assert max(told.cost_error, told.local_error) > 0.8 * asked
    assert 0.5 * told.cost_error <= away(s, name) <= 1.02 * told.cost_error
    equal = mbocp.solve(case.with_(num_steps=s.num_steps), warm_start=s, check=True)
    assert away(equal, name) > away(s, name)


@pytest.mark.slow
def test_what_is_told_of_a_light_wrist_is_no_tenth_of_its_error() -> None:
    """Where costs of steps that are halved happen to agree, the steps of other rounds do not."""
    case = problem("arms/panda_reach", scheme="gauss2", controls="stages")
    s = mbocp.solve(case.with_(accuracy=1e-6))
    assert s.converged, s.advice
    assert away(s, "panda_reach") <= 1.1 * s.accuracy.cost_error


def test_two_rounds_whose_costs_tend_to_different_ones_are_not_both_believed() -> None:
    """Both say that the cost is exact enough, and differ by more than either allows."""
    case = problem("paper/elastic_pendulum", scheme="gauss2", controls="stages", accuracy=1e-3)
    pair = [mbocp.solve(case.with_(accuracy=None, num_steps=steps)) for steps in (30, 60)]
    found = Round.of(case, case.with_(accuracy=None, num_steps=60), pair, deadline=np.inf)
    coarse = mbocp.solve(case.with_(accuracy=None, num_steps=15))
    alone = found.compare_with([coarse], None)
    assert alone.is_enough
    beside = found.compare_with([coarse], found)
    assert beside.error == alone.error
    elsewhere = replace(found, limit=CostLimit(1.01 * found.limit.value, 1e-6))
    assert elsewhere.has_cost
    doubted = found.compare_with([coarse], elsewhere)
    assert doubted.error == pytest.approx(0.01 * found.limit.value, rel=0.01)
    assert not doubted.is_enough


def test_shares_by_adjoints_make_better_steps_than_local_errors_do() -> None:
    """As many steps, placed by either, against the limit of the cost."""
    case = problem("paper/elastic_pendulum", scheme="gauss2", controls="stages", num_steps=64)
    equal = mbocp.solve(case, check=True)
    motion = motion_of(equal)
    errors = step_errors(case.robot, motion, adjoints=equal.mus)
    plain = step_errors(case.robot, motion)
    np.testing.assert_array_equal(plain.costs, plain.largest)
    np.testing.assert_array_equal(errors.largest, plain.largest)
    nothing = step_errors(case.robot, motion, adjoints=np.zeros_like(equal.mus))
    assert not nothing.costs.any()
    twice = step_errors(case.robot, motion, adjoints=2.0 * equal.mus)
    np.testing.assert_allclose(twice.costs, 2.0 * errors.costs, rtol=1e-12)

    def placed(shares: np.ndarray) -> float:
        target = ErrorTargets(1.0, 4, 0.6 * float(shares.sum()), 4)
        lengths = lengths_for(motion.dts, plain.largest, shares, target, most=1000, in_pairs=False)
        s = mbocp.solve(case.with_(num_steps=len(lengths), lengths=lengths), warm_start=equal, check=True)
        return away(s, "elastic_pendulum") * len(lengths) ** 4

    weighed, unweighed = placed(errors.costs), placed(plain.largest)
    assert weighed < unweighed
    assert weighed < 0.6 * away(equal, "elastic_pendulum") * 64**4


@pytest.mark.parametrize("asked", [1e-3, 1e-4])
def test_a_motion_that_costs_nothing_ends(asked: float) -> None:
    """No part of zero can be asked for: steps are as short as the local error wants them."""
    s = mbocp.solve(problem("walking/compass_gait", accuracy=asked))
    assert s.converged, s.advice
    assert s.cost < 1e-20
    assert s.accuracy.cost_error == 0.0
    assert 0.2 * asked < s.accuracy.local_error <= asked
    assert s.num_steps < 60
    text = "\n".join(str(cell) for _, cell in solution_rows(s, ""))
    assert f"{asked:g} was asked for: {s.num_steps} steps" in text
    assert "the cost is zero" in text


def test_a_throw_is_told_within_a_factor_of_its_error() -> None:
    """Of costs of coarse steps that fall faster than any order, the last two tell."""
    case = thrown()
    s = mbocp.solve(case.with_(accuracy=1e-2))
    assert s.converged, s.advice
    assert s.accuracy.cost_error < 5e-3  # the largest difference of all is 6e-2
    assert abs(s.cost / 0.9431833 - 1.0) <= s.accuracy.cost_error


def test_fewer_steps_in_which_a_joint_turns_too_far_are_not_taken() -> None:
    """26 steps have the error that was asked for, and a joint turns by more than 1 rad in one of them."""
    words: dict[str, Any] = {"start": {"q": [0.3, -0.2]}, "goal": {"q": [1.4, 0.5], "v": 0}}
    case = mbocp.Problem.create("double_pendulum", 1.0, 26, cost={"effort": 1.0}, scheme="gauss2", **words)
    s = mbocp.solve(case.with_(accuracy=0.01))
    assert s.converged, s.advice
    assert s.num_steps > 26
