"""Parts of a world that constraints join: dynamics, closure, what holds the load, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.exceptions import (
    DimensionMismatch,
    LoopNotClosed,
    ProblemFileError,
    RobotError,
    RobotFileError,
    UnknownFrame,
    UnknownJoint,
    UnreachablePose,
    UnsupportedRobot,
)
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.mechanics.natural_coordinates.space import NaturalSpace, natural_mechanics
from mbocp.mechanics.symmetries import find_symmetries
from mbocp.problem.file.load import load_problem, parse_problem
from mbocp.problem.file.tables import problem_to_toml
from mbocp.robot import Robot, describe, load_parts, robot_from_spec

EXAMPLE = Path(__file__).parents[3] / "examples" / "worlds" / "two_arms_one_load.toml"
BOX = {"name": "box", "box": [0.2, 0.1, 0.05], "mass": 1.5}
CHAINS: list[dict[str, Any]] = [
    {"name": "left", "robot": "chain_3", "position": [-0.3, 0.0, 1.0]},
    {"name": "right", "robot": "chain_3", "position": [0.3, 0.0, 1.0]},
    BOX,
]
GRIPS: list[dict[str, Any]] = [
    {
        "name": "grip_left",
        "type": "hinge",
        "frames": ["left/tip", "box/body"],
        "axis": [0, 1, 0],
        "position_b": [-0.1, 0, 0],
    },
    {
        "name": "grip_right",
        "type": "hinge",
        "frames": ["right/tip", "box/body"],
        "axis": [0, 1, 0],
        "position_b": [0.1, 0, 0],
    },
]
BENT = {"q": {"left": [0.4, -0.5, -0.2], "box": [0.0, 0.0, 0.45, 0, 0, 0, 1]}}


def joined(**options: Any) -> Robot:
    """Two planar chains that hold a box by two pins."""
    return load_parts(CHAINS, **{"constraint": GRIPS, "initial": {"q": {"box": BENT["q"]["box"]}}, **options})


def two_arms() -> Robot:
    """The world of the example."""
    return load_problem(EXAMPLE).robot


def at_random(robot: Robot, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A closed configuration, a velocity along the constraints, and controls."""
    rng = np.random.default_rng(seed)
    q = robot.assemble(robot.integrate(robot.q0, 0.1 * rng.standard_normal(robot.nv)))
    v = robot.assemble_velocity(q, rng.standard_normal(robot.nv))
    return q, v, 5.0 * rng.standard_normal(robot.nu)


def of_pinocchio(robot: Robot, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Accelerations by Pinocchio's own constrained dynamics, welds and points."""
    model, data = robot.model, robot.model.createData()
    contacts, memory = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for constraint in robot.constraints:
        a, b = (model.frames[f] for f in (constraint.frame_a, constraint.frame_b))
        kind = {"weld": pin.ContactType.CONTACT_6D, "point": pin.ContactType.CONTACT_3D}[constraint.kind]
        contacts.append(
            pin.RigidConstraintModel(kind, model, a.parentJoint, a.placement, b.parentJoint, b.placement)
        )
        memory.append(contacts[-1].createData())
    pin.initConstraintDynamics(model, data, contacts, memory)
    settings = pin.ProximalSettings(1e-13, 1e-9, 200)
    tau = robot.actuation_matrix(q) @ u
    return np.array(pin.constraintDynamics(model, data, q, v, tau, contacts, memory, settings))


def symbolic(robot: Robot) -> ca.Function:
    """(q, v, u) to accelerations and multipliers."""
    mechanics = ForwardMechanics(robot)
    q, v, u = ca.SX.sym("q", robot.nq), ca.SX.sym("v", robot.nv), ca.SX.sym("u", robot.nu)
    zero = ca.SX(0)
    return ca.Function(
        "forward",
        [q, v, u],
        [mechanics.speed_rate(q, v, u, zero), ca.densify(mechanics.multipliers(q, v, u, zero))],
    )


# Mechanics


@pytest.mark.parametrize("kind", ["weld", "point"])
def test_accelerations_are_those_of_pinocchio(kind: str) -> None:
    """Two arms and a box, by another library's constrained dynamics."""
    spec = dict(two_arms().spec)
    spec["constraint"] = [{**row, "type": kind} for row in spec["constraint"]]
    robot = robot_from_spec(spec)
    assert robot.nc == (12 if kind == "weld" else 6)
    forward = symbolic(robot)
    for seed in range(3):
        q, v, u = at_random(robot, seed)
        expected = of_pinocchio(robot, q, v, u)
        got = forward(q, v, u)[0].full().ravel()
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9 * max(1.0, np.abs(expected).max()))


