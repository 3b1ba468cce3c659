"""Limits between nodes: what leaves them is told, and a motion that leaves them far has not converged."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from typer.testing import CliRunner

import mbocp
from mbocp.accuracy.solution_accuracy import motion_of
from mbocp.cli.app import app
from mbocp.formulation import Motion, formulate
from mbocp.job import Job
from mbocp.problem import Problem, between_nodes, step_flow
from mbocp.problem.between_nodes import GROSS_EXCESS, LimitExcess, can_hold_within, largest_excess
from mbocp.problem.step_cubics import StepCubics
from mbocp.solution import Status
from mbocp.solution.read_solution import judge
from mbocp.solution.sent import compute_motion_sent
from mbocp.strategies import OneSolve, RoomForSpeeds
from tests.between_nodes.cases import TOLERANCE, problem_of, row_of, true_excess
from tests.formulation.stages import check_derivatives

LIMIT = 2.0


def swing(controls: str, steps: int = 20, scheme: str = "gauss2", **limits: float) -> Problem:
    """A double pendulum that has to hurry."""
    return Problem.create(
        mbocp.load_robot("double_pendulum", damping=False),
        1.2,
        steps,
        goal={"q": [1.5, -0.8], "v": 0},
        cost={},
        limits=limits or {"velocity": LIMIT},
        scheme=scheme,
        controls=controls,
    )


def is_at_node(ratio: float, qs: np.ndarray, vs: np.ndarray) -> bool:
    """Whether a node leaves a limit as far: solved motions keep them there, and random ones do not."""
    of_speed = (np.abs(vs) - LIMIT).max() / LIMIT
    of_position = (np.maximum([-0.5, -0.9] - qs, qs - [1.6, 0.9]) / [2.1, 1.8]).max()
    return bool(max(of_speed, of_position) >= ratio - 1e-4)


@settings(max_examples=50)
@given(seed=st.integers(0, 10_000))
def test_it_is_the_largest_excess_of_the_cubics(seed: int) -> None:
    rng = np.random.default_rng(seed)
    problem = swing("constant", 3).with_(limits={"position": [[-0.5, 1.6], [-0.9, 0.9]]})
    t = np.cumsum([0.0, *rng.uniform(0.1, 0.5, 3)])
    qs, vs = rng.normal(0.0, 0.4, (4, 2)), rng.normal(0.0, 1.5, (4, 2))
    s = np.linspace(0.0, 1.0, 2001)[:, None]
    ratios = [0.0]
    for n in range(3):
        h = t[n + 1] - t[n]
        m = (qs[n + 1] - qs[n]) / h
        v = (1 - 4 * s + 3 * s**2) * vs[n] + (3 * s**2 - 2 * s) * vs[n + 1] + 6 * s * (1 - s) * m
        q = qs[n] + h * np.vstack([np.zeros(2), np.cumsum((v[1:] + v[:-1]) / 2, axis=0) * (s[1] - s[0])])
        ratios.append(float((np.abs(v) - LIMIT).max() / LIMIT))
        widths = np.array([2.1, 1.8])
        ratios.append(float((np.maximum([-0.5, -0.9] - q, q - [1.6, 0.9]) / widths).max()))
    with patch.object(between_nodes, "_COARSE", np.inf):  # no robot follows random nodes
        found = largest_excess(problem, t, qs, vs, np.zeros((3, 2)))
    told = 0.0 if found is None else found.ratio
    assert told <= max(ratios) + 1e-4
    assert told == pytest.approx(max(ratios), abs=1e-4) or is_at_node(max(ratios), qs, vs)


def solve_at_nodes(problem: Problem) -> mbocp.Solution:
    """With limits at nodes alone."""
    return OneSolve().run(Job.of(problem))


def test_a_motion_that_leaves_its_limits_between_nodes_has_not_converged() -> None:
    s = solve_at_nodes(swing("stages"))
    assert s.limit_violation == 0.0
    assert s.status is Status.UNDER_RESOLVED
    assert s.limit_excess > GROSS_EXCESS
    assert s.limit_excess_of.startswith("speed of joint")
    assert f"between nodes the {s.limit_excess_of} is" in s.advice
    assert s.limit_excess == pytest.approx(true_excess(s.load_problem(), s, 1000.0), rel=0.05)


@pytest.mark.parametrize("controls", ["linear", "stages"])
@pytest.mark.parametrize("scheme", ["gauss2", "gauss3", "lobatto3"])
def test_where_it_would_leave_them_it_is_solved_with_limits_that_hold_there(
    controls: str, scheme: str
) -> None:
    problem = swing(controls, 40, scheme)
    s = mbocp.solve(problem, check=True)
    assert solve_at_nodes(problem).limit_excess > GROSS_EXCESS
    true = true_excess(problem, s, 1000.0)
    assert true < 0.03
    assert s.limit_excess == pytest.approx(true, abs=2e-3)
    assert s.phases[0].name == "limits at nodes alone"
    cubic = StepCubics(s.t[:-1, None], np.diff(s.t)[:, None], s.vs[:-1], s.vs[1:], ways_of(s))
    assert np.abs(cubic.speeds(cubic.extremes_of_speeds())).max() <= LIMIT * (1.0 + 1e-6)


def test_limits_that_are_touched_within_steps_are_told() -> None:
    s = mbocp.solve(swing("stages"), check=True)
    touched = {limit.name: limit for limit in s.active_limits if limit.kind == "velocity"}
    joint2 = touched["joint2 within steps"]
    assert (abs(joint2.bound), joint2.unit, joint2.total) == (LIMIT, "rad/s", s.num_steps)
    assert 0 < joint2.count < s.num_steps
    assert s.lam_path.shape == (s.num_steps, 2)


def test_where_steps_are_too_coarse_for_that_it_leaves_them_less() -> None:
    problem = swing("stages", scheme="gauss3")
    s = mbocp.solve(problem)
    assert s.status is Status.UNDER_RESOLVED
    assert GROSS_EXCESS < s.limit_excess < solve_at_nodes(problem).limit_excess / 10.0
    assert s.limit_excess == pytest.approx(true_excess(problem, s, 1000.0), rel=0.05)


def ways_of(s: mbocp.Solution) -> np.ndarray:
    """Mean speeds of the steps of a solution without rotations."""
    return np.diff(s.qs, axis=0) / np.diff(s.t)[:, None]


def test_speeds_have_lower_limits_at_nodes_where_they_cannot_hold_within_steps() -> None:
    problem = swing("constant", 12, "midpoint")
    alone, s = OneSolve().run(Job.of(problem)), RoomForSpeeds(OneSolve()).run(Job.of(problem))
    assert (alone.status, alone.limit_excess_of) == (Status.UNDER_RESOLVED, "speed of joint1")
    assert s.converged
    largest = np.abs(s.vs).max(axis=0)
    assert largest[0] < LIMIT - 1.4 * (alone.limit_excess - GROSS_EXCESS) * LIMIT
    assert largest[1] == pytest.approx(LIMIT, abs=1e-4)
    assert s.cost < 1.01 * alone.cost
    assert s.problem.limits.v_upper == pytest.approx([LIMIT, LIMIT])
    excess = largest_excess(problem, s.t, s.qs, s.vs, s.us)
    assert (0.0 if excess is None else excess.ratio) == s.limit_excess < GROSS_EXCESS
    assert "lowered at nodes, to hold nearly between them: the speed of joint1 by 5.2 %" in s.advice


def test_limits_of_speeds_that_phases_have_are_lowered_likewise() -> None:
    """As those of the whole motion are, and told by what was asked for."""
    whole = swing("constant", 12, "midpoint")
    part = {"steps": 6, "duration": 0.6, "limits": {"velocity": LIMIT}}
    parts = [{"name": name, **part} for name in ("first", "second")]
    problem = whole.with_(phase=parts, limits={"velocity": 100.0 * LIMIT}, duration=None, steps=None)
    one, s = RoomForSpeeds(OneSolve()).run(Job.of(whole)), RoomForSpeeds(OneSolve()).run(Job.of(problem))
    assert s.converged
    np.testing.assert_allclose(s.vs, one.vs, atol=1e-5)
    assert s.limit_excess == pytest.approx(one.limit_excess, abs=1e-6)
    assert "the speed of joint1 by 5.2 %" in s.advice


def test_steps_that_leave_a_speed_too_far_are_not_solved_again() -> None:
    problem = swing("constant", 8, "midpoint")
    alone, s = OneSolve().run(Job.of(problem)), RoomForSpeeds(OneSolve()).run(Job.of(problem))
    assert alone.limit_excess > 1.0
    assert (s.status, s.limit_excess, s.iterations) == (alone.status, alone.limit_excess, alone.iterations)


def test_states_remember_the_middle_of_a_step() -> None:
    """3 m - v0 - v1, as the motion has it."""
    problem = replace(swing("stages"), limits_within="v")
    s, formulation = mbocp.solve(problem, check=True), formulate(problem)
    iterate = formulation.iterate_of(motion_of(s), s.lams)
    remembered = iterate.xs[1:, formulation.layout.states["velocity_within"]]
    np.testing.assert_allclose(remembered, 3.0 * ways_of(s) - s.vs[:-1] - s.vs[1:], atol=1e-12)
    assert formulation.programme.describe_row(0, 4).startswith("speed within the step of joint1")


@pytest.mark.parametrize("duration", [1.2, {"min": 0.5, "max": 3.0, "guess": 1.2}])
def test_limits_within_steps_have_exact_derivatives(duration: object) -> None:
    problem = swing("stages", 6).with_(duration=duration)
    check_derivatives(formulate(replace(problem, limits_within="v")), 2, [0, 3, 4])


def test_a_drone_keeps_limits_of_its_attitude_and_place_within_steps() -> None:
    robot = mbocp.load_robot("hector", actuated=["root_joint"])
    goal = robot.q0.copy()
    goal[:3] += [1.5, 0.8, 0.6]
    goal[3:7] = [0.0, 0.0, np.sin(0.8), np.cos(0.8)]
    problem = Problem.create(
        robot,
        1.4,
        8,
        goal={"q": goal, "v": 0},
        cost={"velocity": 1.0},
        limits={"velocity": dict(zip([x.name for x in robot.v_labels], [1.3] * 6, strict=True))},
        scheme="gauss2",
        controls="stages",
    )
    held = mbocp.solve(replace(problem, limits_within="v"), check=True)
    assert true_excess(problem, held, 200.0) < 0.01
    assert solve_at_nodes(problem).limit_excess > held.limit_excess


def test_a_warm_start_keeps_them_at_once(tmp_path: Path) -> None:
    problem = swing("stages")
    s = mbocp.solve(problem, check=True)
    read = mbocp.Solution.load(s.save(tmp_path / "swing.h5"))
    for start in (s, read):
        again = mbocp.solve(problem, warm_start=start, check=True)
        assert again.iterations <= 1
        assert again.cost == pytest.approx(s.cost, rel=1e-9)


def test_a_small_excess_is_told() -> None:
    s = mbocp.solve(swing("constant"), check=True)
    assert 0.0 < s.limit_excess < GROSS_EXCESS
    assert s.limit_excess == pytest.approx(true_excess(s.load_problem(), s, 1000.0), abs=TOLERANCE)
    finer = mbocp.solve(swing("constant", 80), check=True)
    assert finer.limit_excess < s.limit_excess / 8.0  # of second order


def test_steps_that_move_by_the_mean_of_both_velocities_are_looked_at() -> None:
    s = mbocp.solve(swing("constant", scheme="midpoint"))
    true = true_excess(s.load_problem(), s, 1000.0)
    assert true > TOLERANCE
    assert s.limit_excess == pytest.approx(true, abs=TOLERANCE)


def test_nothing_is_said_of_schemes_of_first_order() -> None:
    assert np.isnan(mbocp.solve(swing("constant", scheme="se1"), check=True).limit_excess)


def excess_of(problem: Problem, us: np.ndarray, shares: tuple[float, ...] = ()) -> LimitExcess:
    """In one step of half a second from rest to 2 and -1 rad/s, on the way of a constant acceleration."""
    qs, vs = np.array([[0.0, 0.0], [0.5, -0.25]]), np.array([[0.0, 0.0], [2.0, -1.0]])
    found = largest_excess(problem, np.array([0.0, 0.5]), qs, vs, us, shares)
    assert found is not None
    return found


def test_efforts_are_looked_at_beside_their_stages() -> None:
    """The line through (1/4, 1) and (3/4, -1) is 2 at the begin and -2 at the end of the step."""
    problem = swing("stages", 2, effort=1.0)
    found = excess_of(problem, np.array([[[1.0, 0.5], [-1.0, 0.5]]]), (0.25, 0.75))
    assert (found.of, abs(found.value), found.ratio) == ("effort of joint1", 2.0, 1.0)
    assert found.unit == "N m"


def test_powers_are_looked_at_where_steps_begin() -> None:
    problem = swing("constant", 2, power=3.0)
    vs, qs = np.array([[2.0, 0.0], [1.0, 0.0]]), np.array([[0.0, 0.0], [0.75, 0.0]])
    found = largest_excess(problem, np.array([0.0, 0.5]), qs, vs, np.array([[-3.0, 0.0]]))
    assert found is not None
    assert (found.of, found.value, found.time, found.unit) == ("power of joint1", -6.0, 0.0, "W")


def test_powers_are_looked_at_within_steps_where_controls_vary() -> None:
    """A torque that falls from 4 to 0 while the speed grows from 0 to 2: nothing at both ends, 2 between."""
    found = excess_of(swing("linear", 2, power=1.5), np.array([[[4.0, 0.0], [0.0, 0.0]]]), (0.0, 1.0))
    assert (found.of, found.unit) == ("power of joint1", "W")
    assert (found.value, found.time) == pytest.approx((2.0, 0.25))


def test_accelerations_are_looked_at_where_they_are_extreme() -> None:
    """A constant acceleration is its mean; one that grows from zero is twice its mean at the end."""
    problem = swing("constant", 2, acceleration=4.0)
    t, vs = np.array([0.0, 0.5]), np.array([[0.0, 0.0], [2.0, 0.0]])
    constant, growing = np.array([[0.0, 0.0], [0.5, 0.0]]), np.array([[0.0, 0.0], [1.0 / 3.0, 0.0]])
    us = np.zeros((1, 2))
    assert largest_excess(problem, t, constant, vs, us) is None
    found = largest_excess(problem, t, growing, vs, us)
    assert found is not None
    assert (found.of, found.time, found.unit) == ("acceleration of joint1", 0.5, "rad/s^2")
    assert found.value == pytest.approx(8.0)
    assert found.ratio == pytest.approx(1.0)


def accelerations_of(s: mbocp.Solution) -> np.ndarray:
    """Of the cubics at both ends of each step, shape (2 N, nv)."""
    cubic = StepCubics(s.t[:-1, None], np.diff(s.t)[:, None], s.vs[:-1], s.vs[1:], ways_of(s))
    return np.vstack([cubic.accelerations(0.0), cubic.accelerations(1.0)])


@pytest.mark.parametrize("controls", ["constant", "linear"])
def test_accelerations_keep_their_limits_within_steps(controls: str) -> None:
    """And not for their means alone; what touches them there is told."""
    problem = swing(controls, acceleration=8.0)
    alone, s = solve_at_nodes(problem), mbocp.solve(problem, check=True)
    assert np.abs(np.diff(alone.vs, axis=0)).max() <= 8.0 * problem.dt * (1.0 + 1e-6)
    assert np.abs(accelerations_of(alone)).max() > (1.0 + GROSS_EXCESS) * 8.0
    assert np.abs(accelerations_of(s)).max() <= 8.0 * (1.0 + 1e-6)
    assert s.limit_excess < 1e-6
    touched = {limit.name for limit in s.active_limits if limit.kind == "acceleration"}
    assert touched & {
        f"{joint} at {end} of steps" for joint in ("joint1", "joint2") for end in ("begins", "ends")
    }


@pytest.mark.parametrize("most", [1, 3, 200])
def test_no_more_iterations_are_taken_than_are_asked_for(most: int) -> None:
    """From each guess; limits within steps come first, and what is spent on them is spent."""
    problem = swing("constant", acceleration=8.0).with_(solver={"max_iterations": most})
    s = mbocp.solve(problem)
    assert max(phase.iterations for phase in s.phases) <= most
    assert all(phase.name != "limits within steps" for phase in s.phases)
    assert s.status is (Status.CONVERGED if most == 200 else Status.MAX_ITERATIONS)


def test_states_remember_the_accelerations_of_a_step() -> None:
    problem = replace(swing("linear", acceleration=8.0), limits_within="a")
    s, formulation = mbocp.solve(problem, check=True), formulate(problem)
    iterate = formulation.iterate_of(motion_of(s), s.lams)
    remembered = 8.0 * iterate.xs[1:, formulation.layout.states["acceleration_within"]]  # by the limit
    np.testing.assert_allclose(np.vstack(np.split(remembered, 2, axis=1)), accelerations_of(s), atol=1e-10)
    check_derivatives(formulation, 2, [0, 3, 4])


@pytest.mark.parametrize("limits", [{"acceleration": 8.0}, {"acceleration": 8.0, "jerk": 60.0}], ids=len)
def test_multipliers_within_steps_are_what_the_cost_gains_from_a_wider_limit(
    limits: dict[str, float],
) -> None:
    """The last limit's, at nodes, within steps and at ends together."""
    key, bound = list(limits.items())[-1]

    def solved(factor: float) -> mbocp.Solution:
        return mbocp.solve(swing("linear", 30, **{**limits, key: factor * bound}), check=True)

    s, share = solved(1.0), 1e-4
    slope = (solved(1.0 + share).cost - solved(1.0 - share).cost) / (2.0 * share * bound)
    own = np.abs(s.lam_path[:, [name.startswith(key) for name in s.path_names]])
    within = np.abs(s.lam_path[:, [name.startswith(key) and "step" in name for name in s.path_names]])
    assert within.sum() > 0.1 * own.sum()
    assert slope == pytest.approx(-own.sum(), rel=1e-2)  # jerks decide on accelerations at both ends, too


