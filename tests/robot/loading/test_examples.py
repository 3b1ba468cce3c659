"""Every robot of example-robot-data, and that it is the robot that example-robot-data means."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from mbocp.exceptions import UnsupportedRobot
from mbocp.robot import NotModelledWarning, SingularMassMatrix, describe, load_robot, robot_from_spec
from mbocp.robot.loading.readers import example_robots as examples

# Left out, by name: an SDF file, and robots with a mass matrix that is singular as long as these joints move.
SDF = ["cassie"]
MASSLESS = ["bluevolta_bravo7_gripper", "bravo7_gripper", "falcon_bravo7_gripper", "icub", "romeo"]
LOADABLE = [name for name in examples.names() if name not in SDF + MASSLESS]


def test_there_are_at_least_65() -> None:
    assert len(LOADABLE) >= 65


@pytest.mark.parametrize("name", LOADABLE)
def test_loads(name: str) -> None:
    with contextlib.ExitStack() as told:
        if name == "pr2":
            told.enter_context(pytest.warns(NotModelledWarning, match="gravity turned off for the links"))
        robot = load_robot(name, friction="none")
    assert robot.name == name
    assert len(robot.q_labels) == robot.nq
    assert len(robot.v_labels) == len(robot.p_labels) == robot.nv
    assert len(robot.u_labels) == robot.nu == robot.limits.effort.size
    assert robot.actuation.selection.shape == (robot.nv, robot.nu)
    assert len({label.name for label in robot.q_labels}) == robot.nq
    np.testing.assert_allclose(robot.normalise(robot.q0), robot.q0, atol=1e-12)
    assert np.linalg.eigvalsh(robot.mass_matrix(robot.q0)).min() > 0
    assert all(robot.frame_id(frame) >= 0 for frame in robot.trace_frames)
    assert all(g.meshPath or g.geometry is not None for g in robot.visual_model.geometryObjects)
    json.dumps(describe(robot))


@pytest.mark.parametrize("name", MASSLESS)
def test_a_massless_chain_is_refused_with_its_joints_and_loads_with_them_locked(name: str) -> None:
    with pytest.raises(SingularMassMatrix, match=r"mass matrix is singular.*lock = \[") as refused:
        load_robot(name)
    joints = refused.value.joints
    robot = load_robot(name, lock=list(joints))
    assert not set(joints) & set(robot.joint_names)


def test_an_sdf_file_is_refused_by_name() -> None:
    with pytest.raises(UnsupportedRobot, match=r"'cassie' is described by cassie\.sdf, an SDF file"):
        load_robot("cassie")


@pytest.mark.parametrize(
    "name", ["double_pendulum", "kinova", "solo12", "talos_arm", "talos_legs", "human", "hector"]
)
def test_is_the_robot_that_upstream_builds(name: str) -> None:
    from example_robot_data import robots_loader

    theirs = robots_loader.loader(name).robot
    ours = load_robot(name, friction="none")
    assert list(theirs.model.names) == list(ours.model.names)
    np.testing.assert_allclose(ours.q0, theirs.q0, atol=1e-12)
    q = pin.integrate(theirs.model, ours.q0, np.linspace(-1, 1, ours.nv))
    v = np.linspace(1, -1, ours.nv)
    expected = pin.rnea(theirs.model, theirs.model.createData(), q, v, v)
    np.testing.assert_allclose(pin.rnea(ours.model, ours.model.createData(), q, v, v), expected, atol=1e-12)
    shown = {g.name: g for g in ours.visual_model.geometryObjects}
    for shape in theirs.visual_model.geometryObjects:
        mine = shown.pop(shape.name)
        np.testing.assert_allclose(mine.placement.homogeneous, shape.placement.homogeneous, atol=1e-12)
        np.testing.assert_allclose(mine.meshScale, shape.meshScale)
        assert mine.parentJoint == shape.parentJoint
        assert Path(mine.meshPath).name == Path(shape.meshPath).name or not mine.meshPath
    assert not shown


def test_a_robot_that_is_read_once_is_another_one_each_time() -> None:
    """Upstream builds these legs by code, with all meshes, which takes a second."""
    one = load_robot("talos_legs")
    assert examples._build("talos_legs") is examples._build("talos_legs")
    model = one.model.copy()
    one.model.gravity.linear = np.zeros(3)
    one.model.inertias[1] = pin.Inertia.Zero()
    one.visual_model.removeGeometryObject(one.visual_model.geometryObjects[0].name)
    other = load_robot("talos_legs")
    assert other.model == model
    assert len(other.visual_model.geometryObjects) == len(one.visual_model.geometryObjects) + 1


def test_ur3_is_a_ur3() -> None:
    # Upstream's table has the UR5 under this name.
    assert load_robot("ur3").source is not None
    assert load_robot("ur3").source.name == "ur3_robot.urdf"  # type: ignore[union-attr]
    reach = {name: load_robot(name).mass_matrix(np.zeros(6))[0, 0] for name in ("ur3", "ur5")}
    assert reach["ur3"] < reach["ur5"]


def test_fixed_and_free_base() -> None:
    fixed = load_robot("solo12", free_flyer=False)
    assert (fixed.nq, fixed.nv, fixed.nu) == (12, 12, 12)
    free = load_robot("ur5", free_flyer=True)
    assert (free.nq, free.nv, free.nu) == (13, 12, 6)
    assert free.joint_names[0] == "root_joint"
    np.testing.assert_array_equal(free.q0[:7], [0, 0, 0, 0, 0, 0, 1])
    with pytest.raises(
        UnsupportedRobot, match=r"'human' is built by code.*free_flyer, mimic and inertias cannot be changed"
    ):
        load_robot("human", free_flyer=False)


def test_mimic_joints_are_free_unless_asked_for() -> None:
    assert load_robot("panda").nv == 9
    coupled = load_robot("panda", mimic=True)
    assert (coupled.nq, coupled.nv, coupled.nu) == (8, 8, 8)
    assert coupled.q0.shape == (8,)
    assert load_robot("panda", lock=["panda_finger_joint1"], mimic=True).nv == 7


def test_spec_loads_the_same_robot_again() -> None:
    robot = load_robot(
        "panda",
        lock={"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.0},
        gravity=(0, 0, -3.7),
        actuated=["panda_joint2", "panda_joint1"],
        name="martian",
    )
    again = robot_from_spec(json.loads(json.dumps(dict(robot.spec))))
    assert again.fingerprint == robot.fingerprint
    assert again.name == "martian"
    assert again.fingerprint != load_robot("panda").fingerprint
