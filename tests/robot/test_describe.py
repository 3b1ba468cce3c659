"""A robot as a plain dict."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from mbocp.robot import describe, load_robot
from mbocp.robot.resistance import JointResistance


def test_ur5() -> None:
    told = describe(load_robot("ur5"))
    assert json.loads(json.dumps(told, allow_nan=False)) == told
    assert (told["nq"], told["nv"], told["nu"], told["nc"], told["dofs"]) == (6, 6, 6, 0, 6)
    assert told["mass"] == pytest.approx(18.4, abs=3)
    first = told["joints"][0]
    assert (first["name"], first["type"], first["actuated"]) == ("shoulder_pan_joint", "revolute", True)
    assert first["units"] == ["rad"]
    assert told["actuators"][0] == {"name": "shoulder_pan_joint", "unit": "N m", "limit": 150.0}
    assert "ee_link" in told["frames"]


def test_constraints_and_forces() -> None:
    rigid, elastic = describe(load_robot("rigid_pendulum")), describe(load_robot("elastic_pendulum"))
    (rod,) = rigid["constraints"]
    assert rod == {
        "name": "rod",
        "type": "rod",
        "frames": ["bob", "world"],
        "length": 5.0,
        "rows": ["rod"],
        "redundant_rows": [],
    }
    assert rigid["dofs"] == 2
    (spring,) = elastic["forces"]
    assert spring["type"] == "quartic_spring"
    assert spring["coefficient"] == pytest.approx(0.012)
    assert elastic["joints"][0]["lower"] == [None]
    json.dumps([rigid, elastic], allow_nan=False)


def test_free_flyer() -> None:
    told = describe(load_robot("solo12"))
    root = told["joints"][0]
    assert (root["name"], root["type"], root["nq"], root["nv"]) == ("root_joint", "floating", 7, 6)
    assert not root["actuated"]
    json.dumps(told, allow_nan=False)


def test_a_ball_joint_resists_alike_about_all_axes() -> None:
    robot = load_robot("unicycle_pendulum")
    joint = next(j["name"] for j in describe(robot)["joints"] if j["type"] == "spherical")
    first = robot.model.joints[robot.model.getJointId(joint)].idx_v
    losses = tuple(JointResistance(joint, first + i, damping=1e-3, friction=2e-3) for i in range(3))
    told = describe(replace(robot, resistances=losses))["joints"]
    ball = next(one for one in told if one["name"] == joint)
    assert (ball["damping"], ball["friction"]) == (1e-3, 2e-3)
