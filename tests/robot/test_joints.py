"""Joint types: coordinates, labels, limits, default actuation, mimic joints, locking."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from mbocp.exceptions import DimensionMismatch, InvalidValue, UnknownJoint, UnsupportedRobot
from mbocp.robot import Robot, load_robot
from tests.robot import urdfs
from tests.robot.urdfs import joint, link, robot

MIXED = urdfs.chain("revolute", "continuous", "prismatic", "planar", "floating")


@pytest.fixture
def mixed(tmp_path: Path) -> Robot:
    return load_robot(urdfs.write(tmp_path, MIXED))


@pytest.fixture
def gripper(tmp_path: Path) -> Path:
    """A revolute arm, two fingers: the second follows the first by -2 q + 0.1."""
    links = [link(n) for n in ("base", "arm", "f1", "f2")]
    joints = [
        joint("arm_joint", "revolute", "base", "arm"),
        joint("finger1", "prismatic", "arm", "f1", axis="0 1 0"),
        joint("finger2", "prismatic", "arm", "f2", axis="0 1 1", extra=urdfs.mimic("finger1", -2.0, 0.1)),
    ]
    return urdfs.write(tmp_path, robot(*links, *joints, name="gripper"))


def test_labels(mixed: Robot) -> None:
    assert [str(label) for label in mixed.q_labels] == [
        "j1 [rad]", "j2.cos", "j2.sin", "j3 [m]",
        "j4.x [m]", "j4.y [m]", "j4.cos", "j4.sin",
        "j5.x [m]", "j5.y [m]", "j5.z [m]", "j5.qx", "j5.qy", "j5.qz", "j5.qw",
    ]  # fmt: skip
    assert [str(label) for label in mixed.v_labels] == [
        "j1 [rad/s]", "j2 [rad/s]", "j3 [m/s]", "j4.vx [m/s]", "j4.vy [m/s]", "j4.wz [rad/s]",
        "j5.vx [m/s]", "j5.vy [m/s]", "j5.vz [m/s]", "j5.wx [rad/s]", "j5.wy [rad/s]", "j5.wz [rad/s]",
    ]  # fmt: skip
    assert [str(label) for label in mixed.move_labels] == [
        "j1 [rad]", "j2 [rad]", "j3 [m]", "j4.x [m]", "j4.y [m]", "j4.rz [rad]",
        "j5.x [m]", "j5.y [m]", "j5.z [m]", "j5.rx [rad]", "j5.ry [rad]", "j5.rz [rad]",
    ]  # fmt: skip
    assert [label.unit for label in mixed.p_labels[:4]] == ["N m s", "N m s", "N s", "N s"]
    assert [str(label) for label in mixed.u_labels] == ["j1 [N m]", "j2 [N m]", "j3 [N]"]


def test_indices(mixed: Robot) -> None:
    assert mixed.configuration_indices("j2") == slice(1, 3)
    assert mixed.velocity_indices("j2") == slice(1, 2)
    assert mixed.configuration_indices("j5") == slice(8, 15)
    assert mixed.velocity_indices("j5") == slice(6, 12)
    assert not mixed.is_vector_space
    with pytest.raises(UnknownJoint, match="robot 'test' has no joint 'j22': did you mean 'j2'"):
        mixed.velocity_indices("j22")


def test_limits(mixed: Robot) -> None:
    assert mixed.has_limits
    np.testing.assert_array_equal(mixed.limits.effort, [3, 3, 3])
    np.testing.assert_array_equal(mixed.limits.velocity[:3], [4, 4, 4])
    np.testing.assert_array_equal(mixed.limits.position_lower[:4], [-1, -np.inf, -np.inf, -1])
    np.testing.assert_array_equal(mixed.limits.position_upper[:4], [2, np.inf, np.inf, 2])
    assert np.isinf(mixed.limits.position_upper[4:]).all()


@pytest.mark.parametrize(
    ("limit", "lower", "upper", "effort", "velocity"),
    [
        ('<limit lower="0" upper="0" effort="0" velocity="0"/>', -np.inf, np.inf, np.inf, np.inf),
        ('<limit effort="5" velocity="1"/>', -np.inf, np.inf, 5.0, 1.0),
        ('<limit lower="2" upper="-1" effort="5" velocity="1"/>', -1.0, 2.0, 5.0, 1.0),
    ],
)
def test_limits_that_are_none_or_swapped(
    tmp_path: Path, limit: str, lower: float, upper: float, effort: float, velocity: float
) -> None:
    urdf = robot(link("a"), link("b"), joint("j", "revolute", "a", "b", extra=limit))
    limits = load_robot(urdfs.write(tmp_path, urdf)).limits
    assert (limits.position_lower[0], limits.position_upper[0]) == (lower, upper)
    assert (limits.effort[0], limits.velocity[0]) == (effort, velocity)


def test_actuated_joints_in_the_order_given(tmp_path: Path) -> None:
    path = urdfs.write(tmp_path, MIXED)
    chosen = load_robot(path, actuated=["j4", "j1"])
    assert [str(u) for u in chosen.u_labels] == ["j4.vx [N]", "j4.vy [N]", "j4.wz [N m]", "j1 [N m]"]
    np.testing.assert_array_equal(np.argwhere(chosen.actuation.selection)[:, 0], [0, 3, 4, 5])
    assert load_robot(path, actuated=[]).nu == 0
    with pytest.raises(UnknownJoint, match="no joint 'elbow'"):
        load_robot(path, actuated=["elbow"])


def test_free_flyer_is_not_actuated_unless_named(tmp_path: Path) -> None:
    path = urdfs.write(tmp_path, urdfs.chain("revolute"))
    free = load_robot(path, free_flyer=True)
    assert (free.nq, free.nv, free.nu) == (8, 7, 1)
    assert [u.name for u in free.u_labels] == ["j1"]
    assert load_robot(path, free_flyer=True, actuated=["root_joint", "j1"]).nu == 7


def test_mimic_joints_have_no_coordinates(gripper: Path) -> None:
    coupled, loose = load_robot(gripper), load_robot(gripper, mimic=False)
    assert (coupled.nq, coupled.nv, coupled.nu) == (2, 2, 2)
    assert (loose.nq, loose.nv, loose.nu) == (3, 3, 3)
    assert [label.name for label in coupled.q_labels] == ["arm_joint", "finger1"]
    assert "finger2" in coupled.joint_names
    empty = coupled.velocity_indices("finger2")
    assert empty.start == empty.stop
    assert coupled.limits.position_lower.shape == (2,)
    with pytest.raises(
        UnsupportedRobot, match="'finger2' mimics 'finger1' and has no position or control of its own"
    ):
        load_robot(gripper, actuated=["finger2"])


def test_mimic_mechanics_are_the_projection_of_the_uncoupled_ones(gripper: Path) -> None:
    coupled, loose = load_robot(gripper), load_robot(gripper, mimic=False)
    ratio = np.array([[1, 0], [0, 1], [0, -2]])
    generator = np.random.default_rng(3)
    for _ in range(3):
        q, v, a = generator.normal(size=(3, 2))
        q_full = ratio @ q + [0, 0, 0.1]
        mass = ratio.T @ loose.mass_matrix(q_full) @ ratio
        np.testing.assert_allclose(coupled.mass_matrix(q), mass, atol=1e-12)
        assert coupled.potential_energy(q) == pytest.approx(loose.potential_energy(q_full))
        torque = pin.rnea(loose.model, loose.model.createData(), q_full, ratio @ v, ratio @ a)
        ours = pin.rnea(coupled.model, coupled.model.createData(), q, v, a)
        np.testing.assert_allclose(ours, ratio.T @ torque, atol=1e-12)


def test_locking_a_leader_locks_its_followers(gripper: Path) -> None:
    locked, loose = load_robot(gripper, lock={"finger1": 0.2}), load_robot(gripper, mimic=False)
    assert locked.joint_names == ("arm_joint",)
    expected = loose.mass_matrix([0.4, 0.2, -0.3])[0, 0]
    np.testing.assert_allclose(locked.mass_matrix([0.4]), [[expected]], rtol=1e-12)
    with pytest.raises(
        UnsupportedRobot, match=r"joint 'finger2' mimics 'finger1'.* name 'finger1', or load with mimic"
    ):
        load_robot(gripper, lock=["finger2"])


def test_locking_keeps_the_rest_in_place(tmp_path: Path) -> None:
    path = urdfs.write(tmp_path, MIXED)
    whole = load_robot(path)
    locked = load_robot(path, lock={"j2": 0.7, "j4": [0.1, 0.2, -0.5], "j3": -0.3})
    assert locked.joint_names == ("j1", "j5")
    assert [u.name for u in locked.u_labels] == ["j1"]
    assert locked.limits.effort.shape == (1,)
    q = locked.integrate(locked.q0, 0.1 * np.arange(1, 8))
    full = np.concatenate(
        [q[:1], [np.cos(0.7), np.sin(0.7)], [-0.3], [0.1, 0.2, np.cos(0.5), -np.sin(0.5)], q[1:]]
    )
    assert locked.potential_energy(q) == pytest.approx(whole.potential_energy(full), rel=1e-12)
    keep = [0, *range(6, 12)]
    np.testing.assert_allclose(locked.mass_matrix(q), whole.mass_matrix(full)[np.ix_(keep, keep)], atol=1e-12)


def test_locking_by_name_is_at_the_initial_pose(tmp_path: Path) -> None:
    toml = "[initial]\nq = { j1 = 0.4, j2 = 0.9 }\n"
    path = urdfs.write(tmp_path, urdfs.chain("revolute", "revolute", "revolute"), toml)
    locked, whole = load_robot(path, lock=["j2"]), load_robot(path)
    np.testing.assert_array_equal(whole.q0, [0.4, 0.9, 0])
    np.testing.assert_array_equal(locked.q0, [0.4, 0])
    assert locked.potential_energy(locked.q0) == pytest.approx(whole.potential_energy(whole.q0))


@pytest.mark.parametrize(
    ("lock", "error", "message"),
    [
        ({"elbow": 1.0}, UnknownJoint, "no joint 'elbow'"),
        (
            {"j1": [1.0, 2.0]},
            DimensionMismatch,
            r"joint 'j1': got shape \(2,\), expected \(1,\); a revolute joint",
        ),
        ({"j1": float("nan")}, InvalidValue, "joint 'j1': got .*nan.*expected finite numbers"),
        ({"j2": [0.0, 0.0]}, InvalidValue, "joint 'j2'.*expected a unit vector"),
        (["j1", "j2"], UnsupportedRobot, "all joints are locked, nothing is left to move"),
    ],
)
def test_wrong_locks(tmp_path: Path, lock: dict[str, float], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        load_robot(urdfs.write(tmp_path, urdfs.chain("revolute", "continuous")), lock=lock)


def test_gravity(tmp_path: Path) -> None:
    path = urdfs.write(tmp_path, urdfs.chain("revolute"))
    np.testing.assert_array_equal(load_robot(path).model.gravity.linear, [0, 0, -9.81])
    np.testing.assert_array_equal(load_robot(path, gravity=(1, 0, 0)).model.gravity.linear, [1, 0, 0])
    with pytest.raises(DimensionMismatch, match="gravity"):
        load_robot(path, gravity=(9.81,))
    with pytest.raises(InvalidValue, match=r"gravity: got .*expected three finite numbers"):
        load_robot(path, gravity=(0, 0, float("inf")))
