"""Cones that bind impulses: where a constraint is taken on with an impact, the ground can only push."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp import Problem, Solution
from mbocp._arrays import Array
from mbocp.problem.file.load import parse_problem
from mbocp.problem.file.tables import problem_to_toml
from tests.holds.cases import pendulum

PENDULUM: dict[str, Any] = {"name": "double_pendulum", "payload": pendulum().robot.spec["payload"]}
MU = 0.2


def lands(coordinates: str = "joint", rest: Any = 0.1, kind: str = "point", **contact: Any) -> Problem:
    """The tip of a double pendulum swings onto a point, and rests there on what pushes along y."""
    hold = {"name": "tip", "frame": "tip", "kind": kind, **({"axis": [0, 0, 1]} if kind == "line" else {})}
    path = {"kind": "contact_force", "constraint": "tip", "normal": [0, 1, 0], "friction": MU} | contact
    y, z = pendulum().robot.frame_placement("tip", [-0.2, 0.9]).translation[1:]
    there = {"frame": {"name": "tip", "y": float(y), "z": float(z)}}
    phases = [
        {"name": "fall", "steps": 6, "duration": 0.3, "via": [there]},
        {"name": "rest", "steps": 3, "duration": rest, "hold": [hold], "path": [path]},
        {"name": "off", "steps": 3, "duration": 0.2},
    ]
    goal = {"q": [-0.5, 0.7]}
    told: dict[str, Any] = {"start": {"q": [0.3, 0.4]}, "goal": goal, "coordinates": coordinates}
    return Problem.create(PENDULUM, phase=phases, scheme="midpoint", **told)


def impulse(problem: Problem, solution: Solution) -> Array:
    """Along the normal and two tangents, by the velocities: M (v+ - v-) = J' Lambda [N s]."""
    step = problem.impacts[0]
    table = problem.timeline.switches
    assert table is not None
    J = table.jacobians(solution.qs[[step]])[0]
    leap = problem.robot.mass_matrix(solution.qs[step]) @ (solution.vs[step + 1] - solution.vs[step])
    x, y, z = np.linalg.lstsq(J.T, leap, rcond=None)[0]
    return np.array([y, x, z])


def test_an_impulse_stays_in_the_cone() -> None:
    problem = lands()
    room = 0.01 * problem.contacts[0].scale * problem.dt  # [N s] counts as none
    free, bound = (mbocp.solve(lands(impulses=on), check=True) for on in (False, True))
    for solution, is_inside in ((free, False), (bound, True)):
        normal, *across = impulse(problem, solution)
        in_cone = np.linalg.norm(across) <= np.hypot(MU * normal, room) + 1e-7
        assert bool(normal >= -room - 1e-7 and in_cone) is is_inside
    assert bound.cost > free.cost
    assert bound.limit_violation < 1e-6


@pytest.mark.parametrize(("coordinates", "facets"), [("joint", 4), ("natural", None), ("natural", 4)])
def test_multipliers_of_an_impact_stay_in_cones_and_pyramids(coordinates: str, facets: int | None) -> None:
    """By the impulses among the multipliers, over the length of a mean step [N]."""
    shape = {} if facets is None else {"facets": facets}
    for impulses in (True, False):
        problem = lands(coordinates, impulses=impulses, **shape)
        (contact,), step = problem.contacts, problem.impacts[0]
        solution, room = mbocp.solve(problem, check=True), 0.01 * contact.scale
        table = problem.timeline.switches
        assert table is not None
        own = solution.lams[step : step + 1, -table.rows.shape[1] :] / problem.dt  # bodies' rows come first
        normal, *across = contact.wrenches(own)[0, :3]
        worst = (
            contact.values_of(own)[0, 1:].min()
            if facets
            else np.hypot(MU * normal, room) - np.linalg.norm(across)
        )
        least = -room if facets else 0.0
        assert bool(normal >= -room - 1e-5 and worst >= least - 1e-5) is impulses


def test_newtons_bound_no_impulse() -> None:
    problem = lands(max=1.0, min_normal=0.5, friction=None, facets=None)
    (contact,) = problem.contacts
    lower, upper = contact.bounds_of_impulses(is_inner=False)
    assert lower.tolist() == [-0.01 * contact.scale, -np.inf]
    assert upper.tolist() == [np.inf, np.inf]


def test_partings_are_bounded_with_the_step_before() -> None:
    problem = lands()
    assert problem.impacts == (6, 10)
    (contact,) = problem.contacts
    assert contact.hits is not None
    assert contact.steps is not None
    assert np.flatnonzero(contact.hits).tolist() == [6]
    assert np.flatnonzero(contact.steps).tolist() == [6, 7, 8, 10]


@pytest.mark.parametrize(
    ("coordinates", "rest", "least"),
    [
        ("joint", 0.1, 0.0),
        ("joint", 0.1, 0.5),  # [N], with steps of two thirds of the mean length
        ("joint", {"min": 0.05, "max": 0.12}, 0.0),
        ("natural", 0.1, 0.0),
        ("natural", 0.1, 0.5),
    ],
)
def test_a_parting_leaves_of_the_last_force_what_is_asked(coordinates: str, rest: Any, least: float) -> None:
    """The tip slides along a wall, which is to push where it would pull: together they push as asked."""
    problem = lands(coordinates, rest, kind="line", normal=[0, -1, 0], min_normal=least, friction=None)
    solution = mbocp.solve(problem, check=True)
    table, step = problem.timeline.switches, problem.impacts[1]
    assert table is not None
    own = solution.lams[:, -table.rows.shape[1] :]  # bodies' rows come first
    forces = problem.contacts[0].wrenches(own)[:, 0]
    from_parting = forces[step] / (solution.t[step] - solution.t[step - 1])
    assert from_parting < -1e-4  # [N], by what steps of the midpoint rule leave
    assert forces[step - 1] + from_parting == pytest.approx(least, abs=1e-6)


def test_the_key_is_written_and_read() -> None:
    text = problem_to_toml(lands(impulses=False))
    assert "impulses = false" in text
    assert not parse_problem(text).contacts[0].contact.impulses
    assert "impulses" not in problem_to_toml(lands())
