"""IPOPT agrees with the monolithic solver on phases, holds, cones, cycles and obstacles of every shape.

From its solution: what is compared are optima, not ways to them. Others are beside what they are about:
impacts of joints in `tests/holds/test_problems.py`, cycles in `tests/holds/test_cycles.py`, partings
and durations of phases in `tests/phases`, two arms with a box in `tests/test_carried.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp import Problem
from mbocp.problem.obstacles.approach import nearest_approach
from mbocp.robot import Robot
from tests.holds.cases import four_bar, pendulum
from tests.problem.test_impulse_bounds import lands
from tests.problem.test_mesh_obstacles import STONE
from tests.problem.test_obstacles import planar

__all__ = ["planar"]


SMALL = (0.3 * np.array(STONE)).tolist()
SHAPES: dict[str, dict[str, Any]] = {
    "sphere": {"radius": 0.1},
    "capsule": {"radius": 0.08, "length": 0.2},
    "box": {"size": [0.16, 0.16, 0.2], "rpy": [0.0, 0.0, 0.6]},
    "cylinder": {"radius": 0.1, "length": 0.3},
    "mesh": {"vertices": SMALL},
    "halfspace": {"position": [1.025, 1.025, 0.0], "rpy": [0.0, -1.5707963, 0.7853982]},
}
HELD: dict[str, Callable[[], Problem]] = {
    "hold in natural coordinates": lambda: pendulum(coordinates="natural"),
    "loop that opens, in natural coordinates": lambda: four_bar(coordinates="natural"),
    "impact in a cone": lands,
    "impact in a pyramid": lambda: lands(facets=4),
    "contact that only pushes": lambda: lands(friction=None, min_normal=0.0),
}


def compared(problem: Problem, tolerance: float = 1e-4) -> mbocp.Solution:
    """The solution, after IPOPT has found the same."""
    own = mbocp.solve(problem.with_(solver={"method": "monolithic"}), check=True)
    other = mbocp.solve(problem.with_(solver={"method": "ipopt"}), warm_start=own, check=True)
    assert other.cost == pytest.approx(own.cost, rel=1e-6)
    assert np.abs(other.qs - own.qs).max() < tolerance
    assert own.constraint_violation < 1e-9
    return own


@pytest.mark.parametrize("make", HELD.values(), ids=HELD)
def test_what_is_held(make: Callable[[], Problem]) -> None:
    compared(make())


def around(robot: Robot, **words: Any) -> Problem:
    """The arm turns by a radian in 20 steps."""
    told = {"start": {"q": [0.0, 0.3, 0.3]}, "goal": {"q": [1.0, 0.3, 0.3], "v": 0}, **words}
    return Problem.create(
        robot, 1.0, 20, cost={"effort": 1.0, "velocity": 10.0}, **{"integrator": {"scheme": "se1"}, **told}
    )


@pytest.mark.parametrize("shape", SHAPES)
def test_what_is_gone_around(planar: Robot, shape: str) -> None:
    """By the smallest distance that is allowed, which coal sees, too."""
    obstacle = {"name": shape, "shape": shape, "position": [1.16, 1.09, 0.0], **SHAPES[shape]}
    problem = around(planar, obstacle=[obstacle])
    own = compared(problem)
    assert problem.clearance is not None
    straight = mbocp.solve(around(planar), solver="monolithic", check=True)
    assert problem.clearance.pair_values(straight.qs).min() < -5e-3  # it is in the way
    nearest = nearest_approach(problem.clearance, own.t, own.qs)
    assert -1e-6 < nearest.distance < 0.03


def test_links_of_the_robot(planar: Robot) -> None:
    """The last ball passes the one of the base, which is in its way."""
    ends = {"start": {"q": [0.0, 1.3, 2.3]}, "goal": {"q": [0.0, 2.5, 2.5], "v": 0}}
    problem = around(planar, self_collision=True, **ends)
    assert problem.clearance is not None
    own = compared(problem)
    assert -1e-6 < nearest_approach(problem.clearance, own.t, own.qs).distance < 0.03