@pytest.mark.parametrize(
    ("limits", "letters"), [({"acceleration": 8.0, "jerk": 60.0}, "aj"), ({"jerk": 60.0}, "j")]
)
def test_jerks_of_linear_controls_hold_within_steps_and_at_both_ends(
    limits: dict[str, float], letters: str
) -> None:
    """Where steps resolve them; shorter ramps are left to what is sent."""
    problem = swing("linear", 30, **limits)
    assert can_hold_within(problem) == letters
    assert can_hold_within(swing("constant", 30, **limits)) == letters.replace("j", "")
    assert can_hold_within(swing("linear", 30, acceleration=8.0, jerk=6e3)) == "a"
    s = mbocp.solve(problem, check=True)
    found, steps = accelerations_of(s), s.num_steps
    jerks = (found[steps:] - found[:steps]) / np.diff(s.t)[:, None]
    assert np.abs(jerks).max() <= 60.0 * (1.0 + 1e-6)
    assert np.abs(jerks).max() >= 60.0 * (1.0 - 1e-3)
    assert max(np.abs(found[0]).max(), np.abs(found[-1]).max()) <= 60.0 * 0.01 * problem.dt * (1.0 + 1e-6)
    assert any("within steps" in limit.name for limit in s.active_limits if limit.kind == "jerk")
    sent = compute_motion_sent(s, 1000.0, fit=True)
    assert sent.excesses == ()
    assert sent.curves.nodes[-1] < 1.03 * s.duration
    held = replace(problem, limits_within=letters)
    check_derivatives(formulate(held), 2, [0, 3, 4])


