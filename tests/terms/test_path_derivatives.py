"""Derivatives of path functions against central differences, of every kind that problem files know."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from mbocp.formulation import formulate
from mbocp.problem import Problem

POSE = {"name": "tool0", "position": [0.3, 0.35, 0.5], "rpy": [3.0, 0.2, 0.4]}
AXIS = {"name": "tool0", "axis": [0, 0.1, 1], "direction": [0, 0.2, -1]}
BOX = {"position_tolerance": [0.01, 0.02, 0.03], "orientation_tolerance": 0.1}
ON_ARM: dict[str, list[dict[str, Any]]] = {
    "position": [{"kind": "position", "x": [-2, 2], "z": [-2, 2]}],
    "distance": [{"kind": "distance", "point": [0.1, 0.2, 0.3], "max": 9.0}],
    "speed": [{"kind": "speed", "max": 9.0}],
    "speed along a direction": [{"kind": "speed", "direction": [0.3, 2, 0], "min": -9.0, "max": 9.0}],
    "velocity": [{"kind": "velocity", "x": [-9, 9], "y": [-9, 9], "z": [-9, 9]}],
    "frame_acceleration": [{"kind": "frame_acceleration", "x": [-99, 99], "y": [-99, 99]}],
    "angular_speed": [{"kind": "angular_speed", "max": 9.0}],
    "centre_of_mass": [{"kind": "centre_of_mass", "x": [-2, 2], "z": [-2, 2]}],
    "angular_momentum": [{"kind": "angular_momentum", "x": [-9, 9], "y": [-9, 9]}],
    "orientation": [{"kind": "orientation", "axis": [0, 1, 1], "max": 3.0}],
    "braking": [
        {
            "kind": "braking",
            "frame": "elbow_joint",
            "deceleration": 3.0,
            "reserve": 0.2,
            "min": -3.0,
            "max": 3.0,
        },
        {"kind": "braking", "frame": "wrist_1_joint", "deceleration": 0.5, "max": 3.0},
    ],
    "motor": [{"kind": "motor", "frame": "elbow_joint", "stall": 300.0, "no_load": 20.0}],
    "line": [{"kind": "line"}],
    "line with tolerance": [{"kind": "line", "tolerance": 0.02}],
    "segment": [{"kind": "line", "segment": True}],
    "segment with tolerance": [{"kind": "line", "segment": True, "tolerance": 0.02}],
    "orientation_kept": [{"kind": "orientation_kept"}],
    "orientation_kept with tolerance": [{"kind": "orientation_kept", "tolerance": 0.1}],
}
WHOLE = ("centre_of_mass", "angular_momentum")  # of no frame
VIA: dict[str, dict[str, Any]] = {
    "pose": {"frame": POSE},
    "box": {"frame": {**POSE, "position_tolerance": 0.02}},
    "cone": {"frame": {**POSE, "orientation_tolerance": 0.1}},
    "box and cone": {"frame": {**POSE, **BOX}},
    "axis": {"frame": AXIS},
    "cone of an axis": {"frame": {**AXIS, "orientation_tolerance": 0.1}},
    "relative": {"frame": {**AXIS, "x": 0.3, "z": 0.3, "relative_to": "shoulder_link"}},
    "velocities": {"frame": {"name": "tool0", "z": 0.5, "velocity": [0.1, 0.2, 0], "angular_velocity": 0}},
    "joints": {"q": {"shoulder_pan_joint": 0.6}, "v": {"elbow_joint": 0.3}},
}
GATE = {"q": [0.3, 0.6, 0.5, 0.5, 0.0, 0.5, 0.5**0.5]}


def arm(**words: Any) -> Problem:
    start = {"q": [0, -1.57, 1.57, -1.57, -1.57, 0]}
    goal = {"v": 0, "frame": {"name": "tool0", "position": [0.45, -0.2, 0.4]}}
    return Problem.create("ur5", 1.0, 8, start=start, goal=goal, **{"integrator": {"scheme": "se1"}, **words})


def drone() -> Problem:
    robot = {"name": "hector", "actuated": ["root_joint"]}
    return Problem.create(robot, 1.0, 8, via=[{"share": 0.5, **GATE}], scheme="se1")


CASES = {
    **{
        name: lambda t=tables: arm(path=[x if x["kind"] in WHOLE else {"frame": "tool0", **x} for x in t])
        for name, tables in ON_ARM.items()
    },
    **{f"via {name}": lambda w=words: arm(via=[{"share": 0.5, **w}]) for name, words in VIA.items()},
    "via attitude": drone,
}


@pytest.mark.parametrize("make", CASES.values(), ids=CASES)
def test_slopes_and_curvatures(make: Any) -> None:
    """At states beside the motion: rows are polynomials in the placement, and hold everywhere."""
    programme = formulate(make()).programme
    path, kind = programme.functions.function("path"), programme.kind
    rng = np.random.default_rng(5)
    theta, u = programme.theta, rng.standard_normal(kind.nu)
    x = np.asarray(programme.x_start) + 0.3 * rng.standard_normal(kind.nx)
    m = rng.standard_normal(path.size1_out(0))

    def values(at: Any, weights: Any = m) -> list[Any]:
        return [np.asarray(ca.DM(out)) for out in path(at, weights, u, theta)]

    h, slopes, upper = values(x)
    curvature = np.triu(upper) + np.triu(upper, 1).T
    assert np.abs(slopes).max() > 1e-2
    step = 1e-5
    for _ in range(4):
        d = rng.standard_normal(kind.nx)
        ahead, back = values(x + step * d), values(x - step * d)
        scale = 1.0 + np.abs(slopes).max() + np.abs(curvature).max()
        assert np.allclose(slopes @ d, (ahead[0] - back[0]).ravel() / (2 * step), atol=1e-7 * scale)
        turned = (ahead[1] - back[1]).T @ m / (2 * step)
        assert np.allclose(curvature @ d, turned, atol=1e-7 * scale)
    assert h.shape == (len(m), 1)


def test_only_what_holds_has_bounds() -> None:
    """Equations of via points are bounds at their node alone."""
    bounds = formulate(arm(via=[{"share": 0.5, "frame": POSE}])).programme.bounds
    finite = np.isfinite(bounds.path_lower) | np.isfinite(bounds.path_upper)
    assert finite.any(axis=1).tolist() == [n == 4 for n in range(1, 9)]
