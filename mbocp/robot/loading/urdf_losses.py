"""Damping and friction that a URDF gives its joints: numbers that make sense."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from mbocp._text import shown
from mbocp.exceptions import UnsupportedRobot
from mbocp.robot.loading.urdf_numbers import child_attribute, finite_numbers


def check_losses(path: Path, root: ElementTree.Element) -> None:
    """Check ``<dynamics damping= friction=>`` of every joint.

    Raises
    ------
    RobotFileError, UnsupportedRobot
        Naming the joint, for what is no number, and for what is negative.
    """
    for joint in root.iterfind("joint"):
        for key in ("damping", "friction"):
            where = f"joint {shown(joint.get('name'))}: {key}"
            (value,) = finite_numbers(path, where, child_attribute(joint, "dynamics", key), (0.0,))
            if value < 0.0:
                raise UnsupportedRobot(
                    f"{path}: {where} is {value:g}; it takes energy out, and cannot be negative"
                )
