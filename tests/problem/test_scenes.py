"""`[[obstacle]]` of `shape = "scene"`: URDF, SDF, and MoveIt's planning scenes as text and as YAML."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from benchmarks.touching import Touching
from mbocp.exceptions import MbocpError
from mbocp.problem import load_problem, parse_problem, problem_to_toml
from mbocp.robot import Robot
from mbocp.robot.collision.obstacle import Obstacle
from tests.problem.test_obstacles import planar, problem

__all__ = ["planar"]  # a fixture

EXAMPLE = Path(__file__).parents[2] / "examples" / "arms" / "cell.toml"

URDF = """<robot name="cell"><link name="table"><collision><origin xyz="0 0 0.1"/><geometry>
<box size="1 0.5 0.1"/></geometry></collision></link><link name="post">
<collision><geometry><cylinder radius="0.05" length="0.4"/></geometry></collision>
<collision><origin xyz="0 0 0.2"/><geometry><sphere radius="0.06"/></geometry></collision></link>
<joint name="j" type="fixed"><parent link="table"/><child link="post"/>
<origin xyz="0.3 0 0.3"/></joint></robot>
"""
SDF = """<sdf version="1.7"><model name="cell"><link name="table"><collision name="c">
<pose>0 0 0.1 0 0 0</pose><geometry><box><size>1 0.5 0.1</size></box></geometry></collision></link>
<link name="post"><pose>0.3 0 0.3 0 0 0</pose><collision name="a">
<geometry><cylinder><radius>0.05</radius><length>0.4</length>
</cylinder></geometry></collision><collision name="b"><pose>0 0 0.2 0 0 0</pose><geometry><sphere>
<radius>0.06</radius></sphere></geometry></collision></link>
<joint name="j" type="fixed"><parent>table</parent><child>post</child></joint></model></sdf>
"""
NEW = """cell
* table
0 0 0.1
0 0 0 1
1
box
1 0.5 0.1
0 0 0
0 0 0 1
0 0 0 0
1
edge
0.5 0 0
0 0 0 1
* post
0.3 0 0.3
0 0 0 1
2
cylinder
0.05 0.4
0 0 0
0 0 0 1
0 0 0 0
sphere
0.06
0 0 0.2
0 0 0 1
0 0 0 0
0
.
"""
OLD = """cell
* table
1
box
1 0.5 0.1
0 0 0.1
0 0 0 1
0 0 0 0
* post
2
cylinder
0.05 0.4
0.3 0 0.3
0 0 0 1
0 0 0 0
sphere
0.06
0.3 0 0.5
0 0 0 1
0 0 0 0
.
"""
YAML = """world:
  collision_objects:
    - id: table
      primitives: [{type: box, dimensions: [1, 0.5, 0.1]}]
      primitive_poses: [{position: [0, 0, 0.1], orientation: [0, 0, 0, 1]}]
    - id: post
      pose: {position: {z: 0.3, x: 0.3, y: 0}, orientation: {w: 1, x: 0, y: 0, z: 0}}
      primitives: [{type: cylinder, dimensions: [0.4, 0.05]}, {type: sphere, dimensions: [0.06]}]
      primitive_poses: [{position: [0, 0, 0]}, {position: [0, 0, 0.2]}]
"""
FILES = {"cell.urdf": URDF, "cell.sdf": SDF, "cell.scene": NEW, "old.scene": OLD, "cell.yaml": YAML}


def scene(file: Path, /, **words: Any) -> dict[str, Any]:
    return {"shape": "scene", "margin": 0.01, **({"file": str(file)} | words)}


def words_of(obstacle: Obstacle) -> tuple[Any, ...]:
    numbers = (obstacle.sizes, obstacle.position, obstacle.orientation)
    return (obstacle.name, obstacle.shape, *(tuple(np.asarray(x).round(9).tolist()) for x in numbers))


@pytest.mark.parametrize("name", FILES)
def test_all_formats_say_the_same(planar: Robot, tmp_path: Path, name: str) -> None:
    """A table with a post of two shapes on it, turned by a right angle beside the robot."""
    (tmp_path / name).write_text(FILES[name])
    place = {"position": [5.0, 0.0, -0.1], "rpy": [0.0, 0.0, np.pi / 2]}
    found = problem(planar, obstacle=[scene(tmp_path / name, **place)]).obstacle
    turn = (0.0, 0.0, round(0.5**0.5, 9), round(0.5**0.5, 9))
    assert [words_of(o) for o in found] == [
        ("table", "box", (1.0, 0.5, 0.1), (5.0, 0.0, 0.0), turn),
        ("post 1", "cylinder", (0.05, 0.4), (5.0, 0.3, 0.2), turn),
        ("post 2", "sphere", (0.06,), (5.0, 0.3, 0.4), turn),
    ]
    assert {o.margin for o in found} == {0.01}


MESH = "4 4\n0 0 0\n0.1 0 0\n0 0.1 0\n0 0 0.1\n0 2 1\n0 1 3\n0 3 2\n1 2 3\n"


YAML_MESH = """world: {collision_objects: [{id: wedge, mesh_poses: [{position: [1, 0, 0]}], meshes: [{
  vertices: [[0, 0, 0], {z: 0, x: 0.1, y: 0}, [0, 0.1, 0], [0, 0, 0.1]],
  triangles: [[0, 2, 1], [0, 1, 3], {vertex_indices: [0, 3, 2]}, [1, 2, 3]]}]}]}
