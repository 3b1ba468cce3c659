"""`[[obstacle]]` of `shape = "mesh"`: reading, refusing, rows, ways, the check between nodes, pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import mbocp
from mbocp.cli.clearance_words import clearance_lines
from mbocp.exceptions import MbocpError
from mbocp.formulation import formulate
from mbocp.mechanics import JointMechanics
from mbocp.problem import Problem, load_problem, parse_problem, problem_to_toml
from mbocp.problem.obstacles.approach import nearest_approach
from mbocp.robot import Robot
from mbocp.robot.collision.hull import hull_of
from mbocp.terms.point import Point
from mbocp.view.meshcat.goals import obstacle_commands, obstacle_points
from tests.problem.test_obstacles import box, planar, problem
from tests.robot.collision.test_hull import clouds, obj
from tests.terms.test_distances import leveled

__all__ = ["planar"]  # a fixture

STONE = (clouds(7, 20) - clouds(7, 20).mean(axis=0)).tolist()


def stone(**words: Any) -> dict[str, Any]:
    return {"name": "stone", "shape": "mesh", "vertices": STONE, "position": [0.9, -0.8, 0.0], **words}


def test_rows_are_distances_from_the_hull(planar: Robot) -> None:
    """A box by its corners, beside the box."""
    corners = [[x, y, z] for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.05, 0.05)]
    place = {"position": [0.9, -0.6, 0.0], "rpy": [0.1, 0.2, 0.3]}
    made = problem(planar, obstacle=[stone(vertices=corners, **place)]).clearance
    boxed = problem(planar, obstacle=[box(**place)]).clearance
    assert [label.name for label in made.labels[:2]] == [f"distance of l{k}[0] from stone" for k in (2, 3)]
    qs = np.random.default_rng(0).uniform(-1.5, 1.5, (200, 3))
    found, true = made.pair_values(qs), boxed.pair_values(qs)
    error = made.planes[0].error
    assert error < 0.01
    near = np.abs(found) < 0.1
    assert near.sum() > 20
    assert (found[near] - true[near]).max() < 0.004
    assert (true[near] - found[near]).max() < error * 2.2 + 0.004  # these centres are farther than was asked


def test_derivatives_of_the_rows(planar: Robot) -> None:
    """Still, carried, beside other shapes: values in C++ and in numbers, derivatives against differences."""
    shapes = [
        stone(),
        box(),
        stone(name="held", frame="l1", position=[0.0, 0.5, 0.0]),
        stone(name="far", position=[-0.9, 0.9, 0.1], rpy=[1.0, 0.0, 0.0]),
    ]
    clearance = problem(planar, obstacle=shapes, self_collision=True).clearance
    assert (clearance.term.still, clearance.term.moving) == (16, 16)
    slots = clearance.term.hull_slots
    assert (slots.rows, slots.hulls) == (16, 4)
    q = ca.SX.sym("q", 3)
    point = Point(JointMechanics(planar), q, ca.SX.zeros(3))
    f, values = clearance.term.function(point), clearance.term.values(point)
    numbers, step = list(clearance.numbers.values()), 1e-6
    rng = np.random.default_rng(0)
    m, kept = rng.normal(size=clearance.rows), np.isfinite(clearance.lower)
    radii = clearance.inner_bounds[0][kept] - clearance.lower[kept]
    for at in rng.uniform(-1.5, 1.5, (4, 3)):
        h, J, H = (np.array(ca.DM(x).full()) for x in f(at, m, *numbers))
        np.testing.assert_allclose(values(at, *numbers).full().ravel(), h.ravel(), atol=1e-12)
        here = leveled(clearance.values(planar, at, at)[kept], clearance.lower[kept])
        np.testing.assert_allclose(h.ravel()[kept] - radii, here, atol=1e-11)
        sides = [[f(at + s * step * e, m, *numbers) for s in (1, -1)] for e in np.eye(3)]
        ahead = [(np.array(a[0]) - np.array(b[0])) / (2 * step) for a, b in sides]
        np.testing.assert_allclose(J, np.hstack(ahead), atol=1e-6)
        bends = [m @ (np.array(a[1]) - np.array(b[1])) / (2 * step) for a, b in sides]
        np.testing.assert_allclose(H, np.triu(bends), atol=1e-4 * max(1.0, np.abs(H).max()))


def test_the_least_clearance_is_that_of_all_pairs(planar: Robot) -> None:
    clearance = problem(planar, obstacle=[stone(), box(), stone(name="held", frame="l1")]).clearance
    qs = np.random.default_rng(1).uniform(-3, 3, (100, 3))
    least = (clearance.pair_values(qs) - clearance.margins).min(axis=1)
    for most in (np.inf, 0.5, 0.1, 0.0):
        np.testing.assert_allclose(clearance.least(qs, most), np.minimum(least, most), atol=1e-12)


def test_what_is_far_away_is_only_bounded(planar: Robot) -> None:
    clearance = problem(planar, obstacle=[stone(), stone(name="held", frame="l1")]).clearance
    qs = np.random.default_rng(2).uniform(-3, 3, (100, 3))
    every = clearance.pair_values(qs)
    for near in (0.3, 0.05, -0.05):
        found, is_near = clearance.pair_values(qs, near), every <= near
        np.testing.assert_allclose(found[is_near], every[is_near], atol=1e-12)
        assert (found[~is_near] > near).all()
        assert (found <= every + 1e-12).all()


def test_hulls_of_a_size_compile_nothing(planar: Robot) -> None:
    """Corners, place and number of faces are parameters, and so is which pairs have rows."""

    def text(*obstacles: dict[str, Any]) -> str:
        made = problem(planar, obstacle=obstacles)
        return str([constraint.structure("quaternion").signature for constraint in made.path])

    rough = (clouds(11, 9) - clouds(11, 9).mean(axis=0)).tolist()
    one = text(stone())
    assert one == text(stone(vertices=rough, rpy=[0, 0, 1], margin=0.01))
    assert one != text(stone(), stone(name="other"))
    clearance = problem(planar, obstacle=[stone(), box()]).clearance
    some = {str(clearance.of_pairs(chosen).term.signature) for chosen in ([0], [1], [0, 2])}
    assert len(some) == 1


def test_a_file_says_the_same_again(planar: Robot, tmp_path: Path) -> None:
    """The text of a problem has the corners, so that it needs the file no more."""
    path = obj(tmp_path / "stone.obj", hull_of(1000 * np.array(STONE)))
    table = {"name": "stone", "shape": "mesh", "file": str(path), "scale": 0.001, "position": [0.9, -0.8, 0]}
    p = problem(planar, obstacle=[table])
    path.unlink()
    text = problem_to_toml(p)
    again = parse_problem(text)
    assert problem_to_toml(again) == text
    assert again.obstacle[0].hull == p.obstacle[0].hull
    np.testing.assert_allclose(again.obstacle[0].hull.volume, hull_of(np.array(STONE)).volume)
    for name, value in p.clearance.numbers.items():
        np.testing.assert_array_equal(again.clearance.numbers[name], value)


def test_files_are_beside_the_problem(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    obj(tmp_path / "meshes/stone.obj", hull_of(np.array(STONE)))
    (tmp_path / "task.toml").write_text(
        'robot = "ur5"\n[horizon]\nduration = 1.0\nsteps = 10\n[goal]\nq = [0.1, 0, 0, 0, 0, 0]\n'
        '[[obstacle]]\nshape = "mesh"\nfile = "meshes/stone.obj"\nposition = [0, 0.8, 0.8]\n'
    )
    (made,) = load_problem(tmp_path / "task.toml").obstacle
    assert made.hull == hull_of(np.array(STONE))
    assert made.name == "mesh 1"


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ({"vertices": None}, "obstacle 'stone': .*needs file or vertices"),
        ({"file": "none.stl"}, "needs file or vertices, one of them"),
        ({"vertices": None, "file": "none.stl"}, r"obstacle 'stone': file: got .*none\.stl.*no such file"),
        ({"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]}, "obstacle 'stone'.*one plane"),
        ({"vertices": [[0, 0], [1, 0]]}, "obstacle 'stone'.*three numbers"),
        ({"vertices": [[0, 0, float("nan")]]}, "vertices"),
        ({"scale": 2.0}, "obstacle 'stone'.*scale: of a file"),
        ({"vertices": None, "file": "none.stl", "scale": [1.0, -1.0, 1.0]}, "scale.*above 0"),
        ({"vertices": None, "file": "none.stl", "scale": [1.0, 1.0]}, "scale.*one number or three"),
        ({"radius": 0.1}, "obstacle.0.radius.*does not use it"),
        ({"shape": "sphere", "radius": 0.1}, "obstacle 'stone'.*vertices.*does not use it"),
    ],
)
def test_refusals(planar: Robot, words: dict[str, Any], reason: str) -> None:
    written = {key: value for key, value in stone(**words).items() if value is not None}
    with pytest.raises(MbocpError, match=reason):
        problem(planar, obstacle=[written])


def test_what_stands_for_a_hull_is_told(planar: Robot) -> None:
    (words,) = clearance_lines(problem(planar, obstacle=[stone()]).clearance)
    assert "planes stand for its hull and keep" in words
    assert "mm more away at most" in words


def test_what_happens_between_nodes_is_seen(planar: Robot) -> None:
    """From one node to the next through a thin body, with both nodes clear; coal has the hull itself."""
    plate = [[x, y, z] for x in (-0.5, 0.5) for y in (-0.001, 0.001) for z in (-0.5, 0.5)]
    p = problem(planar, obstacle=[stone(vertices=plate, position=[1.0, 1.0, 0.0])])
    qs = np.array([[0.2, 0.3, 0.3], [1.6, 0.3, 0.3]])
    assert p.clearance.values_along(planar, qs, qs, qs).min() > 0.0
    found = nearest_approach(p.clearance, np.array([0.0, 1.0]), qs)
    assert found.distance < -0.05
    assert "inside stone at t = 0." in found.words


def test_hulls_are_drawn_where_they_are(planar: Robot) -> None:
    made = problem(planar, obstacle=[stone(), stone(name="held", frame="l2")]).obstacle
    commands = list(obstacle_commands(planar, made, "/joint{}".format, 2.0))
    kinds = [command.lower()["type"] for command in commands]
    assert kinds == ["set_object", "set_transform"] * 2
    corners = np.array(obstacle_points(planar, made))
    points = np.array(STONE) + np.array([0.9, -0.8, 0.0])
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [points.min(0), points.max(0)])


@pytest.mark.parametrize("words", [{}, {"scheme": "gauss2"}, {"scheme": "rk4"}])
def test_formulations_have_the_rows(planar: Robot, words: dict[str, Any]) -> None:
    made = formulate(problem(planar, obstacle=[stone(margin=0.01)], **words))
    names = made.programme.path_names
    assert [name for name in names if name != "nothing"] == [
        f"distance of l{k}[0] from stone" for k in (2, 3)
    ]
    np.testing.assert_allclose(made.programme.bounds.path_lower[0, :2], 0.1 + 0.01)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_motions_called_converged_touch_nothing(seed: int) -> None:
    """A UR5 around stones in the middle of its way, at a thousand poses a second by coal."""
    points = 0.6 * clouds(seed, 16)
    stones = [
        {"name": "stone", "shape": "mesh", "vertices": (points - points.mean(axis=0)).tolist()}
        | {"position": [0.5, 0.0, 0.3]},
        {"name": "floor", "shape": "halfspace", "position": [0, 0, -0.2]},
    ]
    p = Problem.create(
        "ur5",
        2.0,
        80,
        start={"q": [-0.9, -1.0, 1.2, -0.2, 0.5, 0.0]},
        goal={"q": [0.9, -1.0, 1.2, -0.2, 0.5, 0.0]},
        obstacle=stones,
        cost={"effort": 1e-3},
        limits={"effort": True},
        scheme="se1",
    )
    found = mbocp.solve(p)
    nearest = nearest_approach(p.clearance, found.t, found.qs, found.vs)
    assert found.clearance == pytest.approx(nearest.distance - nearest.margin)
    assert found.converged
    assert found.clearance >= -1e-9


def around_stones(name: str) -> Problem:
    """Another robot than an arm of six joints, a stone that is carried, another scheme."""
    points = 0.6 * clouds(3, 16)
    stone = {"name": "stone", "shape": "mesh", "vertices": (points - points.mean(axis=0)).tolist()}
    cost = {"effort": 1e-3, "velocity": "auto"}
    if name == "panda":
        start, goal = [[side, 0.3, 0.0, -1.9, 0.0, 2.2, 0.8] for side in (-0.8, 0.8)]
        lock = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}
        told: dict[str, Any] = {"start": {"q": start}, "goal": {"q": goal, "v": 0}, "scheme": "midpoint"}
        stones = [{**stone, "position": [0.55, 0.0, 0.35]}]
        return Problem.create(
            {"name": "panda", "lock": lock},
            2.0,
            40,
            obstacle=stones,
            cost=cost,
            **{"integrator": {"scheme": "se1"}, **told},
        )
    ends = {"start": {"q": [-1.0, 0, 0, 0, 0, 0, 1]}, "goal": {"q": [1.0, 0.1, 0, 0, 0, 0, 1], "v": 0}}
    stones = [{**stone, "position": [0.0, 0.1, 0.05]}]
    drone = {"name": "hector", "actuated": ["root_joint"]}
    return Problem.create(drone, 2.0, 40, obstacle=stones, cost=cost, scheme="gauss2", **ends)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["panda", "drone"])
def test_others_touch_nothing(name: str) -> None:
    """At a thousand poses a second by coal, while the motion without the stone would hit it."""
    p = around_stones(name)
    assert p.clearance is not None
    found, straight = mbocp.solve(p), mbocp.solve(p.with_(obstacle=[]))
    assert found.converged
    nearest = nearest_approach(p.clearance, found.t, found.qs, found.vs)
    assert found.clearance == pytest.approx(nearest.distance - nearest.margin)
    assert found.clearance >= -1e-9
    assert nearest_approach(p.clearance, straight.t, straight.qs).distance < -0.01


@pytest.mark.parametrize("scheme", ["midpoint", "gauss2"])
def test_a_stone_that_is_carried_is_gone_around(planar: Robot, scheme: str) -> None:
    """It moves with the first link, and the last one has to pass it; by coal at a thousand poses a second."""
    small = (0.3 * np.array(STONE)).tolist()
    held = stone(frame="l1", vertices=small, position=[0.45, 1.1, 0.0])
    ends = {"start": {"q": [0.0, 0.9, 0.1]}, "goal": {"q": [0.0, 2.2, 0.2], "v": 0}}
    words: dict[str, Any] = {"cost": {"effort": 1.0, "velocity": 10.0}, "scheme": scheme, **ends}
    p = Problem.create(
        planar, 1.0, 24, obstacle=[held], solver="monolithic", **{"integrator": {"scheme": "se1"}, **words}
    )
    assert p.clearance is not None
    found = mbocp.solve(p, check=True)
    nearest = nearest_approach(p.clearance, found.t, found.qs, found.vs)
    assert -1e-6 < nearest.distance < 0.05
    straight = mbocp.solve(
        Problem.create(planar, 1.0, 24, solver="monolithic", **{"integrator": {"scheme": "se1"}, **words}),
        check=True,
    )
    assert nearest_approach(p.clearance, straight.t, straight.qs).distance < -5e-3


def test_a_hull_whose_box_has_its_middle_outside() -> None:
    """A corner of a box: the middle of the box is beyond its slanted side."""
    corner = np.array([[0.0, 0.0, 5.0], [1.0, 0.0, 5.0], [0.0, 1.0, 5.0], [0.0, 0.0, 6.0]])
    hull = hull_of(corner)
    box = (corner.min(axis=0) + corner.max(axis=0)) / 2.0
    assert (box - [0.0, 0.0, 5.0]).sum() > 1.0
    weights = np.linalg.solve(np.vstack([corner.T, np.ones(4)]), np.append(hull.middle, 1.0))
    assert (weights > 0.0).all()
    shape = {"shape": "mesh", "vertices": corner.tolist()}
    problem = Problem.create("ur5", 1.0, 10, goal={"q": [1.0, -1, 1, 0, 0, 0], "v": 0}, obstacle=[shape])
    assert problem.clearance is not None
