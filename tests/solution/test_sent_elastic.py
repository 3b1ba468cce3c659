"""Elastic joints of a motion as it is sent: motors follow it, links swing on their springs."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import mbocp
from mbocp.exceptions import LimitsExceeded
from mbocp.problem import Problem
from mbocp.solution.sampled import sample
from mbocp.solution.sent import compute_motion_sent
from mbocp.solution.sent_checks import check_sent, controls_along
from mbocp.solution.sent_states import Follower
from tests.robot.test_elastic import TWO, elastic


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> mbocp.Robot:
    """An elbow on a spring, and a shoulder that is stiff."""
    file = tmp_path_factory.mktemp("arm") / "two.urdf"
    file.write_text(TWO)
    return mbocp.load_robot(file, elastic=[{**elastic(2)[1], "stiffness": 200.0}])


def reach(robot: mbocp.Robot, steps: int, **words: object) -> Problem:
    goal = {"q": {"shoulder": 0.8, "elbow": 0.6}, "v": 0.0}
    return Problem.create(robot, 1.0, steps, goal=goal, cost={"effort": 1.0}, controls="linear", **words)


def test_what_is_sent_are_the_motors_by_the_names_of_the_joints(robot: mbocp.Robot) -> None:
    solution = mbocp.solve(reach(robot, 20), check=True)
    sent = compute_motion_sent(solution, 500.0)
    motion = sample(sent)
    assert motion.joints == ("shoulder", "elbow")
    assert motion.left_out == ()
    motor = [column.name for column in solution.labels.q].index("elbow_motor")
    assert motion.positions[-1, 1] == pytest.approx(solution.qs[-1, motor])
    assert np.isfinite(motion.efforts).all()


def test_links_swing_to_where_the_solution_has_them_as_steps_get_short(robot: mbocp.Robot) -> None:
    apart = []
    for steps in (20, 60):
        solution = mbocp.solve(reach(robot, steps), check=True)
        follower = Follower.of(compute_motion_sent(solution), robot)
        times, qs, _, controls = controls_along(follower)
        nodes = np.searchsorted(times, solution.t - 1e-9)
        apart.append(np.abs(qs[nodes] - solution.qs).max())
        assert np.abs(controls - solution.controls_at(times)).max() < 0.2 * np.abs(solution.us).max()
    assert apart[0] < 2e-3
    assert apart[1] < 0.2 * apart[0]


def test_controls_of_a_motion_as_it_is_sent_move_the_whole_robot_along_it(robot: mbocp.Robot) -> None:
    """Forward, by Pinocchio's dynamics of links and rotors together."""
    solution = mbocp.solve(reach(robot, 20), check=True)
    follower = Follower.of(compute_motion_sent(solution, interpolation="quintic"), robot)
    curves, model, data = follower.sent.curves, robot.model, robot.model.createData()

    def at(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        positions, velocities, accelerations, _ = curves.at(np.array([t]))
        qs, vs = follower.states(np.array([t]), positions, velocities)
        return qs[0], vs[0], follower.controls(qs, vs, accelerations)[0]

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        q, v = np.split(x, 2)
        force = robot.actuation_matrix(q) @ at(t)[2] + robot.force_elements(q, v)
        return np.concatenate([v, pin.aba(model, data, q, v, force)])

    end = 0.15
    begin = np.concatenate([solution.qs[0], solution.vs[0]])
    found = solve_ivp(slope, (0.0, end), begin, rtol=1e-8, atol=1e-10, max_step=0.02).y[:, -1]
    np.testing.assert_allclose(found, np.concatenate(at(end)[:2]), atol=2e-4)


def test_limits_of_both_sides_are_looked_at(robot: mbocp.Robot, tmp_path: Path) -> None:
    solution = mbocp.solve(reach(robot, 20), check=True)
    (joint,) = robot.elastic
    sent = compute_motion_sent(solution, 500.0)
    _, qs, vs, controls = controls_along(Follower.of(sent, robot))
    names = [column.name for column in solution.labels.u]
    largest = {
        ("position", "elbow"): (qs[:, joint.at_q[0]].max(), "limits_q", joint.at_q[0]),
        ("speed", "elbow"): (vs[:, joint.at_v[0]].max(), "limits_v", joint.at_v[0]),
        ("effort", "elbow_motor"): (controls[:, names.index("elbow_motor")].max(), "limits_u", -1),
    }
    for (kind, name), (value, field, place) in largest.items():
        limits = np.full_like(getattr(solution, field), np.inf)
        limits[0] = -np.inf
        for share, is_told in ((1.001, False), (0.97, True)):
            limits[1, place] = share * value
            held = dataclasses.replace(sent, solution=dataclasses.replace(solution, **{field: limits.copy()}))
            excesses, unknown = check_sent(held, solution.problem)
            assert [(one.kind, one.name) for one in excesses] == [(kind, name)] * is_told
            assert unknown == ()
    fast = mbocp.solve(reach(robot, 20, limits={"effort": True}), check=True)
    assert fast.export(tmp_path / "a.csv", rate=500.0).exists()
    low = np.array(fast.limits_u)
    low[:, -1] *= 0.5 * controls[:, -1].max() / low[1, -1]
    with pytest.raises(LimitsExceeded, match="elbow_motor: effort"):
        dataclasses.replace(fast, limits_u=low).export(tmp_path / "b.csv", rate=500.0)
