"""`[[obstacle]]` and `self_collision`: reading, refusing, what is left out, what is compiled."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import casadi as ca
import coal
import numpy as np
import pinocchio as pin
import pytest

from mbocp.cli.clearance_words import clearance_lines
from mbocp.exceptions import MbocpError, ProblemError
from mbocp.formulation import formulate
from mbocp.mechanics import JointMechanics
from mbocp.problem import Problem, ProblemWarning, parse_problem, problem_to_toml
from mbocp.problem.obstacles.approach import nearest_approach
from mbocp.robot import Robot, load_robot
from mbocp.terms.point import Point
from tests.robot.urdfs import link, robot, write
from tests.terms.test_distances import leveled

BALL = '<collision><origin xyz="{x} 0 0"/><geometry><sphere radius="0.1"/></geometry></collision>'
LIMIT = '<limit lower="-3" upper="3" effort="50" velocity="9"/>'


def hinge(name: str, parent: str, child: str, x: float) -> str:
    return (
        f'<joint name="{name}" type="revolute"><origin xyz="{x} 0 0"/><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="0 0 1"/>{LIMIT}</joint>'
    )


@pytest.fixture
def planar(tmp_path) -> Robot:
    """Three links of half a metre in the plane, each with a ball at its end, and one on the base."""
    names = ["base", "l1", "l2", "l3"]
    links = [link(n, extra=BALL.format(x=0.0 if n == "base" else 0.5)) for n in names]
    pairs = pairwise(names)
    joints = [hinge(f"j{k}", a, b, 0.5 * (k > 1)) for k, (a, b) in enumerate(pairs, start=1)]
    return load_robot(write(tmp_path, robot(*links, *joints)))


def problem(made: Robot, **words: Any) -> Problem:
    start, goal = {"q": [0.0, 0.3, 0.3]}, {"q": [1.0, 0.3, 0.3], "v": 0}
    return Problem.create(made, 1.0, 8, start=start, goal=goal, **{"integrator": {"scheme": "se1"}, **words})


def box(**words: Any) -> dict[str, Any]:
    return {"name": "box", "shape": "box", "size": [0.1, 0.1, 0.1], "position": [0.9, -0.6, 0.0], **words}


def test_an_obstacle_in_other_units_is_warned_of(planar):
    """Some metres away nothing is said, four hundred metres away for an arm of two metres it is."""
    problem(planar, obstacle=[{**box(), "position": [5.0, 0, 0]}])
    with pytest.warns(ProblemWarning, match=r"beyond all that robot .* reaches.*lengths are in metres"):
        problem(planar, obstacle=[{**box(), "size": [100.0] * 3, "position": [400.0, 0, 0]}])


def test_rows_are_clearances_of_spheres(planar):
    p = problem(planar, obstacle=[box()])
    names = [label.name for label in p.clearance.labels]
    assert names == [*(f"distance of l{k}[0] from box" for k in (2, 3)), *["nothing"] * 14]
    assert np.isneginf(p.clearance.lower[2:]).all()
    q = np.array([0.7, 0.4, 0.9])
    found = p.clearance.values(planar, q, np.zeros(3))
    for value, name in zip(found[:2], ("l2", "l3"), strict=True):
        center = planar.frame_placement(name, q).act(np.array([0.5, 0.0, 0.0]))
        outside = np.maximum(np.abs(center - np.array([0.9, -0.6, 0.0])) - 0.05, 0.0)
        assert value == pytest.approx(np.linalg.norm(outside) - 0.1, abs=1e-4)


def test_what_never_meets_is_left_out_and_told(planar):
    p = problem(planar, obstacle=[box()])
    (words,) = clearance_lines(p.clearance)
    assert words == "box: 2 spheres; left out 1 that stand still beside it and 1 that cannot reach it"
    far = problem(planar, obstacle=[box(position=[9.0, 0.0, 0.0])])
    assert far.clearance.rows == 0
    assert not far.path


def test_movable_obstacles_keep_their_pairs(planar):
    """Wherever they stand: the structure is the same, and so are the compiled functions."""
    near, far = (problem(planar, obstacle=[box(movable=True, position=[x, -0.6, 0.0])]) for x in (0.9, 9.0))
    assert near.clearance.num_pairs == far.clearance.num_pairs == 3
    assert near.clearance.term.signature == far.clearance.term.signature
    again = parse_problem(problem_to_toml(far))
    assert again.obstacle[0].movable
    assert "movable = " not in problem_to_toml(problem(planar, obstacle=[box()]))
    with pytest.raises(MbocpError, match=r"movable"):
        problem(planar, obstacle=[box(movable=2)])


def test_reach_is_never_too_short(planar):
    """No pose of many brings a sphere that was left out to the obstacle."""
    p = problem(planar, obstacle=[box()])
    rng = np.random.default_rng(0)
    kept = {p.clearance.spheres[sphere][0] for sphere, _ in p.clearance.pairs}
    left = [k for k, links in enumerate(planar.collision_spheres) if links.joint and k not in kept]
    assert left
    for _ in range(300):
        q = rng.uniform(-np.pi, np.pi, 3)
        for k in left:
            spheres = planar.collision_spheres[k]
            center = planar.frame_placement(spheres.link, q).act(np.array(spheres.centers[0]))
            assert np.linalg.norm(center - np.array([0.9, -0.6, 0.0])) > 0.1 + 0.05 * 3**0.5


def test_obstacles_on_a_frame_move_with_it(planar):
    p = problem(planar, obstacle=[box(frame="l1", position=[0.0, 0.4, 0.0])])
    (row,) = [k for k, label in enumerate(p.clearance.labels) if "l3" in label.name]
    for turn in (0.0, 1.0):  # of what carries both
        value = p.clearance.values(planar, np.array([turn, 0.5, 0.6]), np.zeros(3))[row]
        assert value == pytest.approx(p.clearance.values(planar, np.array([0, 0.5, 0.6]), np.zeros(3))[row])


SHAPES = [
    box(rpy=[0.1, 0.2, 0.3]),
    {"name": "ball", "shape": "sphere", "radius": 0.1, "position": [1.5, 1.0, 0.1]},
    {"name": "pill", "shape": "capsule", "radius": 0.1, "length": 0.3, "position": [-1, 0.8, 0]},
    {"name": "can", "shape": "cylinder", "radius": 0.1, "length": 0.3, "position": [0, -1.2, 0]},
    {"name": "floor", "shape": "halfspace", "position": [0, 0, -1]},
    {"name": "held", "shape": "box", "size": [0.1, 0.2, 0.3], "frame": "l1", "position": [0, 0.4, 0]},
]


def test_derivatives_of_the_rows(planar):
    """Values against those in numbers, derivatives against differences: still and carried shapes, itself."""
    clearance = problem(planar, obstacle=SHAPES, self_collision=True).clearance
    assert clearance.sphere_pairs
    assert (clearance.term.still, clearance.term.moving) == (16, 16)
    q = ca.SX.sym("q", 3)
    f = clearance.term.function(Point(JointMechanics(planar), q, ca.SX.zeros(3)))
    numbers, at, step = list(clearance.numbers.values()), np.array([0.4, 0.8, -0.7]), 1e-6
    m = np.random.default_rng(0).normal(size=clearance.rows)
    h, J, H = (np.array(ca.DM(x).full()) for x in f(at, m, *numbers))
    kept = np.isfinite(clearance.lower)
    radii = clearance.inner_bounds[0][kept] - clearance.lower[kept]
    expected = leveled(clearance.values(planar, at, at)[kept], clearance.lower[kept])
    np.testing.assert_allclose(h.ravel()[kept] - radii, expected, atol=1e-12)
    sides = [[f(at + s * step * e, m, *numbers) for s in (1, -1)] for e in np.eye(3)]
    ahead = [(np.array(a[0]) - np.array(b[0])) / (2 * step) for a, b in sides]
    np.testing.assert_allclose(J, np.hstack(ahead), atol=1e-7)
    bends = [m @ (np.array(a[1]) - np.array(b[1])) / (2 * step) for a, b in sides]
    np.testing.assert_allclose(H, np.triu(bends), atol=1e-6)


def test_the_least_clearance_is_that_of_all_pairs(planar):
    clearance = problem(planar, obstacle=SHAPES, self_collision=True).clearance
    qs = np.random.default_rng(1).uniform(-3, 3, (50, 3))
    least = (clearance.pair_values(qs) - clearance.margins).min(axis=1)
    np.testing.assert_allclose(clearance.least(qs), least, atol=1e-12)
    np.testing.assert_allclose(clearance.least(qs, 0.1), np.minimum(least, 0.1), atol=1e-12)


def test_scenes_compile_nothing(planar):
    """How many obstacles there are, of which shape, where, and which pairs take part are parameters."""

    def text(*obstacles: dict[str, Any]) -> str:
        made = problem(planar, obstacle=obstacles)
        return str([constraint.structure("quaternion").signature for constraint in made.path])

    one = text(box())
    assert one == text(box(size=[0.2, 0.1, 0.3], position=[0.9, -0.7, 0.1], rpy=[0, 0, 1], margin=0.02))
    assert one == text(*SHAPES[:5])
    assert one != text(*(box(name=f"box {k}") for k in range(20)))


def test_rows_of_some_pairs(planar):
    clearance = problem(planar, obstacle=SHAPES, self_collision=True).clearance
    some = clearance.of_pairs([0, 3, len(clearance.pairs)])
    names = [label.name for label in some.labels if label.name != "nothing"]
    assert set(names) <= {label.name for label in clearance.labels}
    assert len(names) == 3
    q = np.array([0.4, 0.8, -0.7])
    values = dict(zip(clearance.labels, clearance.values(planar, q, q), strict=True))
    for label, value in zip(some.labels, some.values(planar, q, q), strict=True):
        assert value == values[label]


def test_a_file_says_the_same_again(planar):
    p = problem(
        planar,
        obstacle=[
            box(rpy=[0.1, 0.2, 0.3], margin=0.01),
            {"shape": "capsule", "radius": 0.1, "length": 0.2, "position": [0, 2, 0], "frame": "l1"},
        ],
        self_collision={"margin": 0.02, "disabled": [["l1", "l3"]]},
    )
    text = problem_to_toml(p)
    again = parse_problem(text)
    assert problem_to_toml(again) == text
    assert again.clearance.labels == p.clearance.labels
    for name, value in p.clearance.numbers.items():
        np.testing.assert_array_equal(again.clearance.numbers[name], value)
    assert [o.table.keys() for o in again.obstacle] == [o.table.keys() for o in p.obstacle]
    changed = p.with_(obstacle=[box(margin=0.03)])
    assert (changed.obstacle[0].margin, len(changed.obstacle)) == (0.03, 1)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ({"position": [0.5, 0.0, 0.0], "name": "it"}, "obstacle 'it': at the start l1 is .* inside it"),
        ({"shape": "cone"}, "obstacle 'box'.*shape.*cone.*cover other shapes"),
        ({"shape": "blob"}, "obstacle 'box'.*shape.*blob"),
        ({"radius": 0.1}, "obstacle.0.radius.*does not use it"),
        ({"size": [0.1, -0.1, 0.1]}, "obstacle 'box'.*lengths above 0"),
        ({"frame": "nowhere"}, "'nowhere'"),
        ({"rpy": [0, 0, 1], "orientation": [0, 0, 0, 1]}, "give rpy or orientation"),
        ({"margin": float("nan")}, "obstacle.*margin"),
    ],
)
def test_refusals(planar, words, reason):
    with pytest.raises(MbocpError, match=reason):
        problem(planar, obstacle=[box(**words)])


def test_a_goal_inside_is_refused(planar):
    q = planar.frame_placement("l3", [1.0, 0.3, 0.3]).act(np.array([0.5, 0.0, 0.0]))
    with pytest.raises(ProblemError, match=r"obstacle 'box': at the goal l3 is .* inside it"):
        problem(planar, obstacle=[box(position=q.tolist())])


def test_a_margin_is_kept_at_the_start(planar):
    q = planar.frame_placement("l3", [0.0, 0.3, 0.3]).act(np.array([0.5, 0.0, 0.0]))
    near = box(position=(q + np.array([0.0, 0.155, 0.0])).tolist())
    problem(planar, obstacle=[near])
    with pytest.raises(ProblemError, match=r"at the start l3 is .* mm from it .* margin is 20 mm"):
        problem(planar, obstacle=[{**near, "margin": 0.02}])


def test_a_robot_without_collision_geometry_is_refused():
    with pytest.raises(ProblemError, match="'five_bar' has no collision geometry"):
        Problem.create("five_bar", 1.0, 8, obstacle=[box()])


def test_two_of_a_name_are_refused(planar):
    with pytest.raises(ProblemError, match="several of this name"):
        problem(planar, obstacle=[box(), box()])


def test_self_collision_finds_its_pairs(planar, tmp_path):
    p = problem(planar, self_collision=True)
    assert p.clearance.self_pairs.links == (("base", "l2"), ("base", "l3"), ("l1", "l3"))
    assert len(p.clearance.self_pairs.left_out["next to each other"]) == 3
    srdf = '<robot name="test"><disable_collisions link1="l3" link2="l1" reason="Never"/></robot>'
    (tmp_path / "robot.srdf").write_text(srdf)
    disabled = problem(planar, self_collision={"disabled": [["base", "l2"]]})
    assert disabled.clearance.self_pairs.links == (("base", "l3"),)
    with pytest.raises(ProblemError, match="'l9' is no link"):
        problem(planar, self_collision={"disabled": [["base", "l9"]]})
    with pytest.raises(ProblemError, match=r"self_collision: at the start base is .* inside l3"):
        p.with_(start={"q": [0.0, 2.0944, 2.0944]})


@pytest.mark.parametrize("given", ['lower="0" upper="0"', 'lower="0.4" upper="0.4"', ""])
def test_joints_without_limits_find_what_they_may_meet(planar, tmp_path, given):
    """Equal limits are none: such joints do not stay where these are."""
    text = next(tmp_path.glob("*.urdf")).read_text().replace('lower="-3" upper="3"', given)
    free = problem(load_robot(write(tmp_path, text)), self_collision=True)
    assert free.clearance.self_pairs.links == problem(planar, self_collision=True).clearance.self_pairs.links


def test_springs_beside_self_collision_change_no_pair(planar):
    """Their motors have no position limits, and no links."""
    spring = {"joint": "j2", "stiffness": 100.0, "motor_inertia": 1.0}
    elastic = load_robot(planar.source, elastic=[spring])
    goal = {"q": {"j1": 1.0, "j2": 0.3, "j3": 0.3}, "v": 0}
    p = Problem.create(elastic, 1.0, 8, start={"q": [0.0, 0.3, 0.3]}, goal=goal, self_collision=True)
    assert p.clearance.self_pairs.links == problem(planar, self_collision=True).clearance.self_pairs.links


def test_the_nearest_approach_is_that_of_every_pose(planar):
    """Compared with coal at all poses, shape by shape."""
    p = problem(
        planar, obstacle=[box(position=[0.9, 0.9, 0.0]), {"shape": "halfspace", "position": [0, 0, -1]}]
    )
    t = np.array([0.0, 0.1, 0.25])
    qs = np.array([[0.0, 0.3, 0.3], [0.5, 0.0, 0.3], [1.2, 0.4, -0.5]])
    found = nearest_approach(p.clearance, t, qs)
    best = np.inf
    geometry, data = planar.collision_model, planar.model.createData()
    for time in np.linspace(0.0, 0.25, 251):
        k = min(int(np.searchsorted(t, time, side="right")) - 1, 1)
        q = pin.interpolate(planar.model, qs[k], qs[k + 1], (time - t[k]) / (t[k + 1] - t[k]))
        pin.forwardKinematics(planar.model, data, q)
        for shape in geometry.geometryObjects:
            if not shape.parentJoint:
                continue
            at = data.oMi[shape.parentJoint] * shape.placement
            for obstacle in p.obstacle:
                there = obstacle.placement
                request, result = coal.DistanceRequest(), coal.DistanceResult()
                best = min(
                    best,
                    coal.distance(
                        shape.geometry,
                        coal.Transform3s(at.rotation, at.translation),
                        obstacle.geometry,
                        coal.Transform3s(there.rotation, there.translation),
                        request,
                        result,
                    ),
                )
    assert found.distance == pytest.approx(best, abs=1e-9)
    assert found.other == "box"


def test_what_happens_between_nodes_is_seen(planar):
    """From one node to the next through a thin plate, with both nodes clear."""
    plate = box(size=[1.0, 0.002, 1.0], position=[1.0, 1.0, 0.0])
    p = problem(planar, obstacle=[plate])
    qs = np.array([[0.2, 0.3, 0.3], [1.6, 0.3, 0.3]])
    assert p.clearance.values_along(planar, qs, qs, qs).min() > 0.0
    found = nearest_approach(p.clearance, np.array([0.0, 1.0]), qs)
    assert found.distance < -0.05
    assert 0.0 < found.time < 1.0
    assert "inside box at t = 0." in found.words


def test_a_formulation_has_the_rows(planar):
    p = problem(planar, obstacle=[box(margin=0.01)])
    made = formulate(p)
    assert made.programme.path_names == tuple(label.name for label in p.clearance.labels)
    np.testing.assert_allclose(made.programme.bounds.path_lower[0, :2], 0.1 + 0.01)
    assert np.isneginf(made.programme.bounds.path_lower[0, 2:]).all()


def test_an_unknown_carrier_is_refused_by_the_obstacles_name(planar: Robot) -> None:
    ball = {"name": "ball", "shape": "sphere", "radius": 0.1, "position": [3, 0, 0], "frame": "l9"}
    with pytest.raises(MbocpError, match=r"obstacle 'ball': robot .* no frame 'l9'"):
        Problem.create(planar, 1.0, 10, goal={"v": 0}, obstacle=[ball])