"""


@pytest.mark.parametrize("suffix", [".scene", ".yaml"])
def test_meshes_stand_in_planning_scenes(planar: Robot, tmp_path: Path, suffix: str) -> None:
    text = f"cell\n* wedge\n1\nmesh\n{MESH}1 0 0\n0 0 0 1\n0 0 0 0\n.\n"
    file = tmp_path / f"cell{suffix}"
    file.write_text(text if suffix == ".scene" else YAML_MESH)
    p = problem(planar, obstacle=[scene(file, name="cell", position=[4.0, 0.0, 0.0])])
    (found,) = p.obstacle
    assert (found.name, found.shape) == ("cell/wedge", "mesh")
    assert found.hull is not None
    assert found.hull.volume == pytest.approx(1e-3 / 6.0)
    np.testing.assert_allclose(found.position, [5.0, 0.0, 0.0])
    file.unlink()
    assert problem_to_toml(parse_problem(problem_to_toml(p))) == problem_to_toml(p)


@pytest.mark.parametrize(
    ("name", "text", "words", "reason"),
    [
        ("none.urdf", None, {}, "none.urdf"),
        ("cell.scene", NEW[:60], {}, "cell.scene.*is no planning scene of MoveIt.*, or cut off"),
        ("cell.scene", OLD.replace("sphere", "cone"), {}, "'post'.*'cone' is not read, but box, sphere"),
        ("cell.yaml", "- name: post", {}, "is no planning scene of MoveIt, whose objects are in world: coll"),
        ("cell.yaml", "world: {collision_objects: []}", {}, "has no shapes"),
        ("cell.urdf", URDF.replace("fixed", "floating"), {}, "cell.urdf"),
        ("cell.urdf", URDF.replace('"fixed"', '"continuous"'), {}, "link 'post' moves by joint 'j'"),
        ("cell.urdf", URDF, {"radius": 0.1}, "obstacle.0.radius.*does not use it"),
        ("cell.urdf", URDF, {"scale": 0.1}, 'scale: shape = "scene" does not use it'),
        ("cell.urdf", URDF, {"file": None}, "needs file"),
    ],
)
def test_refusals(
    planar: Robot, tmp_path: Path, name: str, text: str | None, words: dict[str, Any], reason: str
) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    written = {key: value for key, value in scene(tmp_path / name, **words).items() if value is not None}
    with pytest.raises(MbocpError, match=reason):
        problem(planar, obstacle=[written])


@pytest.mark.slow
def test_an_arm_moves_in_a_cell() -> None:
    """At a thousand poses a second nothing touches."""
    p = load_problem(EXAMPLE)
    found = mbocp.solve(p, check=True)
    assert found.clearance >= 0.0
    assert Touching.of(p).first(found.t, found.qs, found.vs) is None


def test_a_scene_that_moves_is_carried_as_a_whole(tmp_path: Path) -> None:
    (tmp_path / "cell.urdf").write_text(URDF)
    scene = {"shape": "scene", "file": str(tmp_path / "cell.urdf"), "position": [1.5, 0.0, 0.0]}
    moves = {**scene, "motion": {"velocity": [0.0, 0.2, 0.0]}}
    still, moving = (
        mbocp.Problem.create("ur5", 1.0, 10, goal={"v": 0.0}, obstacle=[table]).obstacle
        for table in (scene, moves)
    )
    assert len(still) == len(moving) == 3
    for one, other in zip(still, moving, strict=True):
        (at,) = other.placements(np.array([0.5]))
        np.testing.assert_allclose(
            at.translation, one.placement.translation + np.array([0.0, 0.1, 0.0]), atol=1e-12
        )
        np.testing.assert_allclose(at.rotation, one.placement.rotation, atol=1e-12)