def test_multipliers_are_the_forces_on_the_load() -> None:
    """Newton and Euler for the box alone: weight, and what the grips exert on it."""
    robot = two_arms()
    forward = symbolic(robot)
    q, v, u = at_random(robot, 5)
    a, lam = (value.full().ravel() for value in forward(q, v, u))
    model, data = robot.model, robot.model.createData()
    joint = model.getJointId("load/root_joint")
    pin.forwardKinematics(model, data, q, v, a)
    pin.updateFramePlacements(model, data)
    inertia = model.inertias[joint]
    centre = data.oMi[joint].act(inertia.lever)
    force, moment = inertia.mass * np.array([0.0, 0.0, -9.81]), np.zeros(3)
    for constraint, row in zip(robot.constraints, (0, 6), strict=True):
        grip = data.oMf[constraint.frame_b]
        exerted = grip.rotation @ lam[row : row + 3]
        force += exerted
        moment += np.cross(grip.translation - centre, exerted) + grip.rotation @ lam[row + 3 : row + 6]
    rotation = data.oMi[joint].rotation
    acceleration = rotation @ pin.getClassicalAcceleration(model, data, joint, pin.LOCAL).linear
    turning = data.v[joint].angular
    euler = inertia.inertia @ data.a[joint].angular + np.cross(turning, inertia.inertia @ turning)
    np.testing.assert_allclose(force, inertia.mass * acceleration, atol=1e-9)
    np.testing.assert_allclose(moment, rotation @ euler, atol=1e-9)


def test_derivatives_of_the_constraints_are_those_of_differences() -> None:
    robot = two_arms()
    q, h = at_random(robot, 7)[0], 1e-6
    exact = robot.closure_jacobian(q)
    for i, direction in enumerate(np.eye(robot.nv)):
        ahead, back = (robot.closure_residual(robot.integrate(q, s * h * direction)) for s in (1, -1))
        np.testing.assert_allclose((ahead - back) / (2 * h), exact[:, i], atol=1e-8)


def test_natural_coordinates_have_the_same_constraints() -> None:
    """Bodies by position and directors fulfil the grips where the joints do, and nowhere else."""
    robot = joined()
    mechanics = natural_mechanics(robot)
    space = NaturalSpace(mechanics, robot.q0)
    away = robot.integrate(robot.q0, 1e-3 * np.ones(robot.nv))
    zs = space.coordinates(np.array([robot.q0, away]))
    q = ca.SX.sym("q", zs.shape[1])
    rows = ca.Function("rows", [q], [mechanics.constraints(q)])
    np.testing.assert_allclose(rows(zs[0]).full(), 0.0, atol=1e-12)
    violated = np.abs(rows(zs[1]).full()).max()
    np.testing.assert_allclose(violated, np.abs(robot.constraint_residual(away)).max(), rtol=1e-9)


def test_redundant_rows_of_planar_arms_are_left_out() -> None:
    robot = joined()
    assert len(robot.closure_labels) == 10
    assert robot.nc == 7  # the box in the plane: 3; each pin in it: 2
    assert robot.nv - robot.nc == 5
    assert np.linalg.matrix_rank(robot.closure_jacobian(robot.q0), tol=1e-8) == 7


def test_joined_bodies_keep_the_momenta_of_their_common_motion() -> None:
    """Two boxes with a hinge, without weight: six momenta in all, and not six each."""
    boxes = [BOX, {**BOX, "name": "lid", "position": [0.2, 0.0, 0.0]}]
    hinge = {
        "type": "hinge",
        "frames": ["lid/body", "box/body"],
        "axis": [0, 1, 0],
        "position": [-0.1, 0, 0],
        "position_b": [0.1, 0, 0],
    }
    alone = load_parts(boxes, gravity=(0, 0, 0))
    both = load_parts(boxes, gravity=(0, 0, 0), constraint=[hinge])
    assert len(find_symmetries(alone)) == 12
    assert len(find_symmetries(both)) == 6
    assert both.nv - both.nc == 7


# Building


