"""Elastic joints, against Spong's equations written by hand and integrated by SciPy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import mbocp
from mbocp.exceptions import MbocpError, ProblemError, RobotError
from mbocp.mechanics import JointMechanics
from mbocp.mechanics.symmetries import find_symmetries
from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.robot import Robot, describe, load_parts, load_robot
from mbocp.robot.loading.model_changes import with_motors
from mbocp.robot.loading.robot_tables import ElasticTable
from tests.robot.urdfs import link, robot

G = 9.81
L1, C1, M1, I1 = 0.5, 0.2, 3.0, 0.08  # length [m], to the centre of mass [m], mass [kg], about it [kg m^2]
C2, M2, I2 = 0.25, 2.0, 0.05
K, D, B = np.array([80.0, 50.0]), np.array([0.6, 0.4]), np.array([0.3, 0.1])


def body(name: str, mass: float, centre: float, inertia: float) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="0 0 {-centre}"/><mass value="{mass}"/><inertia '
        f'ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"/></inertial></link>'
    )


def hinge(
    name: str, parent: str, child: str, down: float, kind: str = "revolute", axis: str = "0 1 0"
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="0 0 {-down}"/><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="{axis}"/>'
        '<limit lower="-3" upper="3" effort="60" velocity="9"/></joint>'
    )


ONE = robot(link("base", None), body("upper", M1, C1, I1), hinge("shoulder", "base", "upper", 0.0))
TWO = robot(
    *(link("base", None), body("upper", M1, C1, I1), body("fore", M2, C2, I2)),
    *(hinge("shoulder", "base", "upper", 0.0), hinge("elbow", "upper", "fore", L1)),
)
NAMES = ("shoulder", "elbow")


def elastic(count: int, stiffness: np.ndarray = K, damping: np.ndarray = D) -> list[dict[str, Any]]:
    rows = zip(NAMES[:count], stiffness, damping, B, strict=False)
    keys = ("joint", "stiffness", "damping", "motor_inertia")
    return [dict(zip(keys, (name, float(k), float(d), float(b)), strict=True)) for name, k, d, b in rows]


@pytest.fixture
def files(tmp_path: Path) -> dict[int, Path]:
    found = {1: tmp_path / "one.urdf", 2: tmp_path / "two.urdf"}
    found[1].write_text(ONE)
    found[2].write_text(TWO)
    return found


def rigid(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mass matrix, and torques of motion and weight, of the arm of one or two links."""
    if len(q) == 1:
        return np.array([[I1 + M1 * C1**2]]), np.array([M1 * G * C1 * np.sin(q[0])])
    cosine, sine = np.cos(q[1]), np.sin(q[1])
    m22 = I2 + M2 * C2**2
    m12 = m22 + M2 * L1 * C2 * cosine
    m11 = I1 + M1 * C1**2 + m22 + M2 * (L1**2 + 2 * L1 * C2 * cosine)
    pull = M2 * L1 * C2 * sine
    fore = M2 * G * C2 * np.sin(q[0] + q[1])
    weight = np.array([(M1 * C1 + M2 * L1) * G * np.sin(q[0]) + fore, fore])
    coriolis = pull * np.array([-2 * v[0] * v[1] - v[1] ** 2, v[0] ** 2])
    return np.array([[m11, m12], [m12, m22]]), coriolis + weight


def spong(state: np.ndarray, u: np.ndarray, stiffness: np.ndarray = K, damping: np.ndarray = D) -> np.ndarray:
    """Rates of (q, theta, q', theta')."""
    n = len(state) // 4
    q, theta, v, w = state.reshape(4, n)
    mass, rest = rigid(q, v)
    effort = stiffness[:n] * (theta - q) + damping[:n] * (w - v)
    return np.concatenate([v, w, np.linalg.solve(mass, effort - rest), (u - effort) / B[:n]])


