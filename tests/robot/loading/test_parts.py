"""Several robots in one world: each moves as it does alone, and what joins them is checked."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.exceptions import (
    DimensionMismatch,
    MbocpError,
    ProblemFileError,
    RobotError,
    UnknownFrame,
    UnknownJoint,
)
from mbocp.mechanics import JointMechanics
from mbocp.mechanics.natural_coordinates.bodies import body_tree
from mbocp.problem import Problem
from mbocp.problem.file.limits_table import bounds_from
from mbocp.problem.file.load import parse_problem
from mbocp.problem.file.named_values import control_from
from mbocp.problem.file.tables import problem_to_toml
from mbocp.problem.limits import LIMITS
from mbocp.robot import Payload, Robot, describe, load_parts, load_robot, robot_from_spec
from mbocp.view.figures.frame_paths import frame_paths
from mbocp.view.replay import write_replay
from tests.mechanics import mimics
from tests.robot import urdfs
from tests.view.pages import read_page

PLACES = ({"position": [0.0, 0.6, 0.0]}, {"position": [0.3, -0.6, 0.2], "orientation": [0.0, 0.0, 1.1]})
TURNED = {"position": [0.1, 0.2, 1.5], "orientation": [np.pi, 0.3, -0.2]}


def two(robot: str, **options: Any) -> Robot:
    """The same robot twice, upright at two places."""
    tables = zip(("left", "right"), PLACES, strict=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load_parts([{"robot": robot, "name": name, **place, **options} for name, place in tables])


def alone(robot: str, **options: Any) -> Robot:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load_robot(robot, **options)


def split(whole: Robot, values: np.ndarray, letter: str) -> list[np.ndarray]:
    """Numbers of q or v by part, in the order of the part's own joints."""
    ranges = whole.configuration_indices if letter == "q" else whole.velocity_indices
    return [
        np.concatenate([values[ranges(name)] for name in whole.joint_names if name.startswith(part.prefix)])
        for part in whole.parts
    ]


NAMES = (
    "ur5",
    "kinova",
    "panda",
    "hand",
    "elastic_pendulum",
    "cart_pendulum_rigid",
    "four_bar",
    "delta",
    "hector",
    "talos",
    "unicycle_pendulum",
)