def test_a_joint_stands_where_it_is_placed() -> None:
    robot = joined()
    for end, name in (("left", "grip_left"), ("right", "grip_right")):
        where = robot.frame_placement(f"{name}.b").translation
        np.testing.assert_allclose(where, robot.frame_placement(f"{end}/tip").translation, atol=1e-12)
    assert np.abs(robot.closure_residual(robot.q0)).max() < 1e-12
    np.testing.assert_array_equal(robot.q0[robot.configuration_indices("box/root_joint")], BENT["q"]["box"])


def test_orientations_of_a_joint_are_angles_or_a_quaternion() -> None:
    half = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]
    frames = []
    for orientation in ([np.pi / 2, 0.0, 0.0], half, [3 * x for x in half]):
        weld = {
            "type": "weld",
            "name": "w",
            "frames": ["left/tip", "box/body"],
            "orientation_b": orientation,
        }
        robot = load_parts(CHAINS, constraint=[weld])
        frames.append(robot.model.frames[robot.frame_id("w.b")].placement.homogeneous)
    np.testing.assert_allclose(frames[1], frames[0], atol=1e-15)
    np.testing.assert_allclose(frames[2], frames[0], atol=1e-15)


def test_an_object_is_a_solid_of_its_shape() -> None:
    """Inertia of box, ball and cylinder, filled evenly; or the one that is given."""
    a, b, c = BOX["box"]
    expected = {
        "box": 1.5 / 12 * np.array([b * b + c * c, a * a + c * c, a * a + b * b]),
        "sphere": 0.4 * 1.5 * 0.3**2 * np.ones(3),
        "cylinder": 1.5 * np.array([(3 * 0.01 + 0.16) / 12, (3 * 0.01 + 0.16) / 12, 0.01 / 2]),
    }
    for key, size in (("box", BOX["box"]), ("sphere", 0.3), ("cylinder", [0.1, 0.4])):
        robot = load_parts([{"name": "thing", "mass": 1.5, key: size}])
        assert (robot.nq, robot.nv, robot.nu) == (7, 6, 0)
        np.testing.assert_allclose(np.diag(robot.model.inertias[1].inertia), expected[key], rtol=1e-12)
    given = load_parts([{**BOX, "inertia": [0.01, 0.02, 0.025], "com": [0.0, 0.0, 0.1]}])
    np.testing.assert_allclose(np.diag(given.model.inertias[1].inertia), [0.01, 0.02, 0.025])
    np.testing.assert_allclose(given.model.inertias[1].lever, [0.0, 0.0, 0.1])


def test_an_object_may_stand_still() -> None:
    table = {"name": "table", "box": [1.0, 1.0, 0.02], "free_flyer": False, "position": [0, 0, 0.5]}
    robot = load_parts([table, {"name": "arm", "robot": "ur5", "parent": "table/body"}])
    assert robot.nv == 6
    np.testing.assert_allclose(robot.frame_placement("arm/base_link").translation, [0, 0, 0.5])
    assert any(shape.name.startswith("table/") for shape in robot.visual_model.geometryObjects)


def test_robots_far_from_the_load_find_it() -> None:
    """From arms straight out, where no step of Newton's leads to the box, a search does."""
    parts, rows = two_arms().spec["part"], two_arms().spec["constraint"]
    load = [0.4, -0.1, 0.2, 0.0, 0.0, 0.0, 1.0]
    robot = load_parts(parts, constraint=rows, initial={"q": {"load": load}})
    assert np.abs(robot.closure_residual(robot.q0)).max() < 1e-12
    np.testing.assert_array_equal(robot.q0[robot.configuration_indices("load/root_joint")], load)


def test_a_world_is_written_and_read_again(tmp_path: Path) -> None:
    problem = load_problem(EXAMPLE)
    again = parse_problem(problem_to_toml(problem))
    assert again.robot.fingerprint == problem.robot.fingerprint
    np.testing.assert_array_equal(again.q_start, problem.q_start)
    assert robot_from_spec(problem.robot.spec).fingerprint == problem.robot.fingerprint
    facts = describe(problem.robot)
    assert facts["mobility"] == 6
    assert [row["frames"] for row in facts["constraints"]] == [
        ["left/tool0", "grip_left.b"],
        ["right/tool0", "grip_right.b"],
    ]


# Refusals of joints and objects