def test_jerks_hold_within_steps_where_the_guess_of_the_duration_leads_nowhere() -> None:
    """They are tried again from the motion that leaves them between nodes."""
    robot, limits = mbocp.load_robot("double_pendulum"), {"velocity": 3.0, "acceleration": 8.0, "jerk": 100.0}
    cost, goal = {"time": 10.0, "effort": 1e-4}, {"q": [0.8, -0.5], "v": 0}
    asked = {"goal": goal, "cost": cost, "limits": limits, "controls": "linear"}
    s = mbocp.solve(Problem.create(robot, {"min": 0.02, "max": 6.0}, 30, **asked), check=True)
    found = accelerations_of(s)
    jerks = (found[s.num_steps :] - found[: s.num_steps]) / np.diff(s.t)[:, None]
    assert np.abs(jerks).max() <= 100.0 * (1.0 + 1e-6)


@pytest.mark.parametrize(
    ("limits", "letters"),
    [
        ({"acceleration": 8.0}, "a"),
        ({"acceleration": 8.0, "velocity": 3.0}, "av"),
        ({"acceleration": 8.0, "velocity": 3.0, "jerk": 60.0}, "ajv"),
    ],
)
def test_a_result_remembers_which_limits_held_within_steps(
    limits: dict[str, float], letters: str, tmp_path: Path
) -> None:
    problem = swing("linear", 30, **limits)
    s = mbocp.solve(problem, check=True)
    read = mbocp.Solution.load(s.save(tmp_path / "swing.h5"))
    assert read.equals(s)
    assert read.iterate is not None
    assert read.iterate.limits_within == letters
    assert mbocp.solve(problem, warm_start=read, check=True).iterations <= 1