def accelerations(arm: Robot, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    tau = arm.actuation_matrix(q) @ u + arm.force_elements(q, v)
    return np.array(pin.aba(arm.model, arm.model.createData(), q, v, tau))


@pytest.mark.parametrize("count", [1, 2])
def test_equations_are_spongs(files: dict[int, Path], count: int) -> None:
    """Of numbers, and of symbols."""
    arm = load_robot(files[count], elastic=elastic(count))
    mechanics, rng = JointMechanics(arm), np.random.default_rng(count)
    q, v, u = ca.SX.sym("q", arm.nq), ca.SX.sym("v", arm.nv), ca.SX.sym("u", arm.nu)
    rates = ca.Function("a", [q, v, u], [mechanics.forward_dynamics(q, v, mechanics.force(q, v, u))])
    assert [label.name for label in arm.u_labels] == [f"{name}_motor" for name in NAMES[:count]]
    for _ in range(5):
        state, torque = rng.normal(size=4 * count), rng.normal(size=count) * 10
        expected = spong(state, torque)[2 * count :]
        at, moving = state[: 2 * count], state[2 * count :]
        np.testing.assert_allclose(accelerations(arm, at, moving, torque), expected, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(
            np.array(rates(at, moving, torque)).ravel(), expected, rtol=1e-9, atol=1e-9
        )
        energy = ca.Function("V", [q], [mechanics.potential_energy(q)])
        springs = float(K[:count] @ (at[count:] - at[:count]) ** 2) / 2
        still = np.concatenate([at[:count], at[:count]])
        assert float(energy(at)) - float(energy(still)) == pytest.approx(springs)
        assert arm.potential_energy(at) == pytest.approx(float(energy(at)))


def test_they_stand_beside_ball_joints_with_rotation_matrices(tmp_path: Path) -> None:
    """There the numbers of a state are others than those of q."""
    file = tmp_path / "robot.urdf"
    file.write_text(TWO.replace('name="shoulder" type="revolute"', 'name="ball" type="floating"'))
    (tmp_path / "robot.toml").write_text('spherical = ["ball"]\nrotations = "dcm"\n')
    arm = load_robot(tmp_path / "robot.toml", elastic=[{**elastic(1)[0], "joint": "elbow"}])
    q = arm.integrate(arm.q0, np.array([0.3, -0.2, 0.5, 0.7, 1.1]))
    v, u = np.linspace(-1.0, 1.0, 5), np.array([2.0])
    mechanics = JointMechanics(arm, "dcm")
    z = ca.SX.sym("z", mechanics.nq)
    found = ca.Function("f", [z], [mechanics.force(z, ca.SX(v), ca.SX(u)), mechanics.potential_energy(z)])
    force, energy = found(mechanics.space.coordinates(np.array(q)[None])[0])
    expected = arm.actuation_matrix(q) @ u + arm.force_elements(q, v)
    np.testing.assert_allclose(np.array(force).ravel(), expected, atol=1e-12)
    assert float(energy) == pytest.approx(arm.potential_energy(q))


def test_a_slider_has_a_motor_that_slides_and_no_rotor_besides(tmp_path: Path) -> None:
    file = tmp_path / "slider.urdf"
    file.write_text(
        robot(link("base", None), body("cart", M1, C1, I1), hinge("rail", "base", "cart", 0, "prismatic"))
    )
    row = ElasticTable.model_validate({"joint": "rail", "stiffness": 90.0, "motor_inertia": 0.5})
    model = pin.Model(load_robot(file).model)
    model.armature[0] = 7.0  # as files with rotors have it
    made, q, (joint,) = with_motors(model, np.array([0.2]), [row], (), "slider")
    assert (made.armature.tolist(), q.tolist()) == ([0.0, 0.5], [0.2, 0.2])
    assert joint.effort([0.2, 0.3], [0.0, 0.0]) == pytest.approx(9.0)
    cart = load_robot(file, elastic=[row])
    found = accelerations(cart, np.array([0.2, 0.3]), np.zeros(2), np.array([1.0]))
    np.testing.assert_allclose(found, [9.0 / M1, (1.0 - 9.0) / 0.5])
    assert cart.u_labels[0].unit == "N"


def motion(rate: Callable[[np.ndarray], np.ndarray], start: np.ndarray, duration: float) -> np.ndarray:
    found = solve_ivp(lambda _, y: rate(y), (0, duration), start, "DOP853", rtol=1e-11, atol=1e-12)
    return np.array(found.y)


def test_energy_is_conserved_without_dampers(files: dict[int, Path]) -> None:
    arm = load_robot(files[2], elastic=elastic(2, damping=np.zeros(2)))

    def rate(y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[4:], accelerations(arm, y[:4], y[4:], np.zeros(2))])

    def energy(y: np.ndarray) -> float:
        return float(y[4:] @ arm.mass_matrix(y[:4]) @ y[4:]) / 2 + arm.potential_energy(y[:4])

    states = motion(rate, np.array([1.0, 0.5, 1.4, 0.2, 0, 0, 0, 0]), 2.0)
    energies = np.array([energy(y) for y in states.T])
    assert np.ptp(states[0] - states[2]) > 0.1  # the springs work
    np.testing.assert_allclose(energies, energies[0], atol=1e-8)


def test_stiffer_joints_come_near_rigid_ones(files: dict[int, Path]) -> None:
    """With order one in 1/K, from rest and under a constant torque; the rotors are a part of the mass."""
    torque, start, errors = np.array([8.0, -2.0]), np.array([0.6, -0.4]), []

    def stiff(y: np.ndarray) -> np.ndarray:
        mass, rest = rigid(y[:2], y[2:])
        return np.concatenate([y[2:], np.linalg.solve(mass + np.diag(B), torque - rest)])

    expected = motion(stiff, np.concatenate([start, np.zeros(2)]), 0.6)[:2, -1]
    for stiffness in (1e3, 1e4, 1e5):
        rows = elastic(2, np.full(2, stiffness), np.full(2, stiffness / 50))
        arm = load_robot(files[2], elastic=rows)
        at = np.concatenate([arm.balanced(np.concatenate([start, start])), np.zeros(4)])
        y = at

        def rate(_: float, y: np.ndarray, arm: Robot = arm) -> np.ndarray:
            return np.concatenate([y[4:], accelerations(arm, y[:4], y[4:], torque)])

        y = solve_ivp(rate, (0, 0.6), at, "Radau", rtol=1e-9, atol=1e-11).y[:, -1]
        errors.append(np.abs(y[:2] - expected).max())
    np.testing.assert_allclose(np.log10(np.array(errors[:-1]) / errors[1:]), 1.0, atol=0.1)


def task(file: Path, **keys: Any) -> Problem:
    keys = {"goal": {"q": [0.8, -0.5], "v": 0}, "start": {"q": [0.3, 0.4]}, "cost": {"effort": 1e-2}} | keys
    return Problem.create(load_robot(file, elastic=elastic(2)), 1.0, 60, **keys)


def test_motors_of_ends_at_rest_are_where_springs_hold_the_weight(files: dict[int, Path]) -> None:
    problem = task(files[2], scheme="gauss2")
    for q in (problem.q_start, problem.goal.q):
        weight = rigid(q[:2], np.zeros(2))[1]
        np.testing.assert_allclose(K * (q[2:] - q[:2]), weight, atol=1e-10)
    assert problem.goal.q_active.all()
    by_name = task(files[2], start={"q": {"shoulder": 0.3, "elbow": 0.4}})
    np.testing.assert_array_equal(by_name.q_start, problem.q_start)
    given = task(files[2], start={"q": {"shoulder": 0.3, "elbow_motor": 0.1}})
    assert given.q_start[3] == 0.1
    assert K[0] * (given.q_start[2] - 0.3) == pytest.approx(rigid(np.array([0.3, 0.0]), np.zeros(2))[1][0])
    moving = task(files[2], goal={"q": [0.8, -0.5]})
    assert moving.goal.q_active.tolist() == [True, True, False, False]
    again = parse_problem(problem_to_toml(problem))
    assert again.robot.fingerprint == problem.robot.fingerprint
    np.testing.assert_array_equal(again.q_start, problem.q_start)
    np.testing.assert_array_equal(again.goal.q, problem.goal.q)


def test_poses_of_frames_have_balanced_motors(files: dict[int, Path]) -> None:
    pose = {"name": "elbow", "position": [-0.3, 0.0, -0.4]}
    problem = task(files[2], start={"frame": pose}, goal={"frame": pose, "v": 0, "a": 0})
    for q in (problem.q_start, problem.goal.q):
        np.testing.assert_allclose(problem.robot.frame_placement("elbow", q).translation[0], -0.3, atol=1e-6)
        np.testing.assert_allclose(K * (q[2:] - q[:2]), rigid(q[:2], np.zeros(2))[1], atol=1e-9)
    aside = load_robot(files[1], elastic=elastic(1), gravity=[2.0, 0.0, -9.0])  # pulls at the arm at zero
    laden = aside.with_payload(mbocp.robot.Payload(frame="upper", mass=1.5, com=(0.0, 0.0, -C1)))
    assert abs(aside.q0[1]) > 1e-3
    assert laden.q0.tolist() == pytest.approx([0.0, 1.5 * aside.q0[1]])


def test_a_plan_to_a_pose_ends_where_nothing_swings(files: dict[int, Path]) -> None:
    """A goal of a frame gives no joint; `a = 0` has the motors hold the weight."""
    goal = {"frame": {"name": "elbow", "position": [-0.3, 0.0, -0.4]}, "v": 0, "a": 0}
    s = mbocp.solve(task(files[2], goal=goal, scheme="gauss2"), check=True)
    q = s.qs[-1]
    np.testing.assert_allclose(K * (q[2:] - q[:2]), rigid(q[:2], np.zeros(2))[1], atol=1e-6)


def test_a_profile_limits_the_motors() -> None:
    arm = load_robot("ur5", elastic=[{**elastic(1)[0], "joint": "elbow_joint"}])
    problem = Problem.create(arm, 1.0, 5, goal={"v": 0}, limits={"profile": "ur5"})
    link, motor = (arm.velocity_indices(name).start for name in ("elbow_joint", "elbow_joint_motor"))
    bounds = problem.limits
    assert np.isinf(bounds.v_upper[link])
    assert np.isfinite([bounds.v_upper[motor], *bounds.u_upper]).all()
    assert np.isfinite(bounds.q_upper[arm.configuration_indices("elbow_joint")]).all()


def test_a_planned_motion_is_one_of_spongs_arm(files: dict[int, Path]) -> None:
    """The controls, constant in each step, move the model by hand to the goal, and leave it there."""
    s = mbocp.solve(task(files[2], scheme="gauss3"), check=True)
    state, dt = np.concatenate([s.qs[0], s.vs[0]]), s.duration / s.num_steps
    for k in range(s.num_steps):
        state = motion(lambda y, u=s.us[k]: spong(y, u), state, dt)[:, -1]  # type: ignore[misc]
        np.testing.assert_allclose(state[:4], s.qs[k + 1], atol=2e-6)
    goal = s.qs[-1]
    np.testing.assert_allclose(goal[:2], [0.8, -0.5], atol=1e-8)
    held = spong(np.concatenate([goal, np.zeros(4)]), rigid(goal[:2], np.zeros(2))[1])
    np.testing.assert_allclose(held, 0, atol=1e-6)


def test_limits_and_motors_are_of_the_motor(files: dict[int, Path], tmp_path: Path) -> None:
    arm = load_robot(files[2], elastic=elastic(2)[:1])
    assert [label.name for label in arm.u_labels] == ["shoulder_motor", "elbow"]
    np.testing.assert_array_equal(arm.limits.effort, [60, 60])
    np.testing.assert_array_equal(arm.limits.velocity, [np.inf, 9, 9])
    np.testing.assert_array_equal(arm.limits.position_upper, [3, 3, np.inf])
    chosen = load_robot(files[2], elastic=elastic(2), actuated=["elbow", "shoulder"])
    assert [label.name for label in chosen.u_labels] == ["elbow_motor", "shoulder_motor"]
    locked = load_robot(files[2], elastic=elastic(2), lock={"elbow": 0.4})
    assert locked.joint_names == ("shoulder", "shoulder_motor")
    table = tmp_path / "robot.toml"
    table.write_text(
        f'urdf = "{files[2]}"\n[[actuator]]\ntype = "joint"\njoint = "elbow"\neffort = 5\n'
        '[[elastic]]\njoint = "elbow"\nstiffness = 40\nmotor_inertia = 1\n'
    )
    told = load_robot(table)
    assert [(label.name, label.unit) for label in told.u_labels] == [("elbow_motor", "N m")]
    assert told.limits.effort.tolist() == [5]
    both = load_parts(
        [{"robot": str(table), "name": "a"}, {"robot": str(files[1]), "name": "b"}],
        elastic=[{**elastic(1)[0], "joint": "b/shoulder"}],
    )
    assert [row["joints"] for row in describe(both)["elastic"]] == [
        ["a/elbow", "a/elbow_motor"],
        ["b/shoulder", "b/shoulder_motor"],
    ]
    assert [label.name for label in both.u_labels] == ["a/elbow_motor", "b/shoulder_motor"]
    assert mbocp.robot.robot_from_spec(both.spec).fingerprint == both.fingerprint


def test_a_joint_and_its_motor_turn_together(tmp_path: Path) -> None:
    """About an upright axis, weight does nothing: the momentum of both is conserved as a whole."""
    file = tmp_path / "turntable.urdf"
    file.write_text(
        robot(link("base", None), body("upper", M1, C1, I1), hinge("yaw", "base", "upper", 0, axis="0 0 1"))
    )
    (found,) = find_symmetries(load_robot(file, elastic=[{**elastic(1)[0], "joint": "yaw"}]))
    (field,) = found.generator(np.zeros((1, 2)))
    assert field[0] == pytest.approx(field[1])
    assert abs(field[0]) > 0


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"joint": "sholder"}, "no joint 'sholder'"),
        ({"stiffness": 0.0}, r"elastic\[0\]\.stiffness: got 0"),
        ({"damping": -1.0}, r"elastic\[0\]\.damping: got -1"),
        ({"motor_inertia": "big"}, r"elastic\[0\]\.motor_inertia: got 'big'"),
        ({"stifness": 1.0}, r"elastic\[0\]\.stifness: unknown key; did you mean 'stiffness'"),
    ],
)
def test_wrong_tables_are_refused_by_key(files: dict[int, Path], change: dict[str, Any], says: str) -> None:
    row = {**elastic(1)[0], **change}
    with pytest.raises(RobotError, match=says):
        load_robot(files[1], elastic=[row])
    with pytest.raises(RobotError, match=says):
        mbocp.robot.robot_from_spec({"name": str(files[1]), "elastic": [row]})