@pytest.mark.parametrize(
    ("constraint", "error", "words"),
    [
        ({"type": "glue"}, RobotError, r"constraint\[0\].*unknown type 'glue', known: rod, point"),
        ({"frames": ["left/tip"]}, RobotError, r"constraint\[0\]\.frames"),
        ({"frames": ["left/tip", "left/tip"]}, RobotError, "two different frames"),
        ({"frames": ["left/tpi", "box/body"]}, UnknownFrame, "did you mean 'left/tip'"),
        ({"frames": ["tip", "box/body"]}, UnknownFrame, "no frame 'tip'"),
        ({"frames": ["box/body", "box/root_joint"]}, RobotFileError, "on the same rigid body"),
        ({"placement": [0, 0, 0]}, RobotError, r"constraint\[0\]\.placement: unknown key"),
        ({"position": [0, 0]}, RobotError, r"constraint\[0\]\.position.*3 numbers \[m\]"),
        ({"orientation_b": [0, 0, 0, 0]}, RobotError, r"orientation_b.*quaternion that is not zero"),
        ({"name": "left/tip", "position": [0, 0, 0]}, None, ""),
        ({"position": [0.0, 0.0, float("nan")]}, RobotError, r"constraint\[0\]\.position"),
    ],
)
def test_joints_that_are_refused(
    constraint: dict[str, Any], error: type[Exception] | None, words: str
) -> None:
    row = {"type": "point", "frames": ["left/tip", "box/body"], **constraint}
    if error is None:
        assert "left/tip.a" in load_parts(CHAINS, constraint=[row]).frame_names
        return
    with pytest.raises(error, match=words):
        load_parts(CHAINS, constraint=[row])


def test_a_frame_of_a_joint_needs_a_name_of_its_own() -> None:
    row = {"type": "point", "name": "g", "frames": ["left/tip", "box/body"], "position": [0, 0, 0]}
    with pytest.raises(RobotFileError, match=r"constraint\[1\]\.name: a frame is called 'g\.a' already"):
        load_parts(CHAINS, constraint=[row, {**row, "frames": ["right/tip", "box/body"]}])


def test_joints_that_say_the_same_or_cannot_close() -> None:
    with pytest.raises(UnsupportedRobot, match="constraint 'twin' is a duplicate: 'grip_left' implies it"):
        joined(constraint=[*GRIPS, {**GRIPS[0], "name": "twin"}])
    far = [CHAINS[0], {**CHAINS[1], "position": [9.0, 0.0, 1.0]}, BOX]
    with pytest.raises(LoopNotClosed, match="violates 'grip_"):
        load_parts(far, constraint=GRIPS)


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ({"name": "x"}, r"part\[0\]: robot is missing: .*mass and box, sphere, cylinder"),
        ({"name": "x", "robot": "ur5", "mass": 1.0}, "mass: does not go with robot"),
        ({"name": "x", "box": [1, 1, 1]}, "mass: a body that floats needs one above 0"),
        ({"name": "x", "mass": 1.0}, "inertia: a body that floats needs one"),
        ({"name": "x", "mass": -1.0, "sphere": 0.1}, "mass: got -1"),
        ({"name": "x", "mass": 1.0, "sphere": 0.1, "box": [1, 1, 1]}, "shape"),
        ({"name": "x", "mass": 1.0, "sphere": 0.1, "inertia": [1, 1, 5]}, "inertia"),
        ({"name": "x", "mass": 1.0, "sphere": 0.1, "lock": ["root_joint"]}, "lock: is a matter of robots"),
        ({"name": "x", "mass": "heavy", "sphere": 0.1}, r"part\[0\]\.mass"),
    ],
)
def test_objects_that_are_refused(part: dict[str, Any], words: str) -> None:
    with pytest.raises(RobotError, match=words):
        load_parts([part])


def test_lists_for_parts_that_do_not_fit() -> None:
    words = r"initial\.q\.left.*those that are locked: left/joint_1, left/joint_2"
    with pytest.raises(DimensionMismatch, match=words):
        joined(initial={"q": {"left": [0.1, 0.2]}})
    with pytest.raises(UnknownJoint, match="no joint 'lefd'"):
        joined(initial={"q": {"lefd": [0.1, 0.2, 0.3]}})


# Start at a pose