def test_means_of_accelerations_are_held_where_steps_are_not_cubics() -> None:
    """What a scheme of order two leaves of them within steps is told."""
    s = mbocp.solve(swing("constant", 40, "midpoint", acceleration=8.0))
    assert s.phases[0].name != "limits at nodes alone"
    assert s.limit_violation <= 1e-6
    assert s.limit_excess_of.startswith("acceleration")
    assert s.status is Status.UNDER_RESOLVED


def test_motions_that_leave_other_limits_have_not_converged() -> None:
    s = mbocp.solve(swing("constant", power=0.1))
    assert s.limit_violation <= 1e-6
    assert s.limit_excess > GROSS_EXCESS
    assert s.limit_excess_of.startswith("power")
    assert s.status is Status.UNDER_RESOLVED
    assert "% or more beyond" in s.advice
    assert "take more steps; the optimality conditions hold" in s.advice


@pytest.mark.filterwarnings("ignore::mbocp.problem.ProblemWarning")
def test_random_problems_can_be_made() -> None:
    names = {problem_of(seed).robot.name for seed in range(12)}
    assert names == {"ur5", "panda", "double_pendulum", "hector"}


def test_the_shell_tells_it(tmp_path: Path) -> None:
    result = solve_at_nodes(swing("stages")).save(tmp_path / "swing.h5")
    told = json.loads(CliRunner().invoke(app, ["info", str(result), "--json"]).stdout)
    assert told["limit_excess"] > GROSS_EXCESS
    assert told["limit_excess_of"]
    words = CliRunner().invoke(app, ["info", str(result)]).stdout
    assert re.search(r"leaves its\s+limit\s+by\s+[0-9.]+\s+%\s+or\s+more,\s+at", words)
    assert "all are kept at the nodes" in words


