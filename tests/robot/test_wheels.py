"""Wheels: flywheels of a satellite, whose angle nothing depends on."""

from pathlib import Path

import numpy as np
import pytest

import mbocp
from tests.robot import urdfs

WHEEL = (
    '<link name="w{0}"><inertial><origin xyz="0 0 0"/><mass value="0.5"/><inertia ixx="{1}" ixy="0" ixz="0" '
    'iyy="{2}" iyz="0" izz="{3}"/></inertial></link><joint name="{0}" type="{5}"><parent link="bus"/>'
    '<child link="w{0}"/><origin rpy="0.3 0.2 0.1"/><axis xyz="{4}"/>'
    '<limit {6} effort="0.05" velocity="600"/></joint>'
)
BUS = (
    '<link name="bus"><inertial><mass value="30"/><inertia ixx="1.2" ixy="0.02" ixz="0" iyy="1.0" iyz="0" '
    'izz="0.8"/></inertial></link>'
)
FAR = 'lower="-1e5" upper="1e5"'


def satellite(folder: Path, kind: str = "revolute", limits: str = FAR) -> mbocp.Robot:
    """Three flywheels on skew axes."""
    axes = ("1 0 0", "0 1 0", "0 0 1")
    moments = np.full((3, 3), 0.001) + 0.001 * np.eye(3)
    names = zip("xyz", moments, axes, strict=True)
    wheels = (WHEEL.format(name, *row, axis, kind, limits) for name, row, axis in names)
    path = urdfs.write(folder, f'<robot name="satellite">{BUS}{"".join(wheels)}</robot>')
    return mbocp.load_robot(path, free_flyer=True, gravity=(0, 0, 0))


def turn(robot: mbocp.Robot, **changes) -> mbocp.Problem:
    """From rest to rest, the bus turned by a right angle."""
    goal = {"v": dict.fromkeys("xyz", 0.0), "frame": {"name": "bus", "rpy": [np.pi / 2, 0.0, 0.5]}}
    return mbocp.Problem.create(robot, 30.0, 40, start={"v": 0.0}, goal=goal, **changes)


def test_flywheels_turn_far_in_a_step(tmp_path):
    robot = satellite(tmp_path)
    assert robot.wheels.tolist() == 6 * [False] + 3 * [True]
    s = mbocp.solve(turn(robot, limits={"effort": True, "velocity": True}))
    assert s.converged, s.advice
    assert s.iterations < 10
    assert np.abs(s.vs[:, 6:]).max() * 30.0 / 40 > np.pi
    spun = np.array([robot.momentum(q, v) for q, v in zip(s.qs, s.vs, strict=True)])[:, 3:6]
    assert np.abs(spun).max() < 1e-12  # of the whole about its centre: the wheels take what the bus has


def test_on_a_circle_a_step_has_one_turn(tmp_path):
    robot = satellite(tmp_path, "continuous", "")
    s = mbocp.solve(mbocp.Problem.create(robot, 30.0, 40, start={"v": 0.0}, goal={"v": {"x": 2.5}}))
    assert s.status == "under_resolved"
    assert 'unless it is "revolute" in its file' in s.advice


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ('upper="1e5"', 'upper="-99990"'),  # too narrow: it may matter to a tool
        ('<origin xyz="0 0 0"/><mass', '<origin xyz="0.01 0 0.02"/><mass'),  # off its axis
        ('ixx="0.001"', 'ixx="0.0011"'),  # not the same about all axes across
    ],
)
def test_others_are_no_wheels(tmp_path, before, after):
    path = Path(satellite(tmp_path).source)
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after))
    assert not mbocp.load_robot(path, free_flyer=True).wheels[-1]
