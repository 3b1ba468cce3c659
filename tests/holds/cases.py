"""Small problems with holds, releases and impacts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mbocp.problem import Problem
from mbocp.problem.timeline.hold import Hold, Release

__all__ = ["CASES", "arm", "drone", "four_bar", "pendulum"]

_BALL = {"name": "tip", "frame": "link2", "mass": 0.1, "com": [0.0, 0.0, 0.2]}


def pendulum(scheme: str = "se1", steps: int = 11, **fields: Any) -> Problem:
    """Its tip lands on a vertical line at step 4, with an impact, and leaves it at step 8."""
    words: dict[str, Any] = {"start": {"q": [0.3, 0.4]}, "goal": {"q": [-0.2, 0.9], "v": [0.0, 0.0]}}
    hold = Hold(name="tip", frame="tip", kind="line", axis=(0.0, 0.0, 1.0), spans=((4, 8),))
    robot = {"name": "double_pendulum", "payload": [_BALL]}
    made = Problem.create(robot, 0.5, steps, scheme=scheme, **words)
    return made.with_(**{"holds": (hold,), "impacts": (4,), **fields})


def arm(scheme: str = "se1", **fields: Any) -> Problem:
    """A UR5 grips the world at step 3, with an impact, and lets go at step 7."""
    words: dict[str, Any] = {
        "start": {"q": [0, -1.2, 1.2, 0, 0.3, 0]},
        "goal": {"q": [0.5, -1, 1, 0, 0.5, 0], "v": [0.0] * 6},
    }
    hold = Hold(name="grip", frame="tool0", kind="hinge", axis=(0.0, 1.0, 0.0), spans=((3, 7),))
    made = Problem.create("ur5", 0.6, 11, scheme=scheme, **words)
    return made.with_(**{"holds": (hold,), "impacts": (3,), **fields})


def drone(scheme: str = "se1", **fields: Any) -> Problem:
    """A free body on a spherical joint from step 2, then welded to the world from step 5."""
    load = {
        "name": "load",
        "frame": "base_link",
        "mass": 0.8,
        "com": [0.1, 0.2, -0.15],
        "box": [0.2, 0.1, 0.3],
    }
    robot = {"name": "hector", "actuated": ["root_joint"], "payload": [load]}
    words: dict[str, Any] = {
        "start": {"q": [0, 0, 0, 0, 0, 0, 1], "v": [0.3, 0.2, -0.1, 0.5, 0.4, -0.2]},
        "goal": {"q": [0.3, 0.1, 0.2, 0, 0, 0, 1], "v": [0.0] * 6},
    }
    frame = "base_link"
    holds = (
        Hold(name="ball", frame=frame, kind="point", spans=((2, 5),)),
        Hold(name="weld", frame=frame, spans=((5, 7),)),
    )
    made = Problem.create(robot, 0.6, 10, scheme=scheme, **words)
    return made.with_(**{"holds": holds, "impacts": (2, 5), **fields})


def four_bar(scheme: str = "se1", **fields: Any) -> Problem:
    """Its loop is open in some steps; before, its crank's end is held at an impact."""
    made = Problem.create(
        "four_bar", 0.4, 10, scheme=scheme, start={"q": {"crank": 0.4}}, goal={"q": {"crank": 0.8}}
    )
    hold = Hold(name="stop", frame="coupler", kind="plane", axis=(1.0, 0.0, 0.0), spans=((2, 4),))
    release = Release(constraint="pin", spans=((6, 10),))
    return made.with_(**{"holds": (hold,), "releases": (release,), "impacts": (2,), **fields})


CASES: dict[str, Callable[..., Problem]] = {
    "pendulum": pendulum,
    "arm": arm,
    "drone": drone,
    "four_bar": four_bar,
}
