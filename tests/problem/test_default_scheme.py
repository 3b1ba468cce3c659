"""Which scheme a problem gets that leaves it open, and that one that names its own keeps it."""

from __future__ import annotations

from typing import Any

import pytest

from mbocp.integrators import SCHEMES
from mbocp.problem import Problem, parse_problem, problem_to_toml

from .conftest import EXAMPLES

LINE = {"kind": "line", "frame": "tool0", "b": [0.4, 0.3, 0.4]}
THERE = {"name": "tool0", "position": [0.4, 0.3, 0.4]}
CRANK = {"q": {"crank": 1.5}, "v": 0}


def problem(robot: Any, **words: Any) -> Problem:
    return Problem.create(robot, 1.0, 20, **{"scheme": "auto", "goal": {"v": 0}, **words})


@pytest.mark.parametrize(
    ("robot", "words", "expected"),
    [
        ("ur5", {}, "gauss2"),
        ("ur5", {"controls": "stages"}, "gauss2"),
        ("ur5", {"coordinates": "natural"}, "midpoint"),
        ("ur5", {"path": [{**LINE, "tolerance": 1e-3}]}, "gauss2"),
        ("ur5", {"path": [LINE]}, "se1"),
        ("ur5", {"path": [LINE], "controls": "linear"}, "gauss2"),
        ("ur5", {"path": [LINE], "goal": {"frame": THERE}}, "gauss2"),  # not at rest
        ("ur5", {"phase": [{"name": "a", "steps": 20, "duration": 1.0}]}, "gauss2"),
        ("four_bar", {"goal": CRANK}, "lobatto3"),
        ("four_bar", {"goal": CRANK, "controls": "linear"}, "lobatto3"),
        ("four_bar", {"goal": CRANK, "coordinates": "natural"}, "midpoint"),
        ("stewart", {}, "midpoint"),
        ({"name": "hector", "actuated": ["root_joint"]}, {}, "midpoint"),
        ({"name": "hector", "actuated": ["root_joint"], "rotations": "dcm"}, {}, "rk4"),
        ("unicycle_pendulum", {"goal": {"q": {"base_x": 0.5}}}, "rk4"),
    ],
)
@pytest.mark.filterwarnings("ignore::mbocp.problem.ProblemWarning")
def test_the_scheme_that_suits(robot: Any, words: dict[str, Any], expected: str) -> None:
    found = problem(robot, **words)
    assert found.scheme == expected
    assert found.chooses_scheme
    assert words.get("controls", "constant") in SCHEMES[expected].controls


@pytest.mark.parametrize("name", ["loops/polish", "legged/solo12_squat"])
def test_constraints_that_begin_and_forces_that_are_bounded(name: str) -> None:
    document = (EXAMPLES / f"{name}.toml").read_text()
    assert parse_problem(document, ["integrator.scheme=auto"]).scheme == "midpoint"


def test_another_may_suit_when_the_problem_changes() -> None:
    open_ = problem("double_pendulum")
    assert open_.scheme == "gauss2"
    assert open_.with_(coordinates="natural").scheme == "midpoint"
    assert open_.with_(coordinates="natural").with_(coordinates="joint").scheme == "gauss2"
    assert open_.with_(cost={"effort": 2.0}).chooses_scheme
    for named in (open_.with_(scheme="se2"), open_.with_(integrator={"scheme": "se2"})):
        assert (named.scheme, named.chooses_scheme) == ("se2", False)
        assert named.with_(cost={"effort": 2.0}).scheme == "se2"


def test_files_say_what_was_chosen() -> None:
    text = problem_to_toml(problem("double_pendulum"))
    assert 'scheme = "gauss2"' in text
    assert not parse_problem(text).chooses_scheme