@pytest.mark.slow
@pytest.mark.parametrize("seed", [7, 11, 13])
def test_random_motions_do_not_leave_limits_farther_than_is_told(seed: int) -> None:
    row = row_of(seed)
    assert row["status"] in ("converged", "under_resolved")
    assert not row["is_beyond"], row


WRIST = """<robot name="wrist"><link name="base"/>
<link name="flange"><inertial><mass value="0.2"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="wrist" type="revolute"><parent link="base"/><child link="flange"/><axis xyz="0 0 1"/>
<limit lower="-6" upper="6" effort="20" velocity="2"/><dynamics damping="{}"/></joint></robot>"""


def wrist(damping: float, folder: Path, duration: float, steps: int, **words: object) -> Problem:
    """A light joint, which damping holds at a speed by the torque soon; inertia 1e-4 kg m^2."""
    file = folder / "wrist.urdf"
    file.write_text(WRIST.format(damping))
    return Problem.create(file, duration, steps, limits={"velocity": LIMIT}, **words)


@pytest.mark.parametrize("damping", [0.01, 0.3, 10.0, 1e4])
def test_a_wrist_that_damping_stops_at_once_is_followed(damping: float, tmp_path: Path) -> None:
    """Its time constant is half a step, or a billionth of one."""
    problem = wrist(damping, tmp_path, 0.02, 1, goal={"v": 0}, scheme="gauss2")
    t, qs, vs = np.array([0.0, 0.02]), np.array([[0.0], [0.019]]), np.array([[0.0], [1.9]])
    held = replace(problem, limits_within="v")
    found = largest_excess(held, t, qs, vs, np.array([[4.0 * damping]]))
    assert found is not None
    assert found.value == pytest.approx(-4.0 * np.expm1(-0.02 * damping / 1e-4), rel=1e-4)


