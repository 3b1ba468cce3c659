"""Which scheme a problem gets that leaves it open, and that one that names its own keeps it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import pytest
from typer.testing import CliRunner

from mbocp.cli.app import app
from mbocp.exceptions import ProblemError
from mbocp.integrators import SCHEMES
from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.robot import Robot
from mbocp.terms import running_cost

from .conftest import EXAMPLES

LINE = {"kind": "line", "frame": "tool0", "b": [0.4, 0.3, 0.4]}
THERE = {"name": "tool0", "position": [0.4, 0.3, 0.4]}
CRANK = {"q": {"crank": 1.5}, "v": 0}


def pulls(at: Any) -> Any:
    """Force of the first closed loop, squared."""
    return ca.sumsqr(at.force(at.robot.constraints[0].name)[:3])


def problem(robot: Any, **words: Any) -> Problem:
    return Problem.create(robot, 1.0, 20, **{"goal": {"v": 0}, **words})


@pytest.mark.parametrize(
    ("robot", "words", "expected"),
    [
        ("ur5", {}, "gauss2"),
        ("double_pendulum", {}, "gauss2"),
        ("ur5", {"scheme": "auto"}, "gauss2"),
        ("ur5", {"integrator": {}}, "gauss2"),
        ("ur5", {"controls": "stages"}, "gauss2"),
        ("ur5", {"coordinates": "natural"}, "midpoint"),
        ("ur5", {"path": [{**LINE, "tolerance": 1e-3}]}, "gauss2"),
        ("ur5", {"path": [LINE]}, "se1"),
        ("ur5", {"path": [LINE], "controls": "linear"}, "gauss2"),
        ("ur5", {"path": [LINE], "goal": {"frame": THERE}}, "gauss2"),  # not at rest
        ("ur5", {"phase": [{"name": "a", "steps": 20, "duration": 1.0}]}, "gauss2"),
        ("four_bar", {"goal": CRANK}, "lobatto3"),
        ("four_bar", {"goal": CRANK, "cost": {"constraint_force": 1.0}}, "projected_midpoint"),
        ("four_bar", {"goal": CRANK, "terms": [running_cost(pulls)]}, "projected_midpoint"),
        ("four_bar", {"goal": CRANK, "controls": "linear"}, "lobatto3"),
        ("four_bar", {"goal": CRANK, "coordinates": "natural"}, "midpoint"),
        ("stewart", {}, "projected_midpoint"),
        ({"name": "hector", "actuated": ["root_joint"]}, {}, "midpoint"),
        ("solo12", {}, "midpoint"),
        ({"name": "z1", "friction": "none"}, {}, "radau2"),
        ({"name": "z1", "friction": "none"}, {"controls": "linear"}, "radau2"),
        ({"name": "z1", "friction": "none", "damping": False}, {}, "gauss2"),
        ({"name": "b1_z1", "friction": "none"}, {}, "radau2"),
        ({"name": "tiago_dual", "friction": "none"}, {}, "se1"),
        ("chain_24", {}, "gauss2"),
        ("chain_25", {}, "midpoint"),
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


def unnamed(name: str) -> str:
    """An example without its scheme."""
    text = (EXAMPLES / f"{name}.toml").read_text(encoding="utf-8")
    assert re.search(r"^scheme = ", text, re.MULTILINE)
    return re.sub(r"^scheme = .*$", "", text, flags=re.MULTILINE)


@pytest.mark.parametrize(
    ("name", "scheme", "reason"),
    [
        ("arms/ur5_reach", "gauss2", "open chain"),
        ("arms/panda_reach", "gauss2", "open chain"),
        ("arms/smooth_torques", "gauss2", "vary within steps"),
        ("arms/pick_and_place", "projected_midpoint", "begin or end"),
        ("loops/five_bar", "lobatto3", "small closed loops"),
        ("loops/delta", "projected_midpoint", "closed loops"),
        ("loops/polish", "projected_midpoint", "begin or end"),
        ("free_flyer/drone_flip", "midpoint", "floating base"),
        ("legged/solo12_squat", "projected_midpoint", "begin or end|forces"),
        ("walking/compass_gait", "lobatto3", "small closed loops"),
        ("so3/unicycle_pendulum", "rk4", "prescribe velocities"),
    ],
)
@pytest.mark.filterwarnings("ignore::mbocp.problem.ProblemWarning")
def test_files_that_name_none(name: str, scheme: str, reason: str) -> None:
    made = parse_problem(unnamed(name), source=EXAMPLES / f"{name}.toml")
    assert made.scheme == scheme
    assert re.search(reason, made.scheme_reason)


def test_the_check_of_a_problem_says_which_and_why(tmp_path: Path) -> None:
    file = tmp_path / "reach.toml"
    file.write_text(unnamed("arms/reach_pose"), encoding="utf-8")
    run = CliRunner(env={"COLUMNS": "200", "TERM": "dumb"})
    said = run.invoke(app, ["check", str(file)])
    assert "by scheme gauss2, chosen for an open chain of joints" in said.stdout
    said = run.invoke(app, ["check", str(file), "--set", "coordinates=natural"])
    assert "by scheme midpoint, chosen for natural coordinates" in said.stdout
    said = run.invoke(app, ["check", str(file), "--set", "integrator.scheme=se1"])
    assert "by scheme se1\n" in said.stdout


def test_options_of_explicit_schemes_name_one() -> None:
    """They are no wish for an explicit scheme: which one is said with them."""
    with pytest.raises(
        ProblemError, match=r'integrator\.substeps: got 3, which scheme "gauss2" does not use'
    ):
        problem("ur5", integrator={"substeps": 3})
    assert problem("unicycle_pendulum", goal={"q": {"base_x": 0.5}}, integrator={"substeps": 3}).substeps == 3


def test_another_may_suit_when_the_problem_changes() -> None:
    open_ = problem("double_pendulum")
    assert open_.scheme == "gauss2"
    assert open_.with_(coordinates="natural").scheme == "midpoint"
    assert open_.with_(coordinates="natural").with_(coordinates="joint").scheme == "gauss2"
    assert open_.with_(cost={"effort": 2.0}).chooses_scheme
    assert open_.with_(controls="linear").scheme_reason == "controls that vary within steps"
    for named in (open_.with_(scheme="se2"), open_.with_(integrator={"scheme": "se2"})):
        assert (named.scheme, named.chooses_scheme, named.scheme_reason) == ("se2", False, "")
        assert named.with_(cost={"effort": 2.0}).scheme == "se2"


def test_damping_of_a_robot_is_looked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many problems there are; another robot has its own."""
    first = problem("panda", goal={"q": {"panda_joint1": 0.1}})
    asked: list[Any] = []
    monkeypatch.setattr(Robot, "force_elements", lambda self, *state: asked.append(self))
    again = first.with_(goal={"q": {"panda_joint1": 0.2}})
    assert again.scheme == first.scheme
    assert first.robot.fastest_damping[1] > 0.0
    assert not asked
    with pytest.raises(TypeError):
        replace(first.robot).fastest_damping  # noqa: B018
    assert asked


def test_files_say_what_was_chosen() -> None:
    text = problem_to_toml(problem("double_pendulum"))
    assert 'scheme = "gauss2"' in text
    assert not parse_problem(text).chooses_scheme
