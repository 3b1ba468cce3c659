"""`[[obstacle]]` of `shape = "cloud"` and `"heights"`: files, boxes that cover them, motions beside them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial import cKDTree

import mbocp
from mbocp.exceptions import MbocpError
from mbocp.guesses.around import near_the_way
from mbocp.meshes.mesh_parts import count_open_edges, measure_enclosed_body, weld
from mbocp.meshes.points import read_heights, read_points
from mbocp.problem import Problem, load_problem, parse_problem, problem_to_toml
from mbocp.problem.obstacles.approach import poses_between
from mbocp.robot import Robot
from mbocp.robot.collision.covering_boxes import Boxes, boxes_of_cloud, boxes_of_heights
from tests.problem.test_obstacles import planar, problem

__all__ = ["planar"]  # a fixture

EXAMPLE = Path(__file__).parents[2] / "examples" / "arms" / "heap.toml"
POINTS = np.array([[0.5, -1.0, 2.0], [0.25, 0.0, -3.0], [1.5, 2.0, 0.125]])
ROWS = [f"{x} {y} {z}" for x, y, z in POINTS]
PLY = "ply\nformat {} 1.0\ncomment c\nelement vertex 3\nproperty uchar red\nproperty float x\n"
PLY += "property float y\nproperty double z\nelement face 0\nproperty list uchar int v\nend_header\n"
PCD = "# .PCD\nVERSION 0.7\nFIELDS _ x y z _\nSIZE 1 4 4 4 2\nTYPE U F F F I\nCOUNT 3 1 1 1 2\nWIDTH 4\n"
PCD += "HEIGHT 1\nPOINTS 4\nDATA {}\n"


def packed(head: str, form: str, rows: list[list[float]]) -> bytes:
    return head.encode() + b"".join(struct.pack(form, *row) for row in rows)


WITH_NAN = [*POINTS.tolist(), [np.nan] * 3]
CLOUDS = {
    "a.ply": (PLY.format("ascii") + "\n".join(f"7 {row}" for row in ROWS)).encode(),
    "b.ply": packed(PLY.format("binary_little_endian"), "<Bffd", [[7, *p] for p in POINTS.tolist()]),
    "c.ply": packed(PLY.format("binary_big_endian"), ">Bffd", [[7, *p] for p in POINTS.tolist()]),
    "a.pcd": (PCD.format("ascii") + "\n".join(f"1 2 3 {x} {y} {z} 4 5" for x, y, z in WITH_NAN)).encode(),
    "b.pcd": packed(PCD.format("binary"), "<BBBfffhh", [[1, 2, 3, *p, 4, 5] for p in WITH_NAN]),
    "a.xyz": "\n".join(f"{row} 255" for row in ROWS).encode(),
    "a.csv": ("x,y,z\n" + "\n".join(ROWS).replace(" ", ",")).encode(),
}


@pytest.mark.parametrize("name", [*CLOUDS, "a.npy"])
def test_clouds_of_all_formats_are_one(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name in CLOUDS:
        path.write_bytes(CLOUDS[name])
    else:
        np.save(path, POINTS)
    np.testing.assert_array_equal(read_points(path), POINTS)


@pytest.mark.parametrize("name", ["h.npy", "h.csv", "h.png", "h.tif"])
def test_height_maps_of_all_formats_are_one(tmp_path: Path, name: str) -> None:
    image = pytest.importorskip("PIL.Image")
    heights, path = np.arange(12).reshape(3, 4) * 300, tmp_path / name
    if name == "h.npy":
        np.save(path, heights)
    elif name == "h.csv":
        np.savetxt(path, heights, delimiter=",")
    else:
        image.fromarray(heights.astype(np.uint16 if name == "h.png" else np.float32)).save(path)
    np.testing.assert_array_equal(read_heights(path), heights)


def within(boxes: Boxes, points: np.ndarray) -> np.ndarray:
    """How many boxes each point is in."""
    is_in = (points[:, None] > boxes.lows) & (points[:, None] < boxes.highs)
    return np.asarray(is_in.all(axis=2).sum(axis=1))


def test_boxes_are_the_cubes_that_have_points() -> None:
    """Each cube is in one box, boxes have no more volume, and a cloud of its own cubes is the same."""
    points = np.random.default_rng(0).normal(size=(3000, 3)) * [1.0, 1.0, 0.1]
    boxes = boxes_of_cloud(points, 0.1)
    cubes = np.unique(np.floor(points / 0.1), axis=0)
    assert (within(boxes, 0.1 * (cubes + 0.5)) == 1).all()
    volume = np.prod(boxes.highs - boxes.lows, axis=1).sum()
    assert volume == pytest.approx(1e-3 * len(cubes))
    assert measure_enclosed_body(boxes.vertices, boxes.faces).mass == pytest.approx(volume)
    assert len(boxes.lows) < 0.7 * len(cubes)
    again = boxes_of_cloud(np.array(boxes.keys["points"]), 0.1)
    np.testing.assert_allclose(again.lows, boxes.lows)


def test_a_wall_of_points_is_one_box() -> None:
    x, z = np.meshgrid(np.arange(40), np.arange(30))
    wall = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1) * 0.02 + 0.01
    boxes = boxes_of_cloud(wall, 0.02)
    np.testing.assert_allclose(boxes.lows, [[0.0, 0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(boxes.highs, [[0.8, 0.02, 0.6]])


def test_boxes_cover_what_is_below_a_map() -> None:
    """All cells once, each up to its highest corner at least, and no higher than the resolution beyond."""
    rng, cell, most = np.random.default_rng(0), 0.1, 0.05
    heights = np.cumsum(rng.normal(scale=0.03, size=(20, 30)), axis=1)
    heights[3:6, 4:9] = np.nan
    boxes = boxes_of_heights(heights, cell, most)
    i, j = np.meshgrid(np.arange(19), np.arange(29), indexing="ij")
    tops = np.stack([heights[:-1, :-1], heights[1:, :-1], heights[:-1, 1:], heights[1:, 1:]]).max(axis=0)
    x, y = cell * (j - 14.0), cell * (9.0 - i)
    for reach, found in ((-1e-6, ~np.isnan(tops)), (most + 1e-6, np.zeros_like(i, dtype=bool))):
        points = np.stack([x, y, np.nan_to_num(tops) + reach], axis=-1).reshape(-1, 3)
        np.testing.assert_array_equal(within(boxes, points), found.ravel().astype(int))
    corners, faces = weld(*boxes.surface)
    assert not count_open_edges(faces)
    low = float(np.nanmin(heights)) - cell
    halves = heights[1:, :-1], heights[:-1, 1:]  # ends of the diagonal that both triangles share
    mean = (heights[:-1, :-1] + heights[1:, 1:] + 2.0 * sum(halves)) / 6.0
    assert measure_enclosed_body(corners, faces).mass == pytest.approx(
        cell**2 * np.nansum(mean - low), rel=1e-9
    )


def test_maps_are_seen_from_above(planar: Robot) -> None:
    """The first row is at the largest y, columns go along x; results have what a file had."""
    bumps = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.3]]
    words = {"shape": "heights", "heights": bumps, "cell": 0.2, "position": [2.5, 1.0, -0.4]}
    p = problem(planar, obstacle=[words])
    (body,) = [obstacle.compound for obstacle in p.obstacle]
    assert body is not None
    highest = body.vertices[body.vertices[:, 2].argmax()]
    np.testing.assert_allclose(highest, [0.2, -0.2, 0.3])
    again = parse_problem(problem_to_toml(p))
    np.testing.assert_allclose(again.obstacle[0].compound.vertices, body.vertices)


@pytest.fixture(scope="module")
def cloud() -> np.ndarray:
    """Ten thousand points of a table, a mug and a wall [m]."""
    rng = np.random.default_rng(0)
    table = np.column_stack([rng.uniform([0.2, -0.5], [0.9, 0.5], (6000, 2)), np.full(6000, -0.24)])
    turn, height = rng.uniform(0, 2 * np.pi, 2500), rng.uniform(-0.24, 0.3, 2500)
    mug = np.column_stack([0.6 + 0.06 * np.cos(turn), 0.06 * np.sin(turn), height])
    wall = np.column_stack([rng.uniform(-0.3, 0.9, 1500), np.full(1500, 0.91), rng.uniform(-0.2, 0.3, 1500)])
    return np.vstack([table, mug, wall])


def test_a_motion_keeps_away_from_ten_thousand_points(cloud: np.ndarray) -> None:
    """By the distances of all spheres from all points, and by coal's own tree of the points."""
    p = Problem.create(
        "ur5",
        2.5,
        40,
        start={"q": [-0.9, -0.9, 1.2, -1.8, -1.57, 0.0]},
        goal={"q": [0.9, -0.9, 1.2, -1.8, -1.57, 0.0], "v": 0},
        cost={"effort": 1e-3, "velocity": 0.1},
        obstacle=[{"shape": "cloud", "points": cloud.tolist(), "margin": 0.01}],
        scheme="se1",
    )
    assert p.clearance is not None
    assert p.clearance.num_pairs > 2000
    solution = mbocp.solve(p)
    assert solution.converged
    line = np.linspace(0.0, 1.0, 41)[:, None] * (solution.qs[-1] - solution.qs[0]) + solution.qs[0]
    assert of_spheres(p.robot, cloud, line) < 0.01  # it has to leave the line
    assert of_spheres(p.robot, cloud, solution.qs) > 0.01 - 1e-6
    (rows,) = [constraint.rows for constraint in near_the_way(p).path]
    assert rows <= 128
    ts, qs = poses_between(p.robot, solution.t, solution.qs)
    away = of_shapes(p.robot, cloud, qs[np.abs(ts - solution.clearance_time).argmin()])
    assert 0.01 < solution.clearance <= away + 1e-3
    assert away < solution.clearance + 0.02 * 3**0.5


