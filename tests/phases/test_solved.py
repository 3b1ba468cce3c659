"""Motions in phases: the same as one horizon where nothing differs, optima where lengths are free."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from mbocp import Problem, Solution, load_robot, solve
from mbocp.formulation import formulate
from mbocp.solution.export import solution_dict

UR5 = load_robot("ur5")
GOAL = {"q": [0.5, -1.0, 1.0, 0.0, 0.5, 0.0], "v": 0}
COST = {"velocity": 300.0}
FREE = {"min": 0.2, "max": 0.8}


def in_phases(*phases: dict[str, Any], **more: Any) -> Problem:
    named = [{"name": f"p{i}", "steps": 6, "duration": 0.5, **phase} for i, phase in enumerate(phases)]
    return Problem.create(
        UR5, phase=named, **{"integrator": {"scheme": "se1"}, "goal": GOAL, "cost": COST, **more}
    )


def optimum(problem: Problem) -> Solution:
    found = solve(problem)
    assert found.converged, found.advice
    return found


@pytest.mark.parametrize("coordinates", ["joint", "natural"])
def test_phases_in_which_nothing_differs_are_one_horizon(coordinates: str) -> None:
    whole = optimum(Problem.create(UR5, 1.0, 12, goal=GOAL, cost=COST, coordinates=coordinates, scheme="se1"))
    cut = optimum(in_phases({}, {}, coordinates=coordinates))
    assert np.array_equal(whole.qs, cut.qs)
    assert np.array_equal(whole.us, cut.us)
    assert cut.phase_times == {"p0": (0.0, 0.5), "p1": (0.5, 1.0)}


def test_steps_of_given_lengths_that_differ_are_no_unknowns() -> None:
    problem = in_phases({"duration": 0.3}, {"duration": 0.7})
    assert "h" not in formulate(problem).layout.states
    found = optimum(problem)
    fixed = optimum(
        in_phases({"duration": {"min": 0.3, "max": 0.3001}}, {"duration": {"min": 0.7, "max": 0.7001}})
    )
    assert np.diff(found.t) == pytest.approx([0.05] * 6 + [0.7 / 6] * 6)
    assert found.cost == pytest.approx(fixed.cost, rel=1e-3)


def test_natural_coordinates_take_given_lengths_that_differ() -> None:
    phases = ({"duration": 0.3}, {"duration": 0.7})
    joint, natural = (optimum(in_phases(*phases, coordinates=c)) for c in ("joint", "natural"))
    assert natural.cost == pytest.approx(joint.cost, rel=0.05)
    assert natural.t == pytest.approx(joint.t)


def test_the_solver_finds_the_durations_that_ipopt_finds() -> None:
    problem = in_phases({"duration": FREE, "cost": {"effort": 3.0}}, {"duration": FREE}, duration=1.0)
    own, other = optimum(problem), optimum(problem.with_(solver={"method": "ipopt"}))
    assert own.cost == pytest.approx(other.cost, rel=1e-6)
    assert own.t == pytest.approx(other.t, abs=1e-4)
    assert own.t[-1] == pytest.approx(1.0, abs=1e-12)
    assert own.limit_violation < 1e-8


def test_minimum_time_in_phases_of_one_ratio_is_minimum_time() -> None:
    words: dict[str, Any] = {
        "cost": {"effort": 1e-6, "time": 1.0},
        "limits": {"effort": True, "velocity": 3.0},
    }
    whole = optimum(
        Problem.create(
            UR5, {"min": 0.1, "max": 2.0}, 12, goal=GOAL, **{"integrator": {"scheme": "se1"}, **words}
        )
    )
    cut = optimum(
        in_phases({"duration": {"min": 0.05, "max": 1.0}}, {"duration": {"min": 0.05, "max": 1.0}}, **words)
    )
    assert cut.duration <= whole.duration * (1.0 + 1e-6)  # lengths of two halves are freer than one
    assert cut.duration == pytest.approx(whole.duration, rel=0.1)


def test_limits_weights_and_points_are_those_of_their_phase() -> None:
    found = optimum(
        in_phases(
            {"via": [{"frame": {"name": "tool0", "z": 0.6}}]},
            {"limits": {"velocity": 0.9, "acceleration": 30.0}, "cost": {"effort": 2.0}},
        )
    )
    assert np.abs(found.vs[6:]).max() <= 0.9 + 1e-6
    assert np.abs(found.vs[:6]).max() > 1.0
    assert np.abs(np.diff(found.vs[6:], axis=0) * 12.0).max() <= 30.0 + 1e-5
    assert UR5.frame_placement("tool0", found.qs[6]).translation[2] == pytest.approx(0.6, abs=1e-8)
    touched = {(limit.kind, limit.total) for limit in found.active_limits}
    assert ("velocity", 7) in touched


def test_a_weight_of_all_phases_is_a_weight_of_the_problem() -> None:
    one = optimum(in_phases({"cost": {"effort": 2.0}}, {"cost": {"effort": 2.0}}))
    other = optimum(in_phases({}, {}, cost={"effort": 2.0, **COST}))
    assert one.cost == pytest.approx(other.cost, rel=1e-10)
    assert one.qs == pytest.approx(other.qs, abs=1e-9)


def test_other_numbers_compile_nothing() -> None:
    first = formulate(in_phases({"cost": {"effort": 2.0}}, {"duration": FREE, "limits": {"velocity": 2.0}}))
    other = formulate(
        in_phases(
            {"cost": {"effort": 0.3}, "steps": 3},
            {"duration": {"min": 0.3, "max": 2.0}, "limits": {"velocity": 3.0}},
        )
    )
    assert first.programme.functions.library == other.programme.functions.library


def test_a_solution_starts_one_of_other_lengths() -> None:
    saved = optimum(in_phases({"duration": FREE}, {}))
    again = solve(in_phases({"duration": FREE, "steps": 9}, {"steps": 4}), warm_start=saved)
    assert again.converged
    assert again.t[9] == pytest.approx(saved.t[6], abs=0.1)


def test_results_tell_of_phases() -> None:
    found = optimum(in_phases({}, {"duration": FREE}))
    told = json.loads(json.dumps(solution_dict(found)))
    assert told["phase_times"]["p1"][1] == pytest.approx(found.duration)
    assert [place.is_free for place in found.named_phases] == [False, True]
