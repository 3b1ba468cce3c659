"""Plugins of an SDF that push: the rotors of multicopters become thrusters, all others are told."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from mbocp._text import show
from mbocp.exceptions import RobotFileError
from mbocp.robot.loading.readers.sdf_xml import Sdf
from mbocp.robot.loading.readers.tree import LeftOut, TreeJoint

_ROTOR = "multicopter-motor-model"
_OTHERS = ("lift-drag", "hydrodynamics", "buoyancy", "thruster", "wind-effects", "apply-link-wrench")
_TURNS = {"ccw": 1.0, "cw": -1.0}
_FULL_SPEED = 838.0  # [rad/s], as Gazebo has it where none is given


def read_rotors(sdf: Sdf, joints: Iterable[TreeJoint], left_out: LeftOut) -> list[dict[str, Any]]:
    """Thrusters for the rotors that a plugin turns; their joints, which turn too fast to matter, are held.

    The thrust is `motorConstant` times the square of the speed, along the z axis of the rotor's link, and the
    moment against its turn is `momentConstant` times the thrust. What drags a rotor that flies is left out.

    Raises
    ------
    RobotFileError
        For a rotor whose link or joint there is not, and for numbers without sense.
    """
    known, rows, others = {joint.name: joint for joint in joints}, list[dict[str, Any]](), set[str]()
    for plugin in sdf.element.iterfind("plugin"):
        file, link = plugin.get("filename", ""), plugin.findtext("linkName", "").strip()
        if _ROTOR not in file or plugin.findtext("motorType", "velocity").strip() != "velocity":
            if _ROTOR in file or any(word in file for word in _OTHERS):
                others.add(file)
            continue
        name, turn = (
            plugin.findtext("jointName", "").strip(),
            plugin.findtext("turningDirection", "cw").strip(),
        )
        where = f"rotor {show(name)}"
        if name not in known or link not in sdf.elements or turn not in _TURNS:
            words = (
                f"{where}: its joint, its link {show(link)} or its turning direction {show(turn)} is unknown"
            )
            raise RobotFileError(sdf.path, words)
        by_square = sdf.number(plugin, "motorConstant", where, 8.54858e-06)
        most = by_square * sdf.number(plugin, "maxRotVelocity", where, _FULL_SPEED) ** 2
        if not most > 0.0:
            raise RobotFileError(
                sdf.path, f"{where}: its greatest thrust is {most:g} N, expected more than 0"
            )
        ratio = -_TURNS[turn] * sdf.number(plugin, "momentConstant", where, 0.016)
        known[name].held = 0.0
        rows.append(
            {"type": "thruster", "frame": link, "name": name, "torque_ratio": ratio, "effort": [0.0, most]}
        )
    for file in sorted(others):
        left_out.add("forces of plugins", file)
    return rows
