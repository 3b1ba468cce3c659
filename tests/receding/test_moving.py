"""A horizon over phases that repeat: the numbers that turn, the loop of a trot, and what is refused."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import ProblemError
from mbocp.problem import Problem
from mbocp.receding import RecedingHorizon

EXAMPLES = Path(__file__).parents[2] / "examples"
TROT = EXAMPLES / "receding" / "solo12_trot.toml"
TIGHT = 1e-8  # part of the cost for the barrier, where optima are compared
PHASES = {  # of 3, 5 and 2 steps
    "lift": {"steps": 3, "limits": {"effort": 6.0}},
    "swing": {"steps": 5, "cost": {"velocity": 3.0}},
    "rest": {"steps": 2, "limits": {"velocity": 0.8}},
}


def pendulum(*cut: tuple[str, int]) -> Problem:
    """A double pendulum whose phases begin anywhere: names and numbers of steps."""
    phases = [
        {**PHASES[name], "name": f"{name} {k}", "steps": steps, "duration": 0.05 * steps}
        for k, (name, steps) in enumerate(cut)
    ]
    cost = {"effort": 0.1, "velocity": 0.5, "tracking": 1.0, "tracking_weights": {"q": 20.0}}
    cost["target"] = {"q": [0.4, -0.3]}
    start = {"q": [0.2, -0.1], "v": [0.3, 0.1]}
    return Problem.create("double_pendulum", phase=phases, start=start, cost=cost, scheme="se1")


def settled(horizon: RecedingHorizon, problem: Problem) -> mbocp.receding.HorizonStep:
    """The optimum from the start of a problem, without moving on."""
    for _ in range(40):
        found = horizon.step(problem.q_start, problem.v_start, dt=0.0, iterations=5)
        if found.status.state == "converged":
            return found
    raise AssertionError(found.status)


@pytest.mark.parametrize(
    ("steps", "cut"),
    [
        (2, [("lift", 1), ("swing", 5), ("rest", 2), ("lift", 2)]),
        (7, [("swing", 1), ("rest", 2), ("lift", 3), ("swing", 4)]),
        (23, [("swing", 5), ("rest", 2), ("lift", 3)]),
    ],
)
@pytest.mark.parametrize("at_once", [True, False])
def test_later_on_it_is_the_problem_that_begins_there(steps, cut, at_once):
    """Limits and weights of phases turn with the horizon, over more than one round, in one move or many."""
    horizon = RecedingHorizon(pendulum(("lift", 3), ("swing", 5), ("rest", 2)), barrier=TIGHT)
    for _ in range(1 if at_once else steps):
        horizon.step([0.2, -0.1], [0.3, 0.1], dt=0.05 * (steps if at_once else 1))
    then = pendulum(*cut)
    cold = mbocp.solve(then, check=True)
    found = settled(horizon, then)
    np.testing.assert_allclose(found.q, cold.qs, atol=1e-5)
    np.testing.assert_allclose(found.us, cold.us, atol=1e-3 * np.abs(cold.us).max())


@pytest.fixture(scope="module")
def trot() -> Problem:
    return mbocp.load_problem(TROT)


def test_half_a_cycle_later_the_other_feet_swing(trot, monkeypatch):
    """Holds, impacts, partings, cones and heights turn: the optimum is that of the trot of the other feet."""
    monkeypatch.setenv("MBOCP_FUNCTIONS", "tapes")
    horizon = RecedingHorizon(trot, barrier=TIGHT, iterations=2)
    for _ in range(12):
        horizon.step(trot.q_start, trot.v_start)
    gait = {"swings": [["FR", "HL"], ["FL", "HR"]], "repeats": True, "duration": 0.2, "steps": 12}
    other = trot.with_(gait=gait)
    cold = mbocp.solve(other, check=True)
    found = settled(horizon, other)
    np.testing.assert_allclose(found.q, cold.qs, atol=1e-4)
    np.testing.assert_allclose(horizon.times, cold.t, atol=1e-12)
    forces = horizon.contact_forces()
    takes_time = np.diff(horizon.times) > 0.0
    for contact in other.contacts:
        own, expected = forces[contact.contact.constraint], contact.wrenches(cold.lams)
        np.testing.assert_allclose(own[takes_time], expected[takes_time], atol=0.05)


def example():
    spec = importlib.util.spec_from_file_location("solo12_trot", TROT.with_suffix(".py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_trot_goes_on_through_a_push_at_the_speed_that_is_asked_for(trot, monkeypatch):
    """Over four cycles, in a plant of rigid contacts with steps of its own."""
    monkeypatch.setenv("MBOCP_FUNCTIONS", "tapes")
    horizon = RecedingHorizon(trot, iterations=1)
    states, forces, told = example().trot(horizon, 1.6, lambda t: [min(2.0 * t, 0.3), 0.0, 0.0])
    qs = np.array([q for q, _ in states])
    assert sum(status.state == "stuck" for status in told) <= 3
    assert all(status.state in ("improved", "converged", "stuck") for status in told)
    assert np.abs(qs[:, 2] - 0.235).max() < 0.03
    assert np.abs(qs[:, 3:6]).max() < 0.1
    assert abs((qs[-1, 0] - qs[-25, 0]) / 0.4 - 0.3) < 0.05
    assert forces[:, 2].min() > 0.0
    assert np.mean(np.linalg.norm(forces[:, :2], axis=1) > 0.7 * forces[:, 2]) < 0.02


def test_what_cannot_be_is_said():
    horizon = RecedingHorizon(pendulum(("lift", 3), ("swing", 5), ("rest", 2)))
    for given, words in (
        ({"dt": 0.07}, "dt: got 0.07, expected a multiple of 0.05 s"),
        ({"speed": [0.1, 0.0, 0.0]}, "has no floating base"),
    ):
        found = horizon.step([0.2, -0.1], [0.3, 0.1], **given)
        assert found.status.state == "bad_input"
        assert words in found.status.words
    with pytest.raises(ProblemError, match="phases and via points move in Python alone"):
        horizon.save("nowhere")


@pytest.mark.parametrize("speed", [[0.3], [np.nan, 0.0, 0.0], "fast"])
def test_speeds_are_three_numbers(trot, monkeypatch, speed):
    monkeypatch.setenv("MBOCP_FUNCTIONS", "tapes")
    horizon = RecedingHorizon(trot, iterations=1)
    found = horizon.step(trot.q_start, trot.v_start, speed=speed, dt=0.0)
    assert found.status.state == "bad_input"


def test_phases_that_cannot_follow_themselves_are_refused():
    with pytest.raises(ProblemError, match=r"receding horizon: phase: what is held .* repeats = true"):
        RecedingHorizon(EXAMPLES / "legged" / "solo12_trot.toml")


def by_way(*vias: tuple[str, float, list[float]], start: dict, limits: dict) -> Problem:
    """A double pendulum by way of some configurations: names, times and angles."""
    cost = {"effort": 0.1, "velocity": 0.5, "terminal": 1.0, "terminal_weights": {"q": 50.0, "p": 1.0}}
    goal = {"q": [0.8, 0.2], "v": 0, "enforce": "penalty"}
    via = [{"name": name, "time": time, "q": q} for name, time, q in vias]
    keys = {"start": start, "goal": goal, "cost": cost, "limits": limits}
    return Problem.create("double_pendulum", 0.5, 10, via=via, scheme="se1", **keys)


VIAS = ("up", 0.2, [0.3, 0.4]), ("down", 0.35, [0.5, -0.2])


@pytest.mark.parametrize("limits", [{}, {"effort": 12.0}])
@pytest.mark.parametrize("steps", [1, 3, 4, 7])
def test_via_points_come_nearer_until_they_are_over(steps, limits):
    """After some steps the optimum is that of a problem with what is left of them."""
    start = {"q": [0.1, -0.1], "v": [0.2, 0.0]}
    horizon = RecedingHorizon(by_way(*VIAS, start=start, limits=limits), barrier=TIGHT)
    for _ in range(steps):
        horizon.step(start["q"], start["v"])
    left = [(name, time - 0.05 * steps, q) for name, time, q in VIAS if time - 0.05 * steps > 0.01]
    then = by_way(*left, start=start, limits=limits)
    cold = mbocp.solve(then, check=True)
    found = settled(horizon, then)
    np.testing.assert_allclose(found.q, cold.qs, atol=1e-5)
