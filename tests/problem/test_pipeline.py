"""Steps are worked out again where what they take has changed, and only there."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import mbocp
from mbocp._arrays import dataclass
from mbocp.exceptions import ProblemError
from mbocp.problem import problem_to_toml
from mbocp.problem.document import make_document
from mbocp.problem.file.read_tables import READ
from mbocp.problem.pipeline import Step, run_steps
from mbocp.problem.problem_data import ProblemData
from mbocp.problem.resolve import RESOLVE


def count_calls() -> tuple[list[str], tuple[Step, ...]]:
    """Steps that note their calls: c = a + 1, then d = c * b, then a check of d."""
    calls: list[str] = []

    def add(a: int) -> int:
        calls.append("add")
        return a + 1

    def multiply(c: int, b: np.ndarray) -> tuple[np.ndarray, int]:
        calls.append("multiply")
        return c * b, c

    def check(d: np.ndarray) -> None:
        calls.append("check")
        if d.any() and d.min() < 0:
            raise ProblemError("d: below zero")

    return calls, (Step.of(add, "c"), Step.of(multiply, "d", "e"), Step.of(check))


def test_what_has_not_changed_is_not_worked_out_again() -> None:
    calls, steps = count_calls()
    b = np.ones(3)
    first = run_steps(steps, {"a": 1, "b": b})
    assert calls == ["add", "multiply", "check"]
    calls.clear()
    assert run_steps(steps, {"a": 1, "b": b}, first)["d"] is first["d"]
    assert calls == []
    other = run_steps(steps, {"a": 1, "b": 2.0 * b}, first)
    assert calls == ["multiply", "check"]
    np.testing.assert_array_equal(other["d"], 4.0 * b)
    with pytest.raises(ProblemError, match="below zero"):
        run_steps(steps, {"a": 1, "b": -b}, first)


@dataclass(frozen=True, eq=False)
class Weights:
    """As costs and goals: arrays in a frozen value."""

    values: np.ndarray
    further: dict[str, np.ndarray]


@pytest.mark.parametrize(("given", "is_same"), [([1.0, np.nan], True), ([1.0, 2.0], False), ([1.0], False)])
def test_what_comes_out_the_same_changes_nothing_after_it(given: list[float], is_same: bool) -> None:
    """To the last bit: NaN equals itself."""
    calls: list[Weights] = []

    def weigh(a: list[float]) -> Weights:
        return Weights(np.array(a[:1]), {"x": np.array(a)})

    steps = (Step.of(weigh, "weights"), Step.of(lambda weights: calls.append(weights)))
    first = run_steps(steps, {"a": [1.0, np.nan]})
    other = run_steps(steps, {"a": given}, first)
    assert (other["weights"] is first["weights"]) == is_same
    assert len(calls) == (1 if is_same else 2)


def test_zeros_of_two_signs_are_not_the_same() -> None:
    steps = (Step.of(lambda a: a, "b"),)
    first = run_steps(steps, {"a": np.zeros(1)})
    for value in (-np.zeros(1), np.zeros(2), 0.0):
        assert run_steps(steps, {"a": value}, first)["b"] is value
    assert run_steps(steps, {"a": np.zeros(1)}, first)["b"] is first["b"]


def test_another_goal_checks_no_rates_again(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = mbocp.load_problem("examples/arms/ur5_limits.toml")
    run, ran = Step.run, []
    monkeypatch.setattr(Step, "run", lambda step, values: ran.append(step.work.__name__) or run(step, values))
    problem.with_(goal={"q": problem.goal.q + 0.01})
    assert "settle_goal" in ran  # else the test would see nothing
    assert not {"check_rates", "check_mean_squares"} & set(ran)


def test_what_is_worked_out_of_a_problem_stays_behind_when_it_is_sent() -> None:
    problem = mbocp.load_problem("examples/arms/ur5_limits.toml")
    assert problem.limits_of_rates is problem.limits_of_rates
    sent = pickle.loads(pickle.dumps(problem))
    assert "limits_of_rates" not in vars(sent)
    assert problem_to_toml(sent) == problem_to_toml(problem)


def test_another_goal_makes_no_other_phases() -> None:
    problem = mbocp.load_problem("examples/arms/ur5_reach.toml")
    q = np.array(problem.goal.q) + 0.01
    other = problem.with_(goal={"q": q})
    np.testing.assert_array_equal(other.goal.q, q)
    assert other.draft["phase"] is problem.draft["phase"]
    assert other.draft["guess"] is problem.draft["guess"]


def test_a_value_that_is_given_stays() -> None:
    calls, steps = count_calls()
    found = run_steps(steps, {"a": 1, "b": np.ones(2), "e": 7})
    assert (found["c"], found["e"]) == (2, 7)
    calls.clear()
    assert run_steps(steps, {"a": 1, "b": np.ones(2), "c": 5})["e"] == 5
    assert "add" not in calls


def test_each_step_takes_what_is_there_before_it() -> None:
    """And no two give the same; all fields of a problem are given by one."""
    problem = mbocp.Problem.create("double_pendulum", 1.0, 10, goal={"q": [1.0, 0.0]})
    given = {name for name in problem.draft if name.endswith("_table")}
    known = given | {"robot_of_file", "coordinates", "terms_given", "folder", "is_cost_left"}
    known |= {"said_holds", "said_releases", "said_impacts"}
    for step in (*READ, *RESOLVE):
        assert not set(step.takes) - known, step.work
        assert not set(step.gives) & known, step.work
        known |= set(step.gives)
    of_solves = {"limits_within", "tube"}  # what a solve finds it needs
    assert {*ProblemData.__dataclass_fields__} - {"source", "name"} - of_solves <= known


@pytest.mark.parametrize(
    "changes",
    [
        {"goal": {"q": [0.3, -0.2]}},
        {"steps": 25},
        {"duration": {"min": 0.5, "max": 2.0}},
        {"start": {"q": [0.1, 0.2]}, "cost": {"velocity": 0.5}},
        {"scheme": "se1", "limits": {"effort": 4.0}},
        {"q_start": np.array([0.2, 0.1])},
    ],
    ids=lambda changes: "+".join(changes),
)
def test_a_changed_problem_is_that_of_the_changed_document(changes: dict[str, object]) -> None:
    """What was kept from the problem before makes no difference."""
    problem = mbocp.Problem.create("double_pendulum", 1.0, 10, goal={"q": [1.0, 0.0], "v": 0})
    changed = problem.with_(**changes)
    anew = mbocp.Problem.of(changed.document)
    assert problem_to_toml(changed) == problem_to_toml(anew)
    back = changed.with_(goal={"q": [1.0, 0.0]})
    assert back.goal.q.tolist() == [1.0, 0.0]


def test_arrays_that_a_program_changes_afterwards_are_not_the_problems() -> None:
    q = np.array([0.2, 0.1])
    problem = mbocp.Problem.create("double_pendulum", 1.0, 10, goal={"q": [1.0, 0.0]}).with_(q_start=q)
    q += 0.1
    moved = problem.with_(q_start=q)
    assert problem.q_start.tolist() == [0.2, 0.1]
    np.testing.assert_allclose(moved.q_start, [0.3, 0.2])


def test_a_table_that_is_not_said_stays_unsaid() -> None:
    """Weights that are left to mbocp follow the goal, as where the file had it so."""
    tables = {"horizon": {"duration": 1.0, "steps": 10}, "goal": {"q": [1.0, 0.0]}}
    problem = mbocp.Problem.of(make_document(tables, robot="double_pendulum"))
    other = mbocp.Problem.of(make_document({**tables, "goal": {"q": [2.0, 1.0]}}, robot="double_pendulum"))
    changed = problem.with_(goal={"q": [2.0, 1.0]})
    np.testing.assert_array_equal(changed.cost.velocity, other.cost.velocity)
    assert "cost" not in changed.document.tables