@pytest.fixture(params=NAMES)
def name(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param != "hand":
        return str(request.param)
    return str(urdfs.write(tmp_path, mimics.HAND))


def test_two_of_a_kind_move_as_each_alone(name: str) -> None:
    whole, one = two(name), alone(name)
    assert (whole.nq, whole.nv, whole.nu, whole.nc) == (2 * one.nq, 2 * one.nv, 2 * one.nu, 2 * one.nc)
    rng = np.random.default_rng(0)
    for _ in range(2):
        q = whole.integrate(whole.q0, 0.3 * rng.standard_normal(whole.nv))
        v, a, u = (rng.standard_normal(n) for n in (whole.nv, whole.nv, whole.nu))
        qs, vs, accelerations = split(whole, q, "q"), split(whole, v, "v"), split(whole, a, "v")
        mass = whole.mass_matrix(q)
        places = split(whole, np.arange(whole.nv), "v")
        torque = pin.rnea(whole.model, whole.model.createData(), q, v, a)
        assert np.abs(mass[np.ix_(*places)]).max() < 1e-14
        columns = [[label.name.startswith(p.prefix) for label in whole.u_labels] for p in whole.parts]
        force = whole.actuation_matrix(q) @ u + whole.force_elements(q, v)
        for place, qi, vi, ai, own in zip(places, qs, vs, accelerations, columns, strict=True):
            size = 1e-12 * (1.0 + np.abs(torque).max())
            np.testing.assert_allclose(mass[np.ix_(place, place)], one.mass_matrix(qi), atol=1e-12)
            base = "floating" in [joint["type"] for joint in describe(one)["joints"]]
            if not base:  # its weight acts in other axes where the base is turned
                expected = pin.rnea(one.model, one.model.createData(), qi, vi, ai)
                np.testing.assert_allclose(torque[place], expected, atol=size)
            expected = one.actuation_matrix(qi) @ u[own] + one.force_elements(qi, vi)
            np.testing.assert_allclose(force[place], expected, atol=1e-11)
        rows = len(one.closure_labels)
        residual = whole.closure_residual(q)
        for i, qi in enumerate(qs):
            np.testing.assert_allclose(
                residual[i * rows : (i + 1) * rows], one.closure_residual(qi), atol=1e-12
            )


def test_limits_labels_and_losses(name: str) -> None:
    whole, one = two(name), alone(name)
    for letter, bounds in (("v", "velocity"), ("q", "position_lower"), ("q", "position_upper")):
        for own in split(whole, getattr(whole.limits, bounds), letter):
            np.testing.assert_array_equal(own, getattr(one.limits, bounds))
    efforts = dict(zip((label.name for label in whole.u_labels), whole.limits.effort, strict=True))
    for label, effort in zip(one.u_labels, one.limits.effort, strict=True):
        assert efforts[f"left/{label.name}"] == efforts[f"right/{label.name}"] == effort
    losses = {r.name: (r.ratio, r.damping, r.friction) for r in whole.resistances}
    assert losses == {
        f"{part.name}/{r.name}": (r.ratio, r.damping, r.friction)
        for part in whole.parts
        for r in one.resistances
    }
    assert [drive.name for drive in whole.drives] == [
        f"{p.name}/{d.name}" for p in whole.parts for d in one.drives
    ]
    assert len(whole.connectors) == 2 * len(one.connectors)
    assert whole.visual_model.ngeoms == 2 * one.visual_model.ngeoms
    assert whole.trace_frames == tuple(f"{p.name}/{frame}" for p in whole.parts for frame in one.trace_frames)
    assert len(whole.redundant_rows) == 2 * len(one.redundant_rows)
    for own in split(whole, whole.q0, "q"):
        np.testing.assert_allclose(own, one.q0, atol=1e-9)


def test_it_loads_again_from_its_spec(name: str) -> None:
    whole = two(name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        again = robot_from_spec(whole.spec)
    assert again.fingerprint == whole.fingerprint
    assert again.parts == whole.parts
    assert again.spec == whole.spec


def test_a_base_that_is_turned_is_gravity_that_is_turned() -> None:
    whole = load_parts([{"robot": "ur5", "name": "arm", **TURNED}])
    rotation = pin.rpy.rpyToMatrix(np.array(TURNED["orientation"]))
    one = load_robot("ur5", gravity=rotation.T @ [0.0, 0.0, -9.81])
    rng = np.random.default_rng(1)
    q, v, a = (rng.standard_normal(6) for _ in range(3))
    np.testing.assert_allclose(
        pin.rnea(whole.model, whole.model.createData(), q, v, a),
        pin.rnea(one.model, one.model.createData(), q, v, a),
        atol=1e-11,
    )
    there = whole.frame_placement("arm/tool0", q)
    own = one.frame_placement("tool0", q)
    np.testing.assert_allclose(there.translation, rotation @ own.translation + TURNED["position"], atol=1e-12)


def test_an_arm_on_a_moving_frame(tmp_path: Path) -> None:
    """As a URDF that says the same: a rail with two branches, and an arm on the first."""
    rail = [
        urdfs.link("base"),
        urdfs.link("cart"),
        urdfs.joint("slide", "prismatic", "base", "cart", axis="1 0 0"),
        urdfs.link("mast"),
        urdfs.joint("turn", "revolute", "base", "mast"),
    ]
    arm = [
        urdfs.link("root"),
        urdfs.link("upper"),
        urdfs.joint("shoulder", "revolute", "root", "upper", axis="0 1 0"),
    ]
    mount = '<joint name="mount" type="fixed"><origin xyz="0.1 0 0.2" rpy="0 0 0.5"/>'
    mount += '<parent link="cart"/><child link="root"/></joint>'
    whole = load_parts(
        [
            {"robot": str(urdfs.write(tmp_path / "arm", urdfs.robot(*arm))), "name": "arm",
             "parent": "rail/cart", "position": [0.1, 0, 0.2], "orientation": [0, 0, 0.5]},
            {"robot": str(urdfs.write(tmp_path / "rail", urdfs.robot(*rail))), "name": "rail"},
        ]
    )  # fmt: skip
    one = load_robot(urdfs.write(tmp_path / "one", urdfs.robot(*rail, *arm, mount)))
    assert whole.joint_names == ("rail/slide", "arm/shoulder", "rail/turn")
    assert [name.rpartition("/")[2] for name in whole.joint_names] == list(one.joint_names)
    assert [label.name for label in whole.u_labels] == ["arm/shoulder", "rail/slide", "rail/turn"]
    rng = np.random.default_rng(2)
    for _ in range(3):
        q, v, a = (rng.standard_normal(3) for _ in range(3))
        np.testing.assert_allclose(whole.mass_matrix(q), one.mass_matrix(q), atol=1e-13)
        torque = pin.rnea(one.model, one.model.createData(), q, v, a)
        symbols = [ca.SX.sym(n, 3) for n in "qva"]
        tau = ca.Function("tau", symbols, [ca.densify(JointMechanics(whole).inverse_dynamics(*symbols))])
        np.testing.assert_allclose(np.asarray(tau(q, v, a)).ravel(), torque, atol=1e-11)
    bodies = {body.name.rpartition("/")[2]: body for body in body_tree(whole).bodies}
    for body in body_tree(one).bodies:
        assert bodies[body.name].parent == body.parent
        np.testing.assert_allclose(bodies[body.name].translation, body.translation, atol=1e-13)


def test_a_spring_to_the_world_stays_with_the_base(tmp_path: Path) -> None:
    """What was the world to a part is the frame of its base."""
    whole, one = two("elastic_pendulum"), load_robot("elastic_pendulum")
    (spring, _), (own,) = whole.forces, one.forces
    assert (spring.name, spring.frames) == (f"left/{own.name}", ("left/bob", "left/universe"))
    place = whole.frame_placement("right/universe", whole.q0)
    np.testing.assert_allclose(place.translation, PLACES[1]["position"])


def test_options_of_a_part_and_of_the_whole() -> None:
    tables = [
        {"robot": "ur5", "name": "a", "lock": {"elbow_joint": 0.5}, "actuated": ["wrist_1_joint"]},
        {"robot": "ur5", "name": "b", "lock": ["elbow_joint"], "payload": [{"frame": "tool0", "mass": 1.0}]},
    ]
    whole = load_parts(
        tables,
        lock={"b/wrist_3_joint": 0.1},
        gravity=(0, 0, -1.62),
        payload=[Payload(frame="a/tool0", mass=2.0, name="a box")],
        name="cell",
    )
    assert whole.name == "cell"
    assert whole.nv == 9
    assert "a/elbow_joint" not in whole.joint_names
    assert [label.name for label in whole.u_labels][:2] == ["a/wrist_1_joint", "b/shoulder_pan_joint"]
    assert whole.model.gravity.linear[2] == -1.62
    assert [(p.name, p.frame) for p in whole.payloads] == [("b/payload_0", "b/tool0"), ("a box", "a/tool0")]
    again = robot_from_spec(whole.spec)
    assert again.fingerprint == whole.fingerprint
    assert again.spec == whole.spec  # else the robot after next would carry b's payload twice
    one = load_robot("ur5", lock={"elbow_joint": 0.5}, payload=[{"frame": "tool0", "mass": 2.0}])
    q = np.concatenate([np.full(5, 0.3), np.zeros(4)])
    np.testing.assert_allclose(whole.mass_matrix(q)[:5, :5], one.mass_matrix(q[:5]), atol=1e-12)


def test_a_part_that_does_not_move(tmp_path: Path) -> None:
    table = urdfs.write(tmp_path, urdfs.robot(urdfs.link("table")))
    whole = load_parts([{"robot": str(table), "name": "table"}, {"robot": "ur5", "name": "arm"}])
    assert whole.joint_names == tuple(f"arm/{name}" for name in load_robot("ur5").joint_names)


@pytest.mark.parametrize(
    ("tables", "error", "words"),
    [
        ([], RobotError, "part: there is none"),
        ([{"name": "a"}], RobotError, r"part\[0\]: robot is missing: name or path; or give mass"),
        ([{"robot": "ur5"}], RobotError, r"part\[0\]\.name: this key is required"),
        ([{"robot": "ur5", "name": "a/b"}], RobotError, "expected a name without '/'"),
        ([{"robot": "ur5", "name": "world"}], RobotError, "which is the frame that stands still"),
        ([{"robot": "ur5", "name": "a"}] * 2, RobotError, "the name 'a' is given twice"),
        ([{"robot": "ur55", "name": "a"}], RobotError, "part 'a': unknown robot 'ur55': did you mean 'ur5'"),
        ([{"robot": "ur5", "name": "a", "posision": [0, 0, 0]}], RobotError, "did you mean 'position'"),
        (
            [{"robot": "ur5", "name": "a", "position": [0, 0]}],
            RobotError,
            r"position: got \[0, 0\], expected 3",
        ),
        (
            [{"robot": "ur5", "name": "a", "orientation": [0, 0, 0, 0]}],
            RobotError,
            "expected a quaternion that is not zero",
        ),
        (
            [{"robot": "ur5", "name": "a", "orientation": [0, 0]}],
            RobotError,
            "expected a quaternion x, y, z, w",
        ),
        (
            [{"robot": "ur5", "name": "a", "lock": {"elbow": 1.0}}],
            UnknownJoint,
            "part 'a': .*no joint 'elbow'",
        ),
        (
            [{"robot": "ur5", "name": "a", "actuated": ["elbow"]}],
            UnknownJoint,
            "part 'a': .*no joint 'elbow'",
        ),
        (
            [{"robot": "ur5", "name": "a"}, {"robot": "ur5", "name": "b", "parent": "a/tool_0"}],
            UnknownFrame,
            "part 'b': parent: .*did you mean 'a/tool0'.*PART/FRAME of 'a'",
        ),
        ([{"robot": "ur5", "name": "a", "parent": "c/tool0"}], UnknownFrame, "part 'a': parent: "),
        (
            [
                {"robot": "ur5", "name": "a", "parent": "b/tool0"},
                {"robot": "ur5", "name": "b", "parent": "a/tool0"},
            ],
            RobotError,
            "part: 'a', 'b' hang on each other in a circle",
        ),
    ],
)
def test_what_is_refused(tables: list[dict[str, Any]], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        load_parts(tables)


def test_files_that_do_not_agree(tmp_path: Path) -> None:
    moon = urdfs.write(tmp_path, urdfs.chain("revolute"), "gravity = [0, 0, -1.62]\n")
    tables = [{"robot": str(moon), "name": "a"}, {"robot": "ur5", "name": "b"}]
    with pytest.raises(
        RobotError, match=r"gravity: the files of the parts do not agree .*give gravity beside"
    ):
        load_parts(tables)
    assert load_parts(tables, gravity=(0, 0, -1.62)).nv == 7


PROBLEM = """[robot]
gravity = [0, 0, -9.81]
[[robot.part]]
name = "left"
robot = "ur5"
position = [0, 0.5, 0]
[[robot.part]]
name = "right"
robot = "ur5"
position = [0, -0.5, 0]
orientation = [0, 0, 0, 2]
[horizon]
duration = 1.0
steps = 10
[start.q]
left = [0.0, -1.5, 0.1, 0.2, 0.3, 0.4]
"right/elbow_joint" = 0.7
[goal]
v = 0
[goal.q]
"left/elbow_joint" = 0.5
right = [0.1, -1.0, 0.1, 0.1, 0.1, 0.1]
"""


def test_problem_files() -> None:
    problem = parse_problem(PROBLEM)
    assert [part.name for part in problem.robot.parts] == ["left", "right"]
    assert problem.robot.parts[1].orientation == (0.0, 0.0, 0.0, 1.0)
    np.testing.assert_array_equal(problem.q_start[:6], [0.0, -1.5, 0.1, 0.2, 0.3, 0.4])
    assert problem.q_start[8] == 0.7
    np.testing.assert_array_equal(
        problem.goal.q_active, [False, False, True, False, False, False] + 6 * [True]
    )
    again = parse_problem(problem_to_toml(problem))
    assert again.robot.fingerprint == problem.robot.fingerprint
    moved = parse_problem(
        PROBLEM,
        ["robot.part.1.position=[0,-1,0]", "robot.part.0.lock=['elbow_joint']", "start.q={}", "goal.q={}"],
    )
    assert moved.robot.parts[1].position == (0.0, -1.0, 0.0)
    assert moved.robot.nv == 11


@pytest.mark.parametrize(
    ("override", "error", "words"),
    [
        ("robot.mimic=true", RobotError, r"robot\.mimic: does not go with robot\.part"),
        ("robot.name='ur5'", RobotError, r"robot\.name: does not go with robot\.part"),
        ("robot.part.0.name=3", ProblemFileError, r"robot\.part\.0\.name: got 3, expected a name without"),
        ("robot.part.0.robots='ur5'", ProblemFileError, r"robot\.part\.0\.robots: unknown key"),
        ("robot={}", ProblemFileError, "robot: name is missing"),
        ("start.q.left=[0]", ProblemFileError, r"start\.q\.left: got shape \(1,\), expected \(6,\)"),
        ("start.q.middle=[0]", UnknownJoint, "no joint 'middle'"),
    ],
)
def test_refused_in_a_problem_file(override: str, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        parse_problem(PROBLEM.replace("v = 0\n", ""), [override])


def test_velocities_of_a_part() -> None:
    moving = parse_problem(PROBLEM, {"start.v": {"left": [1, 2, 3, 4, 5, 6]}})
    np.testing.assert_array_equal(moving.v_start, [1, 2, 3, 4, 5, 6, 0, 0, 0, 0, 0, 0])
    with pytest.raises((DimensionMismatch, ProblemFileError), match=r"start\.v\.left: got shape \(2,\)"):
        parse_problem(PROBLEM, {"start.v": {"left": [1, 2]}})


def test_weights_of_a_part() -> None:
    said = {"left": 2.0, "right": [1, 2, 3, 4, 5, 6], "left/elbow_joint": 7.0}
    weighed = parse_problem(PROBLEM, {"cost.velocity": said})
    np.testing.assert_array_equal(weighed.cost.velocity, [2, 2, 7, 2, 2, 2, 1, 2, 3, 4, 5, 6])


def test_two_pendulums_solve_as_each_alone() -> None:
    one = mbocp.solve(Problem.create("chain_1", 1.0, 40, goal={"q": [1.0], "v": 0}, cost={}, scheme="se1"))
    other = mbocp.solve(Problem.create("chain_1", 1.0, 40, goal={"q": [-0.6], "v": 0}, cost={}, scheme="se1"))
    both = mbocp.solve(
        Problem.create(
            two("chain_1"),
            1.0,
            40,
            goal={"q": {"left": [1.0], "right": [-0.6]}, "v": 0},
            cost={},
            scheme="se1",
        )
    )
    assert one.converged
    assert other.converged
    assert both.converged
    assert both.cost == pytest.approx(one.cost + other.cost, rel=1e-9)
    np.testing.assert_allclose(both.qs, np.hstack([one.qs, other.qs]), atol=1e-8)
    np.testing.assert_allclose(both.us, np.hstack([one.us, other.us]), atol=1e-7)


def test_the_example_solves() -> None:
    problem = mbocp.load_problem(Path(__file__).parents[3] / "examples" / "worlds" / "two_arms.toml")
    problem = problem.with_(integrator={"scheme": "se1"})  # whose steps are one call of RNEA
    solution = mbocp.solve(problem)
    assert solution.converged, solution.advice
    assert np.linalg.norm(problem.robot.difference(problem.goal.q, solution.q_final)) < 1e-9
    model, dt = problem.robot.model, problem.dt
    data = model.createData()
    for n in range(solution.num_steps):
        rate = (solution.vs[n + 1] - solution.vs[n]) / dt
        torque = pin.rnea(model, data, solution.qs[n + 1], solution.vs[n + 1], rate)
        np.testing.assert_allclose(solution.us[n], torque, atol=1e-7)


@pytest.mark.parametrize("letter", [letter for letter in LIMITS if letter != "q"])
def test_limits_of_all_kinds_go_by_part_and_pattern(letter: str) -> None:
    """One by itself counts before its part, a part before patterns, in whatever order they are written."""
    whole, key = two("ur5"), LIMITS[letter].removeprefix("limits.")
    each = list(range(1, 7))
    written = {"left/elbow_joint": 9.0, "left": 8.0, "*wrist*": 7.0, "right": each}
    for order in (list(written.items()), list(written.items())[::-1]):
        _, upper = bounds_from(whole, **{key: dict(order)}).sides(letter)
        np.testing.assert_array_equal(upper, [8, 8, 9, 8, 8, 8, *each])
    _, upper = bounds_from(whole, **{key: {"*/wrist_?_joint": 7.0}}).sides(letter)
    np.testing.assert_array_equal(upper, 2 * [np.inf, np.inf, np.inf, 7, 7, 7])
    with pytest.raises(DimensionMismatch, match=rf"limits.{key}.left: got shape \(3,\), expected \(6,\)"):
        bounds_from(whole, **{key: {"left": [1.0, 2.0, 3.0]}})
    with pytest.raises(MbocpError, match="right"):
        bounds_from(whole, **{key: {"rihgt": 1.0}})


def test_positions_and_weights_go_by_part_and_pattern() -> None:
    boxes = [{"name": "load", "mass": 1.0, "box": [0.1, 0.1, 0.1]}, {"robot": "ur5", "name": "arm"}]
    whole = load_parts(boxes)
    floats = whole.configuration_indices("load/root_joint")
    for name in ("load", "lo*"):  # of a free-flyer its place alone
        lower, _ = bounds_from(whole, position={name: [-2.0, 1.0]}).sides("q")
        np.testing.assert_array_equal(np.flatnonzero(np.isfinite(lower)), np.arange(whole.nq)[floats][:3])
    ranges = [[-1.0, k + 1.0] for k in range(6)]
    _, upper = bounds_from(whole, position={"arm": ranges}).sides("q")
    np.testing.assert_array_equal(upper[np.isfinite(upper)], [1, 2, 3, 4, 5, 6])
    weights = control_from(whole, {"arm/elbow_joint": 5.0, "arm": 2.0, "*wrist*": 1.0}, "cost.effort")
    np.testing.assert_array_equal(weights, [2, 2, 5, 2, 2, 2])


def test_plots_draw_no_line_between_them() -> None:
    whole = two("ur5")
    poses = frame_paths(whole, np.array([whole.q0, whole.q0])).poses
    for lines in poses:
        assert len(lines) == 12
        assert np.linalg.norm(lines[:, 0] - lines[:, 1], axis=1).max() < 0.5  # they stand 1.2 m apart


def test_replays_draw_all_of_them(tmp_path: Path) -> None:
    """The arm by its meshes, and sticks for the chain without pictures beside it."""
    bare = urdfs.write(tmp_path, urdfs.chain("revolute", "revolute"))
    whole = load_parts([{"robot": "ur5", "name": "arm"}, {"robot": str(bare), "name": "bare", **PLACES[0]}])
    qs = np.array([whole.q0, whole.integrate(whole.q0, np.full(whole.nv, 0.4))])
    page = read_page(write_replay(whole, [0.0, 1.0], qs, tmp_path / "replay.html"))
    drawn = page.objects("/replay/world/robot")
    assert sum("arm|" in name for name in drawn) == 7
    sticks = [name for name in drawn if "stick" in name]
    assert sticks
    assert all("/bare|j" in name for name in sticks)
