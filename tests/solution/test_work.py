"""The work of the controls, beside problems whose work is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.mechanics.motion_rates import powers

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_two_carts_are_driven_half_of_their_way() -> None:
    """Each with 1 N for 50 m, and then it brakes."""
    assert mbocp.solve(EXAMPLES / "optima" / "two_carts.toml").positive_work == pytest.approx(100.0, rel=1e-6)


def test_it_is_the_change_of_energy_and_what_is_braked() -> None:
    problem = mbocp.load_problem(EXAMPLES / "arms" / "ur5_reach.toml").with_(steps=400)
    s, robot = mbocp.solve(problem), problem.robot
    ends = powers(robot, s.qs[:-1], s.vs[:-1], s.us), powers(robot, s.qs[1:], s.vs[1:], s.us)
    braked = -(problem.dt * np.minimum((ends[0] + ends[1]) / 2.0, 0.0)).sum()
    change = robot.potential_energy(s.qs[-1]) - robot.potential_energy(s.qs[0])  # at rest at both ends
    assert s.positive_work - braked == pytest.approx(change, abs=1e-3 * s.positive_work)


def test_files_keep_it(tmp_path: Path) -> None:
    s = mbocp.solve(EXAMPLES / "paper" / "rigid_pendulum.toml")
    assert mbocp.Solution.load(s.save(tmp_path / "a.h5")).positive_work == s.positive_work > 0.0