@pytest.mark.parametrize("size", [0.0, 1e-6, 0.3, 10.0, 1e4])
def test_exponentials_are_those_of_scipy(size: float) -> None:
    root = np.random.default_rng(7).normal(size=(3, 4, 4))
    matrices = -size * root @ root.transpose(0, 2, 1)
    blocks = np.kron(np.eye(4, k=1), np.eye(4)) + np.pad(matrices, ((0, 0), (0, 12), (0, 12)))
    expected = np.split(expm(blocks)[:, :4], 4, axis=-1)
    for found, wanted in zip(step_flow.exponentials(matrices), expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-10 * np.abs(wanted).max())


@pytest.mark.parametrize("damping", [0.3, 10.0, 1e4])
def test_accelerations_that_decay_within_a_step_leave_no_limit_in_it(damping: float, tmp_path: Path) -> None:
    """From 1.9 rad/s the wrist goes to the speed that the torque holds, and not beyond."""
    problem = wrist(damping, tmp_path, 0.02, 1, goal={"v": 0}, scheme="midpoint")
    t = np.array([0.0, 0.02])
    for held in (1.0, 2.4):
        ends = 2.0 * held - 1.9
        qs, vs = np.array([[0.0], [0.02 * held]]), np.array([[1.9], [ends]])
        found = largest_excess(problem, t, qs, vs, np.array([[held * damping]]))
        if held < LIMIT:
            assert found is None
        else:
            assert found is not None
            assert found.value == pytest.approx(held, rel=1e-6)


