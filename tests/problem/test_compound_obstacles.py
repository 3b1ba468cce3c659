"""`[[obstacle]]` of meshes that are not convex: parts, the check against the surface, results, refusals."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from benchmarks.touching import Touching
from mbocp.cli.clearance_words import clearance_lines
from mbocp.exceptions import InvalidValue, MbocpError
from mbocp.problem import Problem, load_problem, parse_problem, problem_to_toml
from mbocp.problem.obstacles.approach import nearest_approach
from mbocp.problem.obstacles.shape_distances import ShapeDistances
from mbocp.robot import Robot
from mbocp.robot.collision.compound import Compound, compound_of
from mbocp.robot.collision.hull import box_of, hull_of
from mbocp.robot.collision.mesh_file import body_of_file
from mbocp.view.meshcat.goals import obstacle_points
from tests.problem.test_obstacles import planar, problem

__all__ = ["planar"]  # a fixture

ARMS = Path(__file__).parents[2] / "examples" / "arms"
ONE = np.ones(3)
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]


def box(low: Any, high: Any) -> tuple[np.ndarray, np.ndarray]:
    """Corners and triangles, seen from outside."""
    sides = np.array([low, high], dtype=float)
    corners = np.array([sides[[i, j, k], [0, 1, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    return corners, np.array([tri for a, b, c, d in QUADS for tri in ([a, b, c], [a, c, d])])


def joined(*bodies: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    starts = np.cumsum([0, *(len(corners) for corners, _ in bodies)])
    faces = [faces + start for (_, faces), start in zip(bodies, starts, strict=False)]
    return np.vstack([corners for corners, _ in bodies]), np.vstack(faces)


def fork(**words: Any) -> dict[str, Any]:
    """Two boards with a gap of 0.6 m between them, one obstacle."""
    boards = [box([-0.1, side - 0.02, -0.2], [0.1, side + 0.02, 0.2]) for side in (-0.3, 0.3)]
    corners, faces = joined(*boards)
    parts = [board.tolist() for board, _ in boards]
    made = {"name": "fork", "shape": "mesh", "vertices": corners.tolist(), "faces": faces.tolist()}
    return {**made, "parts": parts, "position": [1.05, 0.0, 0.0], **words}


@pytest.fixture
def ell() -> tuple[np.ndarray, np.ndarray]:
    """One surface with a step in it, of no convex parts: 3 of the 4 quarters of a box."""
    outline = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], dtype=float)
    corners = np.array([[x, y, z] for z in (0.0, 1.0) for x, y in outline])
    caps = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    sides = [[k, (k + 1) % 6, 6 + (k + 1) % 6, 6 + k] for k in range(6)]
    walls = [tri for a, b, c, d in sides for tri in ([a, b, c], [a, c, d])]
    return corners, np.vstack([caps[:, ::-1], caps + 6, walls])


def test_boards_of_a_file_are_boxes_of_one_obstacle() -> None:
    """They share corners and overlap; nothing sticks out, and nothing is left."""
    shelf, excess = body_of_file(ARMS / "shelf.obj", ONE, takes_hull=False)
    assert isinstance(shelf, Compound)
    assert excess == 0.0
    found = [box_of(part) for part in shelf.parts]
    sizes = sorted(tuple(np.sort(sides).round(6)) for _, sides in filter(None, found))
    assert sizes == [(0.02, 0.3, 0.8)] * 4 + [(0.02, 0.3, 0.9)] * 2 + [(0.02, 0.8, 0.9)]
    assert shelf.sticks_out == pytest.approx(0.0, abs=1e-6)
    assert shelf.uncovered == pytest.approx(0.0, abs=1e-6)


def test_errors_of_parts_are_measured(ell: tuple[np.ndarray, np.ndarray]) -> None:
    """A hull sticks out of the step by half of its diagonal; a part less leaves a quarter uncovered."""
    corners, faces = ell
    whole = Compound(corners, faces, (hull_of(corners),))
    assert whole.sticks_out == pytest.approx(0.5, abs=0.05)
    assert whole.uncovered == pytest.approx(0.0, abs=1e-6)
    part = Compound(corners, faces, (hull_of(box([0, 0, 0], [2, 1, 1])[0]),))
    assert part.sticks_out == pytest.approx(0.0, abs=1e-6)
    assert part.uncovered == pytest.approx(1.0, abs=1e-5)


def test_a_turned_box_is_found() -> None:
    turn = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.5, 1.0), np.array([0.2, -1.0, 0.4]))
    corners = box([-0.1, -0.2, -0.3], [0.1, 0.2, 0.3])[0] @ turn.rotation.T + turn.translation
    found = box_of(hull_of(corners))
    assert found is not None
    np.testing.assert_allclose(np.sort(found[1]), [0.2, 0.4, 0.6])
    np.testing.assert_allclose(found[0].translation, turn.translation)
    slanted = corners.copy()
    slanted[:4] += 0.01 * turn.rotation[:, 1]
    assert box_of(hull_of(slanted)) is None


def test_parts_are_one_obstacle(planar: Robot) -> None:
    p = problem(planar, obstacle=[fork(margin=0.01)])
    clearance = p.clearance
    assert [o.name for o in p.obstacle] == ["fork"]
    assert set(map(clearance.names_of, clearance.link_pairs)) == {("l2", "fork"), ("l3", "fork")}
    assert [piece.shape for piece in clearance.pieces] == ["box", "box"]
    names = {label.name for label in clearance.labels} - {"nothing"}
    assert names == {f"distance of l{k}[0] from fork[{n}]" for k in (2, 3) for n in (0, 1)}
    line = clearance_lines(clearance)[0]
    assert line.startswith("fork: 2 spheres; left out 1 that stand still beside it")
    assert "2 convex parts stick out of its surface by 0.00 mm and leave 0.00 mm" in line
    low, high = (f(obstacle_points(planar, p.obstacle), axis=0) for f in (np.min, np.max))
    np.testing.assert_allclose([low, high], [[0.95, -0.32, -0.2], [1.15, 0.32, 0.2]], atol=1e-9)


def test_the_check_between_nodes_sees_the_surface(planar: Robot) -> None:
    """A part is missing: rows do not know the board, the check does."""
    whole, blind = (fork(position=[1.35, 0.5, 0.0]) for _ in range(2))
    blind["parts"] = blind["parts"][1:]
    t, qs = np.array([0.0, 1.0]), np.array([[-0.3, 0.0, 0.0], [0.35, 0.0, 0.0]])
    found = [nearest_approach(problem(planar, obstacle=[one]).clearance, t, qs) for one in (whole, blind)]
    assert found[0].distance < 0.0
    assert found[1].distance == pytest.approx(found[0].distance)
    assert found[1].other == "fork"


def test_results_have_the_surface_and_its_parts(planar: Robot) -> None:
    p = problem(planar, obstacle=[fork()])
    again = parse_problem(problem_to_toml(p))
    assert problem_to_toml(again) == problem_to_toml(p)
    for name, value in p.clearance.numbers.items():
        np.testing.assert_array_equal(again.clearance.numbers[name], value)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ({"parts": None}, "obstacle 'fork'.*faces and parts: both"),
        ({"faces": None}, "obstacle 'fork'.*faces and parts: both"),
        ({"parts": []}, "parts: got none"),
        ({"faces": [[0, 1]]}, "a row of another length"),
        ({"faces": [[0, 1, 99]]}, "faces: got a corner that is not there, expected 0 to 15"),
        ({"faces": []}, "faces.*from 1 to 20000"),
        ({"concavity": 0.1}, "concavity: of a file"),
        ({"frame": "nowhere"}, "obstacle 'fork'.*nowhere"),
        ({"shape": "sphere", "radius": 0.1}, "vertices: shape = .sphere. does not use it"),
    ],
)
def test_refusals(planar: Robot, words: dict[str, Any], reason: str) -> None:
    written = {key: value for key, value in fork(**words).items() if value is not None}
    with pytest.raises(MbocpError, match=reason):
        problem(planar, obstacle=[written])


def test_what_coacd_cannot_have_is_refused(
    ell: tuple[np.ndarray, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mbocp.robot.collision.compound.find_spec", lambda _: None)
    with pytest.raises(InvalidValue, match=r"concavity: got 0\.001, expected 0\.01 to 1"):
        compound_of(*ell, concavity=0.001)
    with pytest.raises(InvalidValue, match=r"not convex, expected.*coacd.*pip install 'mbocp\[scenes\]'"):
        compound_of(*ell, concavity=0.0123)


@pytest.mark.slow
@pytest.mark.skipif(find_spec("coacd") is None, reason="pip install 'mbocp[scenes]'")
def test_coacd_cuts_what_has_no_convex_components(ell: tuple[np.ndarray, np.ndarray]) -> None:
    """A step, and a box with a cavity, whose inside is not filled."""
    made = compound_of(*ell)
    assert sum(part.volume for part in made.parts) == pytest.approx(3.0, rel=0.02)
    assert made.sticks_out < 0.05
    assert made.uncovered < 0.01
    corners, faces = box([0.1, 0.1, 0.1], [0.9, 0.9, 0.9])
    hollow = compound_of(*joined(box([0, 0, 0], [1, 1, 1]), (corners, faces[:, ::-1])))
    assert all(not _is_within(part.vertices, part.normals, part.faces, 0.5 * ONE) for part in hollow.parts)


def _is_within(vertices: np.ndarray, normals: np.ndarray, faces: np.ndarray, point: np.ndarray) -> bool:
    return bool((np.einsum("ij,ij->i", normals, point - vertices[faces[:, 0]]) < 0.0).all())


def test_meshes_that_are_in_each_other_have_no_distance() -> None:
    """Coal says 0 of two meshes; without a margin such a motion was called clear."""
    p = load_problem(ARMS / "shelf.toml")
    assert p.clearance is not None
    straight = 0.5 * (np.asarray(p.q_start) + np.asarray(p.goal.q))
    links = range(len(p.robot.collision_spheres))
    shapes = ShapeDistances(p.clearance, [(link, 0, True) for link in links])
    shapes.place(straight)
    assert min(shapes.of(link) for link in links) < 0.0


def test_an_arm_goes_from_one_compartment_into_another() -> None:
    """At a thousand poses a second nothing touches; the straight line leads through boards."""
    p = load_problem(ARMS / "shelf.toml")
    found = mbocp.solve(p, check=True)
    assert Touching.of(p).first(found.t, found.qs, found.vs) is None
    assert found.clearance == pytest.approx(_nearest(p, found))
    assert _nearest(p, mbocp.solve(p.with_(obstacle=[]), check=True)) < 0.0


def _nearest(p: Problem, found: mbocp.Solution) -> float:
    assert p.clearance is not None
    nearest = nearest_approach(p.clearance, found.t, found.qs, found.vs)
    assert nearest is not None
    return nearest.distance
