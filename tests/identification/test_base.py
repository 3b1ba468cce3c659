"""Base parameters: known counts, and nothing that torques show is left out."""

from __future__ import annotations

import numpy as np
import pytest

from mbocp import load_robot
from mbocp.exceptions import InvalidValue, UnknownFrame, UnsupportedRobot
from mbocp.identification import base_parameters
from mbocp.identification.dynamics import InverseDynamics
from mbocp.identification.unknown_parameters import _random_poses, base_of, unknowns_of
from mbocp.robot import Payload
from mbocp.robot.named_numbers import OF_ROBOT, list_named_numbers, number_of
from tests.identification.logs import changed

FINGERS = ["panda_finger_joint1", "panda_finger_joint2"]


@pytest.mark.parametrize(
    ("name", "lock", "rotors", "count"),
    [
        ("ur5", None, False, 36),  # arms of n joints, the first upright: 7 n - 6 (Khalil and Dombre 2002)
        ("panda", FINGERS, False, 43),  # Gaz and others 2019
        ("ur5", None, True, 40),  # about the first two axes links turn as their rotors do
        ("four_bar", None, False, 8),
        ("five_bar", None, False, 11),
    ],
)
def test_counts_are_known_ones(name, lock, rotors, count):
    robot = load_robot(name, lock=lock)
    assert base_parameters(robot, friction="none", rotors=rotors).rank == count
    motors = robot.nu
    assert base_parameters(robot, rotors=rotors).rank == count + 2 * motors


@pytest.mark.parametrize("name", ["ur5", "five_bar"])
def test_torques_are_those_of_the_base_parameters(name):
    dynamics = InverseDynamics(load_robot(name))
    unknowns = unknowns_of(dynamics)
    base = base_of(dynamics, unknowns)
    rng = np.random.default_rng(7)
    near = _random_poses(dynamics, 30, rng)
    y = np.array([dynamics.coordinates(q) for q in near])
    motion = dynamics.motion(y, rng.standard_normal(y.shape), rng.standard_normal(y.shape), near)
    regressor = dynamics.regressor(motion) @ unknowns.shares
    assert np.abs(regressor - regressor[:, :, base.chosen] @ base.combinations).max() < 1e-6
    rank = np.linalg.matrix_rank(regressor.reshape(-1, len(unknowns.labels)), tol=1e-7)
    assert rank == base.rank


def test_parameters_go_by_the_words_of_the_robots_numbers():
    """Those that problems, estimators and sensitivities have, with their units and values."""
    held = Payload(
        name="load", frame="tool0", mass=1.5, com=(0.0, 0.0, 0.05), inertia=(4e-3,) * 3 + (0.0,) * 3
    )
    robot = changed(load_robot("ur5"))
    for this, payload, count in ((robot, None, 3 * robot.nv), (robot.with_payload(held), "load", 1)):
        unknowns = unknowns_of(InverseDynamics(this), payload=payload)
        known = list_named_numbers(this)
        words = [label.name.removeprefix(OF_ROBOT) for label in unknowns.labels]
        both = [k for k, word in enumerate(words) if word in known]
        assert len(both) == count
        for k in both:
            assert known[words[k]].unit == unknowns.labels[k].unit
            assert number_of(this, words[k]) == pytest.approx(unknowns.values[k])


def test_a_payload_shows_all_of_itself_on_an_arm():
    base = base_parameters(load_robot("ur5"), payload="tool0")
    assert base.rank == 10
    assert "robot.payload.tool0.mass" in base.alone


def test_what_cannot_be_is_refused_by_name():
    ur5 = load_robot("ur5")
    with pytest.raises(InvalidValue, match=r'friction: got .*"none" \| "viscous"'):
        base_parameters(ur5, friction="dry")
    with pytest.raises(UnknownFrame, match="tool9"):
        base_parameters(ur5, payload="tool9")
    with pytest.raises(InvalidValue, match="a frame that moves"):
        base_parameters(ur5, payload="base_link")
    with pytest.raises(InvalidValue, match="friction_speed"):
        base_parameters(ur5, friction_speed=0.0)
    with pytest.raises(UnsupportedRobot, match="'root_joint' has 6 velocities"):
        base_parameters(load_robot("solo12"))
    elastic = [{"joint": "elbow_joint", "stiffness": 1e4, "motor_inertia": 1.0}]
    with pytest.raises(UnsupportedRobot, match="elastic joint 'elbow_joint'"):
        base_parameters(load_robot("ur5", elastic=elastic))