def test_a_light_joint_is_resolved_by_steps_that_are_long_for_it(tmp_path: Path) -> None:
    problem = wrist(1.0, tmp_path, 0.8, 20, goal={"q": [1.2], "v": 0}, scheme="midpoint")
    s = mbocp.solve(problem, check=True)
    assert s.limit_excess < 0.01
    assert np.abs(s.us).max() == pytest.approx(1.9, abs=0.5)  # damping takes it all


def test_steps_whose_flow_overflows_are_looked_at_by_their_cubics() -> None:
    """Of an arm with joints that turn without end, whose configurations are no vectors."""
    robot = mbocp.load_robot("kinova")
    assert not robot.is_vector_space
    q = robot.integrate(robot.q0, [0.0, 0.0, np.pi, 0.0, 0.0, 0.0])
    bounds = {"limits": {"velocity": True}, "integrator": {"scheme": "midpoint"}}
    problem = Problem.create(robot, 0.4, 4, start={"q": q}, goal={"q": q}, cost={"effort": 1.0}, **bounds)
    vs = np.zeros((5, robot.nv))
    vs[2] = 1e150
    with np.errstate(all="ignore"):
        found = largest_excess(problem, problem.dt * np.arange(5), np.tile(q, (5, 1)), vs, np.zeros((4, 6)))
    assert found is not None
    assert found.is_gross


def test_what_is_not_known_of_one_step_hides_no_excess_of_others() -> None:
    values, labels = np.array([[3.0], [np.nan]]), mbocp.load_robot("rigid_pendulum").v_labels[:1]
    sides = np.full((2, 1), -LIMIT), np.full((2, 1), LIMIT)
    look = between_nodes._Look("speed", values, np.zeros((2, 1)), sides, labels)
    assert [one.ratio for one in look.excesses()] == [0.5]


def test_joints_that_have_nothing_to_turn_are_named() -> None:
    """A wrist whose axes are in line leaves its speeds under any torque that a long step holds."""
    rotors = [{"joint": f"j2s6s200_joint_{number}", "inertia": 0.05} for number in range(1, 7)]
    aligned = np.array([1.0, 0.0, 3.0, 2.0, 1.0, 0.0, 3.14, 1.0, 0.0])
    for motor in (None, rotors):
        robot, is_light = mbocp.load_robot("kinova", motor=motor), motor is None
        limits = {"velocity": True}
        problem = Problem.create(
            robot,
            0.4,
            4,
            start={"q": aligned},
            goal={"q": aligned},
            limits=limits,
            integrator={"scheme": "midpoint"},
        )
        formulation = formulate(problem)
        us = np.zeros((4, 6))
        us[:, 5] = [1.0, -1.0, -1.0, 1.0]
        motion = Motion(np.tile(aligned, (5, 1)), np.zeros((5, 6)), us, np.full(4, 0.1))
        t = 0.1 * np.arange(5.0)
        with patch.object(between_nodes, "_COARSE", -np.inf):  # cubics of what stays know nothing of it
            status, advice, _ = judge(formulation, motion, t, Status.CONVERGED, "end")
            stalled = judge(formulation, motion, t, Status.MAX_ITERATIONS, "stalled")
        assert status is Status.UNDER_RESOLVED
        words = "the inertia that j2s6s200_joint_4 and j2s6s200_joint_6 turn there is"
        assert (words in advice, words in stalled[1]) == (is_light, is_light)
        assert stalled[0] is Status.MAX_ITERATIONS
