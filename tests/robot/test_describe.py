"""A robot as a plain dict."""

from __future__ import annotations

import json

import pytest

from mbocp.robot import describe, load_robot


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
