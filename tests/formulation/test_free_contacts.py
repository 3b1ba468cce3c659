"""Feet that may leave the ground: the laws of a block that falls and slides, and a leg that hops."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import mbocp
from mbocp.cli.app import app
from mbocp.exceptions import ProblemError
from mbocp.problem import Problem, parse_problem, problem_to_toml
from tests.checker import read_system
from tests.checker.free_feet import check_free_feet
from tests.checker.walking import Steps, foot_place

GRAVITY, FRICTION = 9.81, 0.8
FACET = FRICTION / np.sqrt(2.0)  # of the pyramid within the cone
GROUND = {"feet": {"toe": "foot"}, "friction": FRICTION, "contact": "free"}


def _link(name: str, mass: float, z: float, inertia: float) -> str:
    about = f'ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"'
    body = f'<origin xyz="0 0 {z}"/><mass value="{mass}"/><inertia {about}/>'
    return f'<link name="{name}"><inertial>{body}</inertial></link>'


def _joint(name: str, kind: str, parent: str, child: str, axis: str, z: float = 0.0) -> str:
    limit = '<limit lower="-9" upper="9" effort="50" velocity="99"/>'
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 {z}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}<axis xyz="{axis}"/>{limit}</joint>'


SLIDES = [
    _joint("x", "prismatic", "world", "slide", "1 0 0"),
    '<link name="world"/>',
    _link("slide", 0, 0, 0),
]


def robot(folder: Path, parts: list[str], actuated: list[str]) -> dict[str, Any]:
    """A robot in the plane of x and z, with a foot."""
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="planar">{"".join([*SLIDES, *parts])}<link name="foot"/></robot>')
    return {"name": str(path), "actuated": actuated}


def block(folder: Path, **words: Any) -> Problem:
    """It falls by 5 cm while it goes along at 1 m/s, and comes to rest; its motor need not help."""
    parts = [_joint("z", "prismatic", "slide", "body", "0 0 1"), _link("body", 2.0, 0.1, 0.01)]
    parts.append(_joint("toe", "fixed", "body", "foot", "0 0 1"))
    given = {
        "duration": 0.6,
        "steps": 24,
        "ground": {**GROUND, "height": 0.0},
        "start": {"q": [0.0, 0.05], "v": [1.0, 0.0]},
        "goal": {"v": 0},
        "cost": {"effort": 1.0},
    }
    return Problem.create(robot(folder, parts, ["x"]), **{**given, **words})


def hopper(folder: Path, **words: Any) -> Problem:
    """A body on a leg with hip and knee goes 0.3 m forward, from rest to rest."""
    parts = [_joint("z", "prismatic", "slide", "lift", "0 0 1"), _link("lift", 0, 0, 0)]
    parts += [_joint("pitch", "revolute", "lift", "body", "0 1 0"), _link("body", 3.0, 0.0, 0.03)]
    parts += [_joint("hip", "revolute", "body", "thigh", "0 1 0"), _link("thigh", 0.4, -0.08, 0.0015)]
    parts += [_joint("knee", "revolute", "thigh", "shank", "0 1 0", -0.2), _link("shank", 0.2, -0.1, 0.0008)]
    parts.append(_joint("toe", "fixed", "shank", "foot", "0 0 1", -0.2))
    q = np.array([0.0, 0.4 * np.cos(0.6), 0.0, -0.6, 1.2])
    given = {
        "duration": 0.7,
        "steps": 24,
        "ground": GROUND,
        "start": {"q": q.tolist()},
        "goal": {"q": (q + 0.3 * np.eye(5)[0]).tolist(), "v": 0},
        "cost": {"effort": 1.0, "velocity": 0.05},
        "limits": {"effort": 30.0, "position": {"hip": [-2, 2], "knee": [0.1, 2.6]}},
    }
    return Problem.create(robot(folder, parts, ["hip", "knee"]), **{**given, **words})


@pytest.fixture(scope="module")
def hop(tmp_path_factory: pytest.TempPathFactory) -> mbocp.Solution:
    return mbocp.solve(hopper(tmp_path_factory.mktemp("hopper")), check=True)


def test_a_block_falls_slides_and_stops(tmp_path: Path) -> None:
    """In flight nothing pushes it, an impact is inelastic, and friction brakes as hard as it can."""
    solution = mbocp.solve(block(tmp_path), check=True)
    dt, (vx, vz) = np.diff(solution.t), solution.vs.T
    normal, along = solution.problem.contacts[0].wrenches(solution.lams)[:, :2].T
    weight = 2.0 * GRAVITY
    flies = solution.qs[1:, 1] > 1e-2
    assert 2 < flies.sum() < 8
    np.testing.assert_allclose(np.diff(vz)[flies] / dt[flies], -GRAVITY, atol=0.05)
    np.testing.assert_allclose(dt @ normal, weight * 0.6, rtol=1e-3)  # momentum is conserved
    assert normal.max() > 3.0 * weight  # of the impact
    np.testing.assert_allclose(normal[-5:], weight, rtol=1e-2)
    slides = (vx[1:] > 0.1) & (normal > 0.1 * weight)
    assert slides.sum() >= 3
    np.testing.assert_allclose(along[slides], -FACET * normal[slides], atol=0.02 * weight)
    np.testing.assert_allclose(vx[-5:], 0.0, atol=1e-3)


def test_a_leg_finds_its_hop(hop: mbocp.Solution) -> None:
    """Forces balance momenta by Pinocchio's numbers; there is none in the air, and no foot in the ground."""
    robot, motion = hop.problem.robot, Steps(hop.t, hop.qs, hop.vs, hop.us)
    forces = hop.problem.contacts[0].wrenches(hop.lams)[:, None, [1, 2, 0]]
    system = read_system(str(robot.source), motors=["hip", "knee"])
    heights = np.array([foot_place(system, "foot", q)[2] for q in hop.qs[1:]])
    ground = foot_place(system, "foot", hop.qs[0])[2]
    found = check_free_feet(system, ["foot"], motion, forces, FRICTION, ground)
    assert (heights - ground > 1e-3).sum() >= 3  # it leaves the ground
    assert found["dynamics"] < 1e-9
    assert max(found["pulls"], found["cone"]) < 1e-9
    assert found["below"] < 1.01e-3  # at the last two nodes
    assert max(found["far"], found["drives"], found["slides"]) < 1.01e-4
    assert "contacts are found (experimental)" in hop.advice


