"""Fixed tendons of an MJCF, whose lengths are sums of joint positions: motors that pull at several joints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbocp.robot.loading.readers.mjcf_xml import Mjcf, find_named_joint
from mbocp.robot.loading.readers.tree import LeftOut, TreeJoint

_LEFT_OUT = ("range", "stiffness", "damping", "frictionloss", "armature", "actuatorfrcrange")


def read_fixed_tendons(
    mjcf: Mjcf, joints: Mapping[str, TreeJoint], left_out: LeftOut
) -> dict[str, dict[str, Any]]:
    """Make tables of motors of the fixed tendons on hinges and slides that are not held.

    Returns
    -------
    dict
        `[[actuator]]` tables without limits, by the names of tendons.

    Raises
    ------
    RobotFileError
        For a joint that there is not.
    """
    found: dict[str, dict[str, Any]] = {}
    for element in mjcf.each("tendon"):
        node, name = mjcf.node(element), element.get("name", element.tag)
        if element.tag != "fixed":
            left_out.add("tendons", name)
            continue
        for key in _LEFT_OUT:
            if np.any(node.vector(key, None)):
                left_out.add(f"{key} of fixed tendons", name)
        terms = [mjcf.node(term) for term in element.iterfind("joint")]
        pairs = [(find_named_joint(term, "joint", joints), term.number("coef", 1.0)) for term in terms]
        ratios = {joint.name: ratio for joint, ratio in pairs if joint.held is None and ratio != 0.0}
        if ratios and all(joints[joint].has_axis for joint in ratios):
            own = f"{name}_tendon" if name in joints else name
            row = {"type": "tendon", "name": own, "joints": list(ratios), "ratios": list(ratios.values())}
            found[name] = row
    return found