def of_spheres(robot: Robot, points: np.ndarray, qs: np.ndarray) -> float:
    """Least distance of all spheres of the links from all points [m]."""
    tree, least = cKDTree(points), np.inf
    for q in qs:
        for link in (one for one in robot.collision_spheres if one.joint > 1):
            centers = [robot.frame_placement(link.link, q).act(np.array(c)) for c in link.centers]
            least = min(least, float((tree.query(centers)[0] - link.radii).min()))
    return least


def of_shapes(robot: Robot, points: np.ndarray, q: np.ndarray) -> float:
    """Least distance of the shapes of the links from the points, by coal's own tree of these [m]."""
    model, shapes = robot.model, robot.collision_model
    data, placed = model.createData(), shapes.createData()
    pin.updateGeometryPlacements(model, data, shapes, placed, q)
    tree, least = coal.makeOctree(points, 1e-3), np.inf
    for k, shape in enumerate(shapes.geometryObjects):
        if shape.parentJoint > 1:
            at = coal.Transform3s(placed.oMg[k].rotation, placed.oMg[k].translation)
            asked = coal.DistanceRequest(), coal.DistanceResult()
            least = min(least, float(coal.distance(tree, coal.Transform3s(), shape.geometry, at, *asked)))
    return least


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"shape": "cloud"}, r"needs file or points"),
        ({"shape": "cloud", "points": [[0, 0, 0]], "file": "a.ply"}, r"one of them"),
        ({"shape": "cloud", "points": []}, r"points.*none"),
        ({"shape": "cloud", "points": [[0, 0]]}, r"points.*\(n, 3\)"),
        ({"shape": "cloud", "points": [[0, 0, 0]], "scale": 2}, r"scale: of a file; points are in metres"),
        ({"shape": "cloud", "points": [[0, 0, 0]], "cell": 1}, r'cell: shape = "cloud" does not use it'),
        ({"shape": "cloud", "file": "none.ply"}, r"none.ply, which no such file.*PCD"),
        ({"shape": "cloud", "file": "p.toml"}, r"of no format that is read: \.ply"),
        ({"shape": "heights", "heights": [[0, 0], [0, 0]]}, r"needs file or heights.* and cell"),
        ({"shape": "heights", "heights": [[0, 0], [0]], "cell": 1}, r"rows of different lengths"),
        ({"shape": "heights", "heights": [[0, 0]], "cell": 1}, r"heights.*2 rows and columns"),
        ({"shape": "heights", "heights": [[np.nan, 0], [0, 0]], "cell": 1}, r"no four of a cell"),
        ({"shape": "heights", "heights": [[np.inf, 0], [0, 0]], "cell": 1}, r"too large"),
        ({"shape": "heights", "file": "h.csv", "cell": 1, "scale": [1, 1, 1]}, r"scale.*one number"),
        ({"shape": "heights", "file": "h.csv", "cell": 1, "hull": True}, r"hull.*does not use it"),
        ({"shape": "box", "size": [1, 1, 1], "resolution": 0.1}, r"resolution.*does not use it"),
    ],
)
def test_what_is_refused(planar: Robot, tmp_path: Path, monkeypatch, keys: dict[str, Any], told: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "h.csv").write_text("0,0\n0,0\n")
    (tmp_path / "p.toml").write_text("")
    with pytest.raises(MbocpError, match=rf"(?s)obstacle.*{told}"):
        problem(planar, obstacle=[keys])


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (
            lambda: boxes_of_cloud(np.random.default_rng(0).uniform(size=(50_000, 3)), 0.01),
            "resolution makes",
        ),
        (lambda: boxes_of_cloud(np.array([[np.nan, 0.0, 0.0]])), "finite"),
        (lambda: boxes_of_heights(np.zeros((1000, 1000)), 0.1), "250000 heights"),
        (lambda: boxes_of_heights(np.arange(40_000.0).reshape(200, 200), 1.0), "or cell"),
    ],
)
def test_what_is_too_large_is_refused(make: Callable[[], Boxes], told: str) -> None:
    with pytest.raises(MbocpError, match=told):
        make()


@pytest.mark.parametrize("name", ["a.ply", "b.ply", "a.pcd", "b.pcd", "a.csv"])
def test_files_that_are_cut_off_are_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(CLOUDS[name][:-30] if name != "a.csv" else b"1,2,3\n4,5\n")
    with pytest.raises(MbocpError, match=r"cut off"):
        read_points(tmp_path / name)


def test_the_example_goes_over_its_heap() -> None:
    p = load_problem(EXAMPLE)
    assert [(o.name, o.shape) for o in p.obstacle] == [("heap", "heights"), ("beam", "cloud")]
    assert [len(o.pieces) for o in p.obstacle] == [48, 3]
