"""The top-level solve: arms and the free-flyer, warm starts, interruption, failure, proof."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.exceptions import DimensionMismatch, NotConverged, ProblemError
from mbocp.guesses import guess_candidates
from mbocp.mechanics.diagnostics import largest_turn
from mbocp.problem.goals.frames import pose_errors
from mbocp.solvers import IterationRecord, Status

EXAMPLES = Path(__file__).parents[1] / "examples"
UR5 = EXAMPLES / "arms" / "ur5_reach.toml"
PENDULUM = EXAMPLES / "paper" / "rigid_pendulum.toml"
ROBOTS = sorted(
    path
    for folder in ("arms", "free_flyer")
    for path in (EXAMPLES / folder).glob("*.toml")
    if not any(table in path.read_text() for table in ("[limits]", "[[path]]", "via]]", "[[obstacle]]"))
)


@pytest.fixture(scope="module")
def ur5() -> mbocp.Solution:
    return mbocp.solve(UR5)


@pytest.mark.parametrize("path", ROBOTS, ids=lambda p: p.stem)
def test_robots_reach_their_goal(path: Path) -> None:
    problem = mbocp.load_problem(path)
    is_euler = problem.scheme == "se1"
    s = mbocp.solve(problem, accuracy=not is_euler)
    assert s.converged, s.advice
    assert "strict local minimum" in s.advice
    robot, model = problem.robot, problem.robot.model
    goal = problem.member(s.goal_place).goal
    if goal.poses:  # where the tool is to be says not all of the angles
        assert max(map(np.max, pose_errors(robot, goal, s.q_final)[:2])) < 1e-9
    else:
        assert np.linalg.norm(robot.difference(goal.q, s.q_final)) < 1e-9
    assert np.abs(s.vs[-1]).max() < 1e-9
    assert all(pin.isNormalized(model, q, 1e-12) for q in s.qs)  # quaternions, and joints without a stop
    data, dt = model.createData(), problem.dt
    for n in range(s.num_steps if is_euler else 0):  # the step of SE1, by Pinocchio's own algorithms
        assert (
            np.abs(pin.difference(model, s.qs[n + 1], pin.integrate(model, s.qs[n], dt * s.vs[n + 1]))).max()
            < 1e-11
        )
        torque = pin.rnea(model, data, s.qs[n + 1], s.vs[n + 1], (s.vs[n + 1] - s.vs[n]) / dt)
        applied = robot.actuation_matrix(s.qs[n + 1]) @ s.us[n]
        assert np.abs(torque - applied).max() < 1e-8 * (1 + np.abs(torque).max())
    assert s.control_momentum_names
    assert s.control_momentum_drift < 1e-9 * (1 + np.abs(s.control_momenta).max())
    if problem.scheme == "gauss2":  # what the robot itself does
        assert s.accuracy.local_error < 1e-5
        assert s.accuracy.tracked_error < 1e-3


@pytest.mark.parametrize("steps", [100, 250, 60])
def test_warm_start_with_any_number_of_steps(steps: int) -> None:
    """Of a scheme whose solutions keep all multipliers."""
    problem = mbocp.load_problem(UR5, ["horizon.steps=100", "integrator.scheme=se1"])
    s = mbocp.solve(problem.with_(num_steps=steps), warm_start=mbocp.solve(problem))
    assert s.converged
    assert s.guess_used.startswith("warm start")
    assert s.iterations <= (1 if steps == 100 else 8)


def test_guess_from_a_saved_solution(ur5: mbocp.Solution, tmp_path: Path) -> None:
    ur5.save(tmp_path / "ur5.h5")
    s = mbocp.solve(mbocp.load_problem(UR5, [f'guess.file="{tmp_path / "ur5.h5"}"', "horizon.steps=150"]))
    assert s.converged
    assert "saved solution ur5.h5" in s.guess_used


def test_warm_start_of_another_robot_is_refused(ur5: mbocp.Solution) -> None:
    with pytest.raises(DimensionMismatch, match="warm start"):
        mbocp.solve(PENDULUM, warm_start=ur5)


@pytest.mark.parametrize("kind", ["line", "hold", "control"])
def test_every_guess_leads_to_a_solution(kind: str) -> None:
    settings = [f'guess.kind="{kind}"'] + (["guess.u=[0, 0, 0, 0, 0, 0]"] if kind == "control" else [])
    s = mbocp.solve(mbocp.load_problem(UR5, settings))
    assert s.converged, s.advice
    assert s.guess_used


def test_guess_left_to_mbocp_is_named_and_suits_the_problem(ur5: mbocp.Solution) -> None:
    assert "straight line" in ur5.guess_used
    assert guess_candidates(mbocp.load_problem(UR5)) == ("line", "hold", "control")
    free = mbocp.load_problem(UR5, ["goal.q={elbow_joint=0.5}"])
    assert guess_candidates(free)[0] == "hold"


def test_subset_of_the_goal() -> None:
    s = mbocp.solve(mbocp.load_problem(UR5, ["goal.q={elbow_joint=0.5}"]))
    assert s.converged, s.advice
    assert s.q_final[2] == pytest.approx(0.5, abs=1e-10)
    assert s.eta.shape == (7,)


def test_callback_sees_every_iteration() -> None:
    seen: list[IterationRecord] = []
    s = mbocp.solve(PENDULUM, callback=seen.append)
    assert tuple(seen) == s.history
    assert [r.iteration for r in seen] == list(range(s.iterations + 1))
    assert [p.name for p in s.phases] == ["compile", "guess", "monolithic", "diagnostics"]


def test_json_history_has_one_entry_an_iteration() -> None:
    s = mbocp.solve(PENDULUM)
    history = s.to_dict()["history"]
    assert len(history) == s.iterations == len(s.history) - 1
    assert history[-1]["residual"] == s.residual
    assert all(np.isfinite(list(entry.values())).all() for entry in history)


def test_second_guess_is_tried_and_counted() -> None:
    problem = mbocp.load_problem(UR5, ["solver.max_iterations=3"])
    s = mbocp.solve(problem)
    runs = [p for p in s.phases if p.name.startswith("monolithic")]
    assert [p.name for p in runs] == ["monolithic", "monolithic (guess: hold)", "monolithic (guess: control)"]
    assert s.iterations == sum(p.iterations for p in runs) == len(s.to_dict()["history"])
    assert s.residual == min(r.residual for r in s.history if r.iteration in (3, 6, 9) and not r.is_guess)


def test_interruption_returns_the_iterate() -> None:
    def interrupt(record: IterationRecord) -> None:
        if record.iteration == 3:
            raise KeyboardInterrupt

    s = mbocp.solve(PENDULUM, callback=interrupt)
    assert s.status == "interrupted"
    assert not s.converged
    assert "3 iterations" in s.advice
    assert np.isfinite(s.us).all()


def test_failure_says_why_and_returns_the_best_iterate() -> None:
    problem = mbocp.load_problem(UR5, ["solver.max_iterations=2", 'guess.kind="hold"'])
    s = mbocp.solve(problem)
    assert s.status == "max_iterations"
    assert "not converged in 2 iterations" in s.advice
    assert "largest violation" in s.advice
    assert " t = " in s.advice
    with pytest.raises(NotConverged, match="max_iterations") as caught:
        mbocp.solve(problem, check=True)
    assert caught.value.solution.status == "max_iterations"


def test_redundant_end_conditions_are_called_singular() -> None:
    """One actuator cannot rule the momenta of both bodies of a rigid cart-pendulum at once in one step."""
    with pytest.raises(ProblemError):
        mbocp.load_problem(
            EXAMPLES / "paper" / "cart_pendulum_rigid.toml",
            ["horizon.steps=2", 'goal.enforce="exact"', "goal.q=[0, 0.5, 1]", "goal.p=[0, 0, 0]"],
        )


def test_forward_simulation_that_fails_names_the_step() -> None:
    problem = mbocp.load_problem(
        PENDULUM, ["horizon.steps=2", "horizon.duration=50.0", "guess.u=[1e8, 0, 1e8]"]
    )
    with pytest.raises(ProblemError, match=r"forward simulation .* step to t = "):
        mbocp.solve(problem)


def test_tracking_follows_a_moving_target(tmp_path: Path) -> None:
    steps = 50
    angles = np.zeros((steps, 6))
    angles[:, 0] = np.sin(np.linspace(0.04, 2.0, steps))
    problem = mbocp.Problem.create(
        "ur5", 2.0, steps, goal={"enforce": "none"},
        cost={"effort": 1e-6, "tracking": 10.0, "tracking_weights": {"q": 1.0}, "target": {"q":
        angles.tolist()}}, start={"q": [0.0] * 6},scheme="se1")  # fmt: skip
    s = mbocp.solve(problem)
    assert s.converged, s.advice
    assert np.abs(s.qs[6:, 0] - angles[5:, 0]).max() < 0.02


def test_velocity_weight_slows_the_motion() -> None:
    peak = [
        np.abs(mbocp.solve(mbocp.load_problem(UR5, [f"cost.velocity={w}"])).vs).max() for w in (1.0, 1000.0)
    ]
    assert peak[1] < peak[0]


def test_a_motion_that_the_steps_do_not_resolve_has_a_status(tmp_path: Path) -> None:
    problem = mbocp.load_problem(UR5, ["horizon.steps=2", "horizon.duration=3.0"])
    s = mbocp.solve(problem)
    assert s.status is Status.UNDER_RESOLVED
    assert not s.converged
    assert s.is_stationary
    assert s.residual < 1e-9
    found = re.match(r"(\w+) turns by ([0-9.]+) rad in one step", s.advice)
    assert found
    column = [label.name for label in problem.robot.v_labels].index(found[1])
    assert float(found[2]) == pytest.approx(np.abs(s.vs[:, column]).max() * problem.dt, abs=0.051)
    assert "the optimality conditions hold" in s.advice
    assert "or give cost.velocity a larger weight;" in s.advice
    assert mbocp.Solution.load(s.save(tmp_path / "coarse.h5")).status is Status.UNDER_RESOLVED
    assert s.to_dict()["status"] == "under_resolved"
    assert s.to_dict()["converged"] is False
    with pytest.raises(NotConverged, match="under_resolved"):
        mbocp.solve(problem, check=True)


def test_substeps_resolve_a_motion() -> None:
    robot = mbocp.load_robot("ur5")
    qs, vs = np.zeros((3, robot.nq)), np.zeros((3, robot.nv))
    vs[1, 4] = -12.0  # [rad/s]
    assert largest_turn(robot, qs, vs, 0.1) == (robot.v_labels[4].name, pytest.approx(1.2))
    assert largest_turn(robot, qs, vs, 0.1, substeps=4)[1] == pytest.approx(0.3)
    qs[2, 0] = 3.0  # a leap that the velocities do not show
    assert largest_turn(robot, qs, vs, 0.1) == (robot.v_labels[0].name, pytest.approx(3.0))


def test_solution_keeps_what_made_it(ur5: mbocp.Solution, tmp_path: Path) -> None:
    (tmp_path / "again.toml").write_text(ur5.problem_text, encoding="utf-8")
    again = mbocp.solve(tmp_path / "again.toml")
    assert again.cost == pytest.approx(ur5.cost, rel=1e-12)
    assert np.allclose(again.us, ur5.us, atol=1e-9)
    loaded = mbocp.Solution.load(ur5.save(tmp_path / "ur5.h5"))
    assert loaded.equals(ur5)
    assert set(ur5.versions) >= {"mbocp", "pin", "casadi", "numpy", "python"}