WORLD = """
horizon = {{ duration = 1.0, steps = 10 }}
goal = {{ v = 0 }}

[robot.initial.q]
box = [0, 0, 0.45, 0, 0, 0, 1]

{parts}
[start.frame]
{pose}
"""


def started(pose: str, extra: str = "") -> Any:
    rows = "".join(
        f"[[robot.{kind}]]\n" + "".join(f"{key} = {value!r}\n" for key, value in table.items())
        for kind, tables in (("part", CHAINS), ("constraint", GRIPS))
        for table in tables
    )
    return parse_problem(WORLD.format(parts=rows, pose=pose) + extra)


def test_a_start_is_found_from_the_pose_of_the_load() -> None:
    problem = started('name = "box/body"\nposition = [0.05, 0.0, 0.5]\nrpy = [0.0, 0.1, 0.0]')
    robot, q = problem.robot, problem.q_start
    assert np.abs(robot.closure_residual(q)).max() < 1e-12
    placement = robot.frame_placement("box/body", q)
    np.testing.assert_allclose(placement.translation, [0.05, 0.0, 0.5], atol=1e-10)
    np.testing.assert_allclose(pin.rpy.matrixToRpy(placement.rotation), [0.0, 0.1, 0.0], atol=1e-10)
    again = parse_problem(problem_to_toml(problem))
    np.testing.assert_array_equal(again.q_start, q)


def test_joints_that_the_start_names_stay() -> None:
    problem = started('name = "box/body"\nz = 0.5', "[start.q]\n'left/joint_1' = 0.3\n")
    robot, q = problem.robot, problem.q_start
    assert q[robot.configuration_indices("left/joint_1")] == 0.3
    np.testing.assert_allclose(robot.frame_placement("box/body", q).translation[2], 0.5, atol=1e-10)
    assert np.abs(robot.closure_residual(q)).max() < 1e-10


@pytest.mark.parametrize(
    ("pose", "extra", "error", "words"),
    [
        ('name = "box/body"\nz = 3.0', "", UnreachablePose, r"start\.frame: out of reach.*move the start"),
        ('name = "box/bdy"\nz = 0.5', "", UnknownFrame, "did you mean 'box/body'"),
        ('name = "box/body"\nz = 0.5\nvelocity = 0', "", ProblemFileError, r"start\.frame.*velocity"),
        ('name = "box/body"', "", ProblemFileError, r"start\.frame"),
        (
            'name = "box/body"\nz = 0.5',
            "[start.q]\nleft = [0, 0, 0]\nright = [0, 0, 0]\nbox = [0, 0, 0, 0, 0, 0, 1]\n",
            ProblemFileError,
            r"start\.frame: start\.q gives every joint",
        ),
    ],
)
def test_starts_that_are_refused(pose: str, extra: str, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        started(pose, extra)


def test_a_single_arm_may_start_at_a_pose() -> None:
    problem = parse_problem(
        'robot = "ur5"\nhorizon = {duration = 1.0, steps = 5}\n'
        'start.frame = {name = "tool0", position = [0.4, 0.2, 0.5], '
        "axis = [0, 0, 1], direction = [0, 0, -1]}\n"
        "goal.v = 0\n"
    )
    placement = problem.robot.frame_placement("tool0", problem.q_start)
    np.testing.assert_allclose(placement.translation, [0.4, 0.2, 0.5], atol=1e-10)
    np.testing.assert_allclose(placement.rotation[:, 2], [0.0, 0.0, -1.0], atol=1e-10)


# The example


def test_two_arms_carry_one_load() -> None:
    """Closed to 1e-12 at every node, at its goal, with the grips' forces by name; IPOPT ends there, too."""
    problem = load_problem(EXAMPLE)
    solution = mbocp.solve(problem)
    assert solution.converged
    robot = problem.robot
    assert max(np.abs(robot.closure_residual(q)).max() for q in solution.qs) < 1e-12
    end = robot.frame_placement("load/body", solution.qs[-1])
    np.testing.assert_allclose(end.translation, [0.4, 0.1, 0.5], atol=1e-10)
    assert [column.name for column in solution.labels.lam][::6] == ["grip_left.x", "grip_right.x"]
    other = mbocp.solve(problem.with_(solver={"method": "ipopt"}))
    assert other.converged
    np.testing.assert_allclose(other.cost, solution.cost, rtol=1e-9)
    np.testing.assert_allclose(other.lams, solution.lams, atol=1e-4)
