"""Robots that stand on the ground, for tests of contact forces."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mbocp.problem import Problem
from tests.robot.urdfs import write

FEET = {"FL": (1, 1), "FR": (1, -1), "HL": (-1, 1), "HR": (-1, -1)}
AT_REST = [0, 0, 0.235]  # m


def solo(**words: Any) -> Problem:
    """solo12 on four feet, from rest to rest."""
    held = [
        {
            "name": name,
            "type": "point",
            "frames": [f"solo/{name}_FOOT", "world"],
            "position_b": [0.1946 * x, 0.1689 * y, 0.0191],
        }
        for name, (x, y) in FEET.items()
    ]
    robot = {"part": [{"name": "solo", "robot": "solo12"}], "constraint": held}
    base = {"name": "solo/base_link", "position": AT_REST, "rpy": [0, 0, 0]}
    given = {"start": {"frame": base}, "goal": {"v": 0, "frame": base}, "cost": {"effort": 1.0}}
    given |= {"duration": 0.6, "steps": 12}
    return Problem.create(robot, **{"integrator": {"scheme": "se1"}, **given, **words})


def on_feet(**keys: Any) -> list[dict[str, Any]]:
    """A bound on the force of each foot."""
    return [{"kind": "contact_force", "name": name, "constraint": name, **keys} for name in FEET]


HOPPER = """<robot name="hopper"><link name="world_link"/>
<link name="body"><inertial><mass value="3"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<link name="foot"><inertial><mass value="0.5"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<joint name="height" type="prismatic"><parent link="world_link"/><child link="body"/><origin xyz="0 0 0.5"/>
<axis xyz="0 0 1"/><limit lower="-9" upper="9" effort="999" velocity="99"/></joint>
<joint name="leg" type="prismatic"><parent link="body"/><child link="foot"/><origin xyz="0 0 -0.5"/>
<axis xyz="0 0 1"/><limit lower="-9" upper="9" effort="999" velocity="99"/></joint></robot>"""
HELD = '[[constraint]]\ntype = "{type}"\nname = "ground"\nframes = ["foot", "world"]\n{more}\n'
BODY, FOOT, GRAVITY = 3.0, 0.5, 9.81


def hopper(folder: Path, kind: str = "plane", more: str = "", **words: Any) -> Problem:
    """A body on a leg that pushes along the vertical, from rest up by 0.1 m to rest."""
    held = HELD.format(type=kind, more=more) if kind else ""
    toml = '[actuation]\njoints = ["leg"]\n' + held
    path = write(folder, HOPPER, toml)
    given = {"goal": {"q": {"height": 0.1}, "v": 0}, "cost": {"effort": 1e-3}}
    given |= {"duration": 0.2, "steps": 20}
    return Problem.create(str(path), **{"integrator": {"scheme": "se1"}, **given, **words})


def on_ground(**keys: Any) -> list[dict[str, Any]]:
    """A bound on the force of the hopper's foot."""
    return [{"kind": "contact_force", "name": "ground force", "constraint": "ground", **keys}]
