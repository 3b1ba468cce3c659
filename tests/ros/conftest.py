"""A small arm, and its problem."""

from __future__ import annotations

from pathlib import Path

import pytest
from mbocp_ros.planner import Planner, load_planner

ARM = """<robot name="arm"><link name="base"/>
{links}
</robot>"""
LINK = """<link name="{name}"><inertial><origin xyz="0.2 0 0"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{joint}" type="{type}"><parent link="{parent}"/><child link="{name}"/>
<origin xyz="{x} 0 0"/><axis xyz="0 0 1"/>
<limit lower="-2.5" upper="2.5" effort="20" velocity="3"/></joint>"""
PROBLEM = """
robot = "arm.urdf"
[horizon]
duration = {{ min = 0.2, max = 8 }}
steps = 30
[goal]
q = {{ shoulder = 1.0, elbow = 0.5 }}
v = 0
[cost]
time = 1.0
effort = 1e-4
[limits]
effort = true
velocity = 1.0
acceleration = 4.0
{limits}
"""


def write_problem(folder: Path, limits: str = "", elbow: str = "revolute") -> Path:
    links = (("upper", "shoulder", "revolute", "base", 0), ("lower", "elbow", elbow, "upper", 0.4))
    keys = ("name", "joint", "type", "parent", "x")
    text = "\n".join(LINK.format(**dict(zip(keys, link, strict=True))) for link in links)
    (folder / "arm.urdf").write_text(ARM.format(links=text))
    file = folder / "arm.toml"
    file.write_text(PROBLEM.format(limits=limits))
    return file


@pytest.fixture
def problem_file(tmp_path: Path) -> Path:
    return write_problem(tmp_path)


@pytest.fixture
def planner(problem_file: Path) -> Planner:
    return load_planner(problem_file)