def test_feet_that_sink_between_nodes_do_not_stand(tmp_path: Path) -> None:
    solution = mbocp.solve(hopper(tmp_path, steps=16))
    assert solution.status == "under_resolved"
    assert "mm below the ground between nodes at most: take more steps" in solution.advice


def test_a_warm_start_is_the_motion(hop: mbocp.Solution) -> None:
    again = mbocp.solve(hop.problem, warm_start=hop)
    assert again.converged
    assert again.iterations <= 2


def test_its_summary_counts_no_constraints(hop: mbocp.Solution, tmp_path: Path) -> None:
    path = hop.save(tmp_path / "hop.h5")
    told = CliRunner(env={"COLUMNS": "200"}).invoke(app, ["info", str(path)]).output
    assert "planar: 5 degrees of freedom, 2 controls" in told
    assert "violated by" not in told.split("constraints", 1)[1].split("\n", 1)[0]


def test_its_text_reads_back(hop: mbocp.Solution) -> None:
    text = problem_to_toml(hop.problem)
    assert 'contact = "free"' in text
    assert problem_to_toml(parse_problem(text)) == text
    assert hop.problem.with_(ground={"smoothing": 1e-3}).inequalities[-1].upper[-1] == 1e-3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"integrator": {"scheme": "midpoint"}}, 'scheme = "midpoint"; take "se1"'),
        ({"ground": {**GROUND, "lift": 0.01}}, "ground.lift"),
        ({"ground": {**GROUND, "friction": 0.0}}, "a ground without friction"),
        ({"ground": {**GROUND, "height": 0.1}}, "below the ground"),
        ({"start": {"free": {"v": True}}}, "start.free"),
        ({"robust": {"start": {"v": 0.1}}}, r"\[robust\]"),
        ({"steps": None, "accuracy": 1e-3}, "horizon.accuracy"),
    ],
)
def test_what_it_does_not_go_with(tmp_path: Path, words: dict[str, Any], message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        block(tmp_path, **words)
