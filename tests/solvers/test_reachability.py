"""End conditions that repeat the dynamics: found by name, left out, kept, or refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import OverdeterminedGoal
from mbocp.formulation import formulate
from mbocp.problem import Problem
from mbocp.solvers.reachability import dependent_end_rows
from tests.integrators.explicit import heavy_top
from tests.mechanics.models import chain
from tests.mechanics.models import robot as robot_of

FILE = Path(__file__).parents[2] / "examples" / "so3" / "unicycle_pendulum.toml"
PENDULUM = Path(__file__).parents[2] / "examples" / "paper" / "elastic_pendulum.toml"
FORMULATIONS = [(r, lie) for r in ("quaternion", "dcm") for lie in ("plain", "baumgarte", "munthe_kaas")]


def load(*settings: str) -> Problem:
    return mbocp.load_problem(FILE, ["horizon.steps=12", "horizon.duration=1.2", *settings])


def names(problem: Problem) -> list[str]:
    formulation = formulate(problem)
    programme = formulation.programme
    rows = dependent_end_rows(programme, formulation.end_rows.of_joints)
    return [programme.describe_row(-1, row) for row in rows]


@pytest.mark.parametrize(("rotations", "lie"), FORMULATIONS)
def test_the_spin_of_a_symmetric_pendulum_is_found(rotations: str, lie: str) -> None:
    """J_x = J_y and the centre of mass on the axis: nothing acts on omega_z."""
    problem = load(f"robot.rotations={rotations}", f"integrator.lie={lie}")
    (found,) = names(problem)
    assert "(rate of pendulum.wz) at t = 1.2 s" in found


def test_it_is_left_out_and_told() -> None:
    s = mbocp.solve(load("solver.max_iterations=2"))
    assert s.advice.endswith(
        "left out, since the dynamics imply it: end condition 9 (rate of pendulum.wz) at t = 1.2 s"
    )
    kept = mbocp.solve(load("solver.max_iterations=2", "goal.redundant=keep"))
    assert "left out" not in kept.advice
    assert s.eta.size + 1 == kept.eta.size == 10  # pose, forward speed, angular velocity
    assert abs(s.vs[-1, 4]) < 1e-12  # and it holds, nevertheless


def test_a_spin_that_cannot_be_met_is_refused() -> None:
    with pytest.raises(OverdeterminedGoal, match=r"no control acts upon .*rate of pendulum\.wz"):
        mbocp.solve(load("goal.v.pendulum=[0, 0, 1.5]"))
    with pytest.raises(OverdeterminedGoal, match=r"rate of pendulum\.wz"):
        mbocp.solve(load("start={v={pendulum=[0, 0, 0.5]}}"))
    assert len(names(load())) == 1  # after a task that was refused, too
    # A start that spins as the goal does is as good as none that does.
    spinning = load("start={v={pendulum=[0, 0, 0.5]}}", "goal.v.pendulum=[0, 0, 0.5]")
    assert len(names(spinning)) == 1


def test_conditions_that_are_met_by_different_means_stay() -> None:
    assert names(mbocp.load_problem(PENDULUM, ["horizon.steps=8", "integrator.scheme=rk4"])) == []
    top = Problem.create(
        heavy_top(),
        1.0,
        6,
        goal={"q": [0.0, 0.0, 0.6, 0.8], "v": [0.0] * 3},
        cost={"effort": 1.0},
        scheme="rk4",
    )
    assert names(top) == []


def test_a_body_that_only_some_motors_move() -> None:
    """A slider without a motor coasts: position and velocity of it are implied, the others' are not."""
    robot = robot_of(chain("PX PY")[0], B=np.array([[1.0], [0.0]]))
    words = {"cost": {"effort": 1.0}, "scheme": "rk4", "solver": {"method": "ipopt"}}
    start = {"q": [0.0, 1.0], "v": [0.0, 0.5]}
    goal = {"q": [1.0, 1.5], "v": [0.0, 0.5]}
    problem = Problem.create(
        robot, 1.0, 10, start=start, goal=goal, **{"integrator": {"scheme": "se1"}, **words}
    )
    assert len(names(problem)) == 2
    s = mbocp.solve(problem)
    assert s.converged
    assert np.allclose(s.q_final, goal["q"], atol=1e-9)
    away = Problem.create(
        robot,
        1.0,
        10,
        start=start,
        goal={**goal, "q": [1.0, 1.6]},
        **{"integrator": {"scheme": "se1"}, **words},
    )
    with pytest.raises(OverdeterminedGoal, match="no control acts upon end condition 2"):
        mbocp.solve(away)
    kept = mbocp.solve(
        Problem.create(
            robot,
            1.0,
            10,
            start=start,
            goal={**goal, "redundant": "keep"},
            **{"integrator": {"scheme": "se1"}, **words},
        )
    )
    assert kept.cost == pytest.approx(s.cost, rel=1e-8)


def test_a_motion_that_explodes_hides_no_control() -> None:
    """Large random controls tear the loop of this five-bar open by Heun's method."""
    problem = mbocp.Problem.create(
        "five_bar",
        1.4752719394731781,
        20,
        goal={
            "q": [-0.90918139, 1.80769769, 0.88426114, -1.79925938],
            "v": [0.26512341, -0.31447873, -0.07219675, 0.24990408],
        },
        scheme="heun",
    )
    assert names(problem) == []