def test_what_cannot_be_elastic_is_refused(files: dict[int, Path], tmp_path: Path) -> None:
    rows = elastic(1)
    with pytest.raises(RobotError, match=r"elastic\[1\]\.joint: 'shoulder' is named twice"):
        load_robot(files[1], elastic=[*rows, *rows])
    with pytest.raises(RobotError, match="'shoulder' moves none"):
        load_robot(files[1], elastic=rows, dynamics=False)
    endless = tmp_path / "endless.urdf"
    endless.write_text(ONE.replace('type="revolute"', 'type="continuous"'))
    with pytest.raises(RobotError, match="'shoulder' is continuous, expected a revolute or prismatic joint"):
        load_robot(endless, elastic=rows)
    named = tmp_path / "named.urdf"
    named.write_text(ONE.replace('"upper"', '"shoulder_motor"'))
    with pytest.raises(RobotError, match="a frame is called 'shoulder_motor' already"):
        load_robot(named, elastic=rows)
    driven = tmp_path / "robot.toml"
    driven.write_text(f'urdf = "{files[1]}"\n[[drive]]\njoint = "shoulder"\ncontrol = "acceleration"\n')
    with pytest.raises(RobotError, match="joint 'shoulder' is elastic"):
        load_robot(driven, elastic=rows)
    with pytest.raises(ProblemError, match="knows no elastic joints"):
        task(files[2], coordinates="natural", scheme="se1")
    assert issubclass(RobotError, MbocpError)
