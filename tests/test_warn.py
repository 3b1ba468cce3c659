"""Warnings point at the line of the user, whichever door of mbocp led to them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import mbocp

PENDULUM = Path(__file__).parent.parent / "examples" / "paper" / "rigid_pendulum.toml"
ASKS_NOTHING = 'robot = "ur5"\n[horizon]\nduration = 1.0\nsteps = 5\n[goal]\nenforce = "none"\n'


def asking_for_nothing() -> mbocp.Problem:
    return mbocp.Problem.create("ur5", 1.0, 5, goal={"enforce": "none"})


def from_file(folder: Path) -> mbocp.Problem:
    file = folder / "nothing.toml"
    file.write_text(ASKS_NOTHING)
    return mbocp.load_problem(file)


def changed(_: Path) -> mbocp.Problem:
    return mbocp.load_problem(PENDULUM).with_(goal={"enforce": "none"})


def replaced(_: Path) -> mbocp.Problem:
    problem = mbocp.load_problem(PENDULUM)
    return problem.with_(goal=dataclasses.replace(problem.goal, enforce="none"))


@pytest.mark.parametrize(
    "door",
    [lambda _: asking_for_nothing(), from_file, changed, replaced],
    ids=["create", "file", "with", "replace"],
)
def test_a_warning_of_a_problem_points_at_its_caller(door: Callable[[Path], Any], tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="asks for nothing") as told:
        door(tmp_path)
    assert {warning.filename for warning in told} == {__file__}


def test_a_warning_of_a_robot_points_at_its_caller(tmp_path: Path) -> None:
    tensor = '<inertia ixx="{}" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    link = f'<link name="{{}}"><inertial><mass value="1"/>{tensor}</inertial></link>'
    links = link.format("a", 1) + link.format("b", 9)
    joint = '<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint>'
    file = tmp_path / "odd.urdf"
    file.write_text(f'<robot name="odd">{links}{joint}</robot>')
    with pytest.warns(UserWarning, match="physically impossible") as told:
        mbocp.load_robot(file)
    assert {warning.filename for warning in told} == {__file__}
