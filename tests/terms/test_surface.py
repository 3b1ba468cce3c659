"""Height maps as surfaces: the ground of feet, and heights of frames above them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import mbocp
from mbocp.exceptions import MbocpError
from mbocp.problem import Problem, load_problem, parse_problem, problem_to_toml
from mbocp.problem.contact_bounds import ContactBounds
from mbocp.problem.path import PathConstraint
from mbocp.terms.bounded import MotionAtNodes
from mbocp.terms.heights import HeightGrid, height_at
from tests.terms.contacts import on_feet, solo

EXAMPLE = Path(__file__).parents[2] / "examples" / "legged" / "solo12_bump.toml"
CELL, MIDDLE = 0.1, (0.3, -0.2, 0.5)
HEIGHTS = np.random.default_rng(0).normal(scale=0.05, size=(5, 8))
X, Y = 0.3 + CELL * (np.arange(8) - 3.5), -0.2 + CELL * (2.0 - np.arange(5))


@pytest.fixture(scope="module")
def surface() -> HeightGrid:
    return HeightGrid.through(HEIGHTS.tolist(), CELL, MIDDLE, "map")


def spline(x: float, y: float) -> float:
    """The natural cubic spline along y of those along x."""
    along = CubicSpline(X, HEIGHTS.T, bc_type="natural")(x)
    return float(MIDDLE[2] + CubicSpline(Y[::-1], along[::-1], bc_type="natural")(y))


def test_it_is_the_natural_spline_through_all_heights(surface: HeightGrid) -> None:
    points = np.random.default_rng(1).uniform([X[0], Y[-1]], [X[-1], Y[0]], (40, 2))
    heights, slopes = surface.at(points)
    step = 1e-5
    for point, height, slope in zip(points, heights, slopes, strict=True):
        assert height == pytest.approx(spline(*point), abs=1e-12)
        ends = [[spline(*(point + sign * step * axis)) for sign in (-1, 1)] for axis in np.eye(2)]
        np.testing.assert_allclose(slope, np.diff(ends, axis=1)[:, 0] / (2.0 * step), atol=1e-6)
    grid = np.stack(np.meshgrid(X, Y), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(surface.at(grid)[0], MIDDLE[2] + HEIGHTS.ravel(), atol=1e-12)
    np.testing.assert_allclose(surface.keys["heights"], HEIGHTS, atol=1e-12)
    np.testing.assert_allclose(surface.keys["middle"], MIDDLE)


def test_curvature_is_continuous_where_cells_meet(surface: HeightGrid) -> None:
    """And where a place is on the grid itself, as feet are at the start."""
    p = ca.SX.sym("p", 2)
    h = height_at(p, ca.SX(surface.coefficients), ca.SX(surface.grid), surface.size)
    curvature = ca.Function("c", [p], [ca.hessian(h, p)[0]])
    for x, y in zip(X[1:-1], np.resize(Y[1:-1], 6), strict=True):
        found = [np.asarray(curvature([x + dx, y + dx])) for dx in (-1e-9, 0.0, 1e-9)]
        assert np.abs(found[1]).max() > 0.1
        np.testing.assert_allclose(found[1], found[0], atol=1e-5)
        np.testing.assert_allclose(found[1], found[2], atol=1e-5)


def test_beyond_its_edges_heights_go_on(surface: HeightGrid) -> None:
    heights, slopes = surface.at(np.array([[X[-1], Y[1]], [X[-1] + 3.0, Y[1]], [X[0] - 1.0, Y[0] + 1.0]]))
    assert heights[1] == pytest.approx(heights[0])
    assert heights[2] == pytest.approx(MIDDLE[2] + HEIGHTS[0, 0])
    assert slopes[1, 0] == 0.0


def test_a_tool_glides_over_a_map() -> None:
    """A path constraint of its own: the flange keeps a height above a map, and has it at every node."""
    heights = (0.02 * np.sin(np.arange(12))[None, :] * np.ones((4, 1))).tolist()
    start = [-0.4, -0.9, 1.2, -1.8, -1.57, 0.0]
    robot = mbocp.load_robot("ur5")
    there = robot.frame_placement("tool0", np.array(start)).translation
    glide = {"kind": "height", "frame": "tool0", "heights": heights, "cell": 0.1}
    glide["middle"] = [0.5, 0.0, 0.0]
    ground = HeightGrid.through(heights, 0.1, glide["middle"], "map")
    away = float(there[2] - ground.at(there[None])[0][0])
    p = Problem.create(
        robot,
        1.5,
        20,
        start={"q": start},
        goal={"frame": {"name": "tool0", "y": float(-there[1])}, "v": 0},
        cost={"effort": 1e-3, "velocity": 0.1},
        path=[{**glide, "min": away, "max": away}],
        scheme="se1",
    )
    again = parse_problem(problem_to_toml(p)).path[0]
    np.testing.assert_allclose(again.number("coefficients"), p.path[0].number("coefficients"), atol=1e-15)
    solution = mbocp.solve(p)
    assert solution.converged
    places = np.array([robot.frame_placement("tool0", q).translation for q in solution.qs])
    np.testing.assert_allclose(places[:, 2] - ground.at(places)[0], away, atol=1e-7)
    assert np.ptp(places[:, 2]) > 0.01


def test_cones_are_about_the_normal_of_the_map() -> None:
    """On a slope as a map they are those about its normal, in what solvers see and in what is told."""
    slope = 0.3
    table = {"heights": [[-slope, slope]] * 2, "cell": 2.0}
    on_map, about = (
        [c for c in solo(path=on_feet(friction=0.7, max=50.0, **words)).path if isinstance(c, ContactBounds)]
        for words in (table, {"normal": [-slope, 0.0, 1.0]})
    )
    rng, robot = np.random.default_rng(0), solo().robot
    qs, lams = robot.q0 + 0.1 * rng.normal(size=(5, robot.nq)), 20.0 * rng.normal(size=(5, robot.nc))
    qs[:, 3:7] /= np.linalg.norm(qs[:, 3:7], axis=1, keepdims=True)
    vs = np.zeros((5, robot.nv))
    for one, other in zip(on_map, about, strict=True):
        nodes = MotionAtNodes(np.zeros(5), (qs, vs, vs), vs, lams, {})
        values = [c.values_in_motion(robot, nodes) for c in (one, other)]
        np.testing.assert_allclose(*values, atol=1e-9)
        lam = ca.SX.sym("lam", robot.nc)
        seen = [c.function(robot, {"reaction": lam}, lam) for c in (one, other)]
        for q, force in zip(qs, lams, strict=True):
            found = [np.asarray(f(q, vs[0], force)) for f in seen]
            np.testing.assert_allclose(*found, atol=1e-9)


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"normal": [0, 0, 1]}, r"normal: not on a map"),
        ({"facets": 4}, r"facets: not on a map"),
        ({"cell": None}, r"heights: how far are they apart"),
    ],
)
def test_what_is_not_said_on_a_map(keys: dict[str, Any], told: str) -> None:
    given = {"friction": 0.7, "heights": [[0, 0], [0, 0]], "cell": 1.0, **keys}
    with pytest.raises(MbocpError, match=told):
        solo(path=on_feet(**{name: value for name, value in given.items() if value is not None}))


@pytest.mark.slow
def test_solo12_walks_onto_a_bump() -> None:
    """Feet that stand are on the spline through its file, others not below, and forces in their cones."""
    rows = 1e-3 * np.loadtxt(EXAMPLE.parent / "bump.csv", delimiter=",")
    p = load_problem(EXAMPLE)
    solution = mbocp.solve(p)
    assert solution.converged
    bump = CubicSpline(0.12 + 0.08 * (np.arange(rows.shape[1]) - 5.5), rows[0], bc_type="natural")
    feet = [f"{name}_FOOT" for name in ("FL", "FR", "HL", "HR")]
    places = np.array([[p.robot.frame_placement(f, q).translation for f in feet] for q in solution.qs])
    above = places[..., 2] - bump(places[..., 0])
    level = above[0].mean()
    assert (above > level - 1e-3).all()
    landed = [k for k, label in enumerate(p.path) if "on the ground" in label.name]
    assert len(landed) == 8
    np.testing.assert_allclose(above[-1], level, atol=1e-3)
    assert places[-1, :2, 2].min() > places[0, :2, 2].max() + 0.01  # the front feet are up on it
    pressed = 0
    for k, contact in enumerate(p.contacts):
        for n, wrench in enumerate(contact.wrenches(solution.lams), start=1):
            normal = np.array([1.0, -bump(places[n, k, 0], 1), 0.0])
            along = wrench[:3] @ normal / np.linalg.norm(normal)
            across = np.linalg.norm(np.cross(wrench[:3], normal)) / np.linalg.norm(normal)
            assert not contact.source.acts[n - 1] or across <= 0.7 * along + 1e-5
            pressed += along > 1.0
    assert pressed > 50


def of_ground(**words: Any) -> Problem:
    """solo12 on a map."""
    feet = {name: f"{name}_FOOT" for name in ("FL", "FR", "HL", "HR")}
    ground = {"feet": feet, "friction": 0.7, "heights": [[0.0, 0.1], [0.0, 0.1]], "cell": 4.0, **words}
    phases = [
        {"name": "step", "steps": 4, "duration": 0.2, "contacts": ["FR", "HL", "HR"]},
        {"name": "stand", "steps": 4, "duration": 0.2, "contacts": [*feet]},
    ]
    start = {"q": {"root_joint": [0.0, 0.0, 0.235, 0.0, 0.0, 0.0, 1.0]}}
    return Problem.create("solo12", start=start, ground=ground, phase=phases, goal={"v": 0})


def test_a_foot_that_is_off_the_map_is_refused() -> None:
    with pytest.raises(MbocpError, match=r"'HL' is at z = 0.0191028 m, and the ground at 0.0093"):
        of_ground()
    assert of_ground(heights=[[0.0, 0.001], [0.0, 0.001]]).path


def test_a_foot_in_the_air_is_above_the_map_and_lands_on_it() -> None:
    """The map is at rest below the lowest foot; bounds are heights above it, at the nodes of the step."""
    p = of_ground(heights=[[0.0, 0.002], [0.0, 0.002]], lift=0.03)
    found = {c.name: c for c in p.path if isinstance(c, PathConstraint)}
    nodes = {name: np.flatnonzero(c.nodes(p.num_steps, 0.05)[:, 0]).tolist() for name, c in found.items()}
    assert nodes == {
        "FL above the ground in step": [0, 1, 2],
        "FL lifted in step": [1],
        "FL on the ground in step": [3],
    }
    bounds = [(c.lower[0], c.upper[0]) for c in found.values()]
    assert bounds == [(0.0, np.inf), (0.03, np.inf), (0.0, 0.0)]
    raised = np.array(p.q_start)
    raised[2] += 0.1
    heights = [
        found["FL on the ground in step"].values(p.robot, q, p.v_start)[0] for q in (p.q_start, raised)
    ]
    np.testing.assert_allclose(heights, [0.0, 0.1], atol=1e-12)
    surfaces = [contact.contact.surface for contact in p.contacts]
    assert [surface is not None for surface in surfaces] == [True] * 4


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ({"cell": None}, r"ground: heights: how far are they apart"),
        ({"heights": None}, r"ground: cell: of which map"),
        ({"scale": 2.0}, r"ground.scale: of a file"),
        ({"heights": "none.csv"}, r"ground.heights.*none.csv.*no such file"),
        ({"heights": [[0.0, 0.1], [0.0]]}, r"ground: heights.*as many"),
        ({"heights": np.zeros((40, 40)).tolist()}, r"ground: heights.*up to 1024"),
        ({"sole": [0.1, 0.1]}, r"ground.sole: not on a map"),
    ],
)
def test_what_is_no_ground_is_refused(words: dict[str, Any], told: str) -> None:
    with pytest.raises(MbocpError, match=rf"(?s){told}"):
        of_ground(**words)
