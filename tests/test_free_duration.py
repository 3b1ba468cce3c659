"""Durations that are found with the motion: what holds at an optimum, all solvers, robots of all kinds."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.cli.solution_summary import solution_rows
from mbocp.exceptions import InconsistentStart, MbocpError
from mbocp.formulation import formulate
from mbocp.formulation.features.step_lengths import begins_phase
from mbocp.guesses.make import plain_guess
from mbocp.problem import load_problem
from mbocp.solvers import SolverSettings, Start, run_strategy
from mbocp.terms import running_cost
from tests.campaign.run import motion_of
from tests.campaign.tasks import draw
from tests.checker import check_solution
from tests.robot import urdfs

EXAMPLES = Path(__file__).parents[1] / "examples"
FREE = {"min": 0.02, "max": 5.0, "guess": 0.17}


def pendulum(scheme: str = "midpoint", steps: int = 24, **words: Any) -> mbocp.Problem:
    cost = {"time": 1.0, "effort": 0.1, **words.pop("cost", {})}
    goal = {"q": [1.0, 0.5], "v": 0.0}
    words = {"duration": FREE, "scheme": scheme, "goal": goal, "cost": cost, **words}
    return mbocp.Problem.create(
        "double_pendulum", words.pop("duration"), steps, **{"integrator": {"scheme": "se1"}, **words}
    )


def solved(problem: mbocp.Problem, **how: Any) -> mbocp.Solution:
    solution = mbocp.solve(problem, **how)
    assert solution.converged, solution.advice
    assert solution.limit_violation < 1e-6
    return solution


def mean_hamiltonian(s: mbocp.Solution) -> float:
    return abs(s.control_hamiltonian["mean"])


@pytest.mark.parametrize("scheme", ["se1", "se2", "midpoint", "rk4"])
@pytest.mark.parametrize("limits", [{}, {"effort": 3.0}], ids=["free", "limited"])
def test_solvers_find_the_same_duration(scheme: str, limits: dict[str, float]) -> None:
    cost = {"effort": 0.01 if limits else 1.0}  # with less and no limits there are several local minima
    problem = pendulum(scheme, limits=limits, cost=cost)
    own, ipopt = (solved(problem, solver=name) for name in ("monolithic", "ipopt"))
    fatrop = solved(problem.with_(solver={"method": "fatrop", "tolerance": 1e-7}))
    for other, tolerance in ((ipopt, 1e-7), (fatrop, 1e-5)):
        assert other.duration == pytest.approx(own.duration, rel=tolerance)
        assert other.cost == pytest.approx(own.cost, rel=tolerance)
    assert own.t[0] == 0.0
    assert np.allclose(np.diff(own.t), own.duration / own.num_steps, rtol=1e-12)
    assert own.us.shape == (24, problem.robot.nu)


@pytest.mark.parametrize("scheme", ["se1", "se2", "midpoint"])
def test_the_mean_hamiltonian_of_the_steps_vanishes(scheme: str) -> None:
    """The derivative of the discrete Lagrangian in the duration, which the weight of time is part of."""
    assert mean_hamiltonian(solved(pendulum(scheme), solver="monolithic")) < 1e-7


@pytest.mark.parametrize(("scheme", "order"), [("se1", 1), ("midpoint", 2), ("rk4", 1)])
def test_the_hamiltonian_vanishes_along_the_motion_to_the_order_of_the_scheme(
    scheme: str, order: int
) -> None:
    """Of explicit schemes it is evaluated to first order."""
    worst = []
    for steps in (80, 160):
        solution = solved(pendulum(scheme, steps), solver="monolithic")
        worst.append(np.abs(solution.control_hamiltonians).max())
    assert worst[1] < 0.4
    assert worst[0] / worst[1] == pytest.approx(2.0**order, rel=0.2)


def test_an_independent_checker_finds_the_same_optimum(tmp_path: Path) -> None:
    """It is one of its duration, and longer or shorter motions cost more."""
    task = draw("double_pendulum_midpoint", 2, tmp_path)
    words = dict(task.tables)
    fixed = mbocp.Problem.create(**{"integrator": {"scheme": "se1"}, **words})
    T, weight = fixed.duration, 2.0 * solved(fixed).cost / fixed.duration
    free = fixed.with_(duration={"min": T / 5, "max": 5 * T, "guess": T}, cost={"time": weight})
    best = solved(free)
    assert free.duration_range is not None
    assert not best.active_limits or all(a.kind != "duration" for a in best.active_limits)
    at_best = replace(motion_of(best), cost=best.cost - weight * best.duration)
    report = check_solution(task.loaded.system, replace(task.task, duration=best.duration), at_best)
    assert report.failures == ()
    totals = []
    for factor in (0.99, 1.0, 1.01):
        at = best.duration * factor
        totals.append(solved(fixed.with_(duration=at), warm_start=best).cost + weight * at)
    assert totals[1] == pytest.approx(best.cost, rel=1e-9)
    assert min(totals[0], totals[2]) > totals[1]
    assert abs(totals[2] - totals[0]) < 0.1 * (totals[0] + totals[2] - 2 * totals[1])


@pytest.mark.parametrize("name", ["arms/kinova_reach", "free_flyer/drone_flip", "loops/four_bar"])
@pytest.mark.parametrize("solver", ["monolithic", "ipopt"])
def test_robots_with_free_flyers_endless_joints_and_loops(name: str, solver: str) -> None:
    settings = [] if name.startswith("loops") else ["integrator.scheme=se1"]
    problem = load_problem(EXAMPLES / f"{name}.toml", settings).with_(steps=40)
    T, weight = problem.duration, solved(problem).cost / problem.duration
    free = problem.with_(duration={"min": T / 5, "max": 5 * T, "guess": T}, cost={"time": weight})
    solution = solved(free, solver=solver)
    assert not [a for a in solution.active_limits if a.kind == "duration"]
    assert mean_hamiltonian(solution) < 1e-5 * weight
    assert solution.constraint_violation < 1e-9


def test_an_arm_in_minimum_time_within_its_limits() -> None:
    """Some torque or speed is at its limit wherever it may be; more torque takes less time."""
    words = {
        "goal": {"q": [0.5, -1, 1, 0, 0.5, 0], "v": 0.0},
        "cost": {"time": 1.0, "effort": 1e-6},
        "solver": {"method": "monolithic"},
    }
    problem = mbocp.Problem.create(
        "ur5",
        {"min": 0.1, "max": 5.0},
        40,
        limits={"effort": True, "velocity": True},
        **{"integrator": {"scheme": "se1"}, **words},
    )
    s = solved(problem)
    at_limit = (np.abs(s.us) > (1 - 1e-3) * s.limits_u[1]).any(axis=1)
    at_speed = (np.abs(s.vs[1:]) > (1 - 1e-3) * s.limits_v[1]).any(axis=1)
    assert (at_limit | at_speed)[1:-1].all()
    stronger = 1.3 * problem.robot.limits.effort
    assert solved(problem.with_(limits={"effort": stronger})).duration < s.duration
    assert mean_hamiltonian(s) < 1e-6


def test_replans_in_a_row_take_half_the_iterations_of_cold_ones() -> None:
    """Twenty, each from the first node of the one before, in least time within torques and speeds."""
    problem = load_problem(EXAMPLES / "arms" / "ur5_fastest.toml").with_(steps=25)
    last = mbocp.solve(problem)
    duration, passed, warm, cold = last.duration, 0.0, 0, 0
    for steps in range(24, 4, -1):
        passed += float(last.t[1])
        free = {"min": 0.001, "max": 5.0, "guess": duration - passed}
        later = problem.with_(start={"q": last.qs[1], "v": last.vs[1]}, duration=free, steps=steps)
        last, first = mbocp.solve(later, warm_start=last), mbocp.solve(later)
        assert last.converged
        assert first.converged
        assert passed + last.duration == pytest.approx(duration, rel=1e-6)
        warm, cold = warm + last.iterations, cold + first.iterations
    assert 2 * warm < cold


def test_the_tool_of_an_arm_gets_to_a_pose_in_the_least_time() -> None:
    problem = load_problem(EXAMPLES / "arms" / "ur5_fastest.toml")
    s = solved(problem, solver="monolithic")
    wanted = np.array([[1, 0, 0, 0.35], [0, -1, 0, 0.45], [0, 0, -1, 0.25], [0, 0, 0, 1.0]])
    assert np.allclose(problem.robot.frame_placement("tool0", s.qs[-1]), wanted, atol=1e-7)
    assert {a.kind for a in s.active_limits} == {"velocity"}  # torques are no limit without a load
    assert s.duration == pytest.approx(solved(problem, solver="ipopt").duration, rel=1e-6)
    # No joint can be faster: one of them takes all of the time at its limit.
    fastest = np.abs(np.diff(s.qs, axis=0)).sum(axis=0) / s.limits_v[1]
    assert fastest.max() <= s.duration
    assert fastest.max() > 0.9 * s.duration


def test_several_starts_find_the_way_aside() -> None:
    """Straight about its axis a satellite takes 34.3 s, a stationary motion."""
    words = {"horizon.steps": 60, "guess": {"kind": "auto"}}
    path = EXAMPLES / "optima" / "reorientation.toml"
    assert solved(load_problem(path, words)).duration == pytest.approx(34.3112, abs=1e-3)
    assert solved(load_problem(path, {**words, "solver.starts": 8})).duration < 28.65


def test_bounds_of_the_duration_are_kept_and_named() -> None:
    for bounds, side in (({"min": 0.3, "max": 5.0}, "lower"), ({"min": 0.01, "max": 0.1}, "upper")):
        s = solved(pendulum(duration=bounds))
        (touched,) = [a for a in s.active_limits if a.kind == "duration"]
        assert (touched.side, touched.unit) == (side, "s")
        assert s.duration == pytest.approx(touched.bound, rel=1e-6)
        rows = dict(solution_rows(s, "robot"))
        assert f"free between {bounds['min']:g} and {bounds['max']:g} s" in rows["horizon"]
        assert str(rows["limits"]).startswith(f"duration at its {side} bound")


def test_results_keep_it(tmp_path: Path) -> None:
    s = solved(pendulum())
    again = mbocp.Solution.load(s.save(tmp_path / "s.h5"))
    assert again == s
    assert again.duration_range == (0.02, 5.0)
    assert again.duration != pytest.approx(FREE["guess"], rel=0.1)
    (tmp_path / "again.toml").write_text(s.problem_text)
    assert load_problem(tmp_path / "again.toml").duration_range == (0.02, 5.0)
    fixed = solved(pendulum(duration=0.5, cost={"time": 0.0}))
    assert fixed.duration_range is None


def test_any_solution_starts_another() -> None:
    """One of a given duration that of a free one, with other steps; a free one itself at once."""
    given = solved(pendulum(duration=0.3, cost={"time": 0.0}, steps=30))
    s = solved(pendulum())
    assert solved(pendulum(), warm_start=given).duration == pytest.approx(s.duration, rel=1e-8)
    assert solved(pendulum(steps=48), warm_start=s).converged
    assert solved(pendulum(duration=s.duration, cost={"time": 0.0}), warm_start=s).converged


@pytest.mark.parametrize("kind", ["line", "hold", "control", "at_rest"])
@pytest.mark.parametrize("scheme", ["midpoint", "heun"])
def test_guesses_have_the_guessed_duration(kind: str, scheme: str) -> None:
    formulation = formulate(pendulum(scheme))
    iterate, _ = plain_guess(kind, formulation)
    motion = formulation.motion_of(iterate)
    assert np.allclose(motion.dts, FREE["guess"] / 24)
    assert motion.us.shape == (24, 2)


def test_units_of_time_and_cost_change_nothing() -> None:
    """A cost of a millionth and one of a million times the size have the same optimum."""
    s = solved(pendulum())
    for factor in (1e-6, 1e6):
        other = solved(pendulum(cost={"time": factor, "effort": 0.1 * factor}))
        assert other.duration == pytest.approx(s.duration, rel=1e-6)
        assert other.cost == pytest.approx(factor * s.cost, rel=1e-6)


def test_terms_that_depend_on_the_time_see_the_one_that_is_found() -> None:
    """The integral of t from 0 to T, by the midpoint rule exact, beside the effort."""

    def clock(k: Any) -> Any:
        return k.t

    own = running_cost(clock)
    s = solved(pendulum(cost={"time": 0.0}, terms=(own,)))
    from_effort = 0.05 * float((s.us**2).sum()) * s.duration / s.num_steps
    assert s.cost == pytest.approx(from_effort + s.duration**2 / 2, rel=1e-9)
    assert mean_hamiltonian(s) > 0.01  # the time is in it: it is no constant


def test_phases_have_lengths_of_their_own() -> None:
    """Steps of two phases, in programmes: each is uniform, and both together cost no more than one."""
    formulation = formulate(pendulum())
    programme = formulation.programme
    rho = programme.rho.reshape(24, -1).copy()
    assert rho[:, -1].tolist() == begins_phase(24).tolist()
    rho[:, -1] = begins_phase(24, (0, 8))
    two = replace(programme, rho=rho.ravel())
    settings = SolverSettings.of(formulation.problem.solver, two, has_inequalities=True)
    guess = plain_guess("line", formulation)[0]
    one = run_strategy(settings, Start(programme, guess)).result
    result = run_strategy(settings, Start(two, one.iterate)).result
    dts = formulation.motion_of(result.iterate).dts
    assert str(result.status) == "converged"
    assert np.allclose(dts[:8], dts[0], rtol=1e-10)
    assert np.allclose(dts[8:], dts[8], rtol=1e-10)
    assert abs(dts[8] / dts[0] - 1) > 1e-3
    assert result.record.cost < one.record.cost


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"duration": {"min": 0.5}}, "max is missing"),
        ({"duration": {"min": 2.0, "max": 1.0}}, "horizon.duration.max: got 1.0"),
        ({"duration": {"min": 0.0, "max": 1.0}}, "horizon.duration.min: got 0.0"),
        ({"duration": {"min": 1.0, "max": 2.0, "guess": 3.0}}, "horizon.duration.guess: got 3.0"),
        ({"duration": {"min": 1.0, "max": 2.0, "gues": 1.5}}, "unknown key 'gues'"),
        ({"solver": {"method": "fbsm_newton"}}, '"fbsm_newton", which cannot find a free duration'),
        ({"solver": {"method": "fbsm_bb+monolithic"}}, "which cannot find a free duration"),
        ({"solver": {"globalisation": "none"}}, "finds no free duration"),
        ({"coordinates": "natural"}, "natural coordinates take steps of a given length"),
        ({"cost": {"tracking": 1.0, "target_file": "motion.csv"}}, "cost.target_file: a file says when"),
        ({"cost": {"time": -1.0}}, "cost.time: got -1.0"),
    ],
)
def test_what_has_no_free_duration_is_refused(words: dict[str, Any], message: str) -> None:
    with pytest.raises(MbocpError, match=re.escape(message)):
        pendulum(**words)


def test_a_start_that_fits_one_step_length_alone_is_refused() -> None:
    """SE2 corrects the start velocity of constrained systems by what the first step makes of it."""
    rod = load_problem(EXAMPLES / "paper" / "rigid_pendulum.toml")
    T, words = rod.duration, {"integrator": {"scheme": "se2"}, "solver": {"method": "auto"}}
    moving = rod.with_(duration={"min": T / 2, "max": 2 * T}, **words)
    if not moving.v_start.any():
        across = np.linalg.svd(rod.robot.constraint_jacobian(rod.q_start))[2][-1]
        moving = moving.with_(start={"v": 0.1 * across}, **words)
    with pytest.raises(InconsistentStart, match="leaves free"):
        formulate(moving)
    assert formulate(moving.with_(integrator={"scheme": "se1"})).programme.x_start[-1] == 1.0


def test_a_weight_of_time_asks_for_a_free_duration() -> None:
    with pytest.warns(mbocp.problem.ProblemWarning, match="cost.time: the duration is given"):
        pendulum(duration=1.0)


def test_problems_change_between_free_and_given() -> None:
    problem = pendulum()
    given = problem.with_(duration=2.0, cost={"time": 0.0}, solver={"method": "fbsm_newton"})
    assert (given.duration, given.duration_range) == (2.0, None)
    free = given.with_(duration={"min": 1.0, "max": 4.0}, solver={"method": "auto"})
    assert (free.duration, free.duration_range) == (2.0, (1.0, 4.0))
    assert free.with_(steps=7).duration_range == (1.0, 4.0)


@pytest.fixture(scope="module")
def oscillator(tmp_path_factory: pytest.TempPathFactory) -> mbocp.Robot:
    """1 kg on a spring of 1 N/m."""
    urdf = urdfs.robot(
        urdfs.link("base", None),
        urdfs.link("mass", 1.0),
        '<joint name="rail" type="prismatic"><parent link="base"/><child link="mass"/><axis xyz="1 0 0"/>'
        '<limit effort="1" velocity="100" lower="-100" upper="100"/></joint>',
    )
    spring = '[[spring_damper]]\nframes = ["mass", "base"]\nstiffness = 1.0\nlength = 0.0\n'
    return mbocp.load_robot(urdfs.write(tmp_path_factory.mktemp("oscillator"), urdf, spring))


@pytest.mark.parametrize(("weight", "is_light"), [(1.0, False), (1e-6, True), (0.0, False)])
def test_a_weight_of_time_that_chooses_nothing_is_told(oscillator, weight: float, is_light: bool) -> None:
    """A force holds the spring at both ends, so that effort alone wants a short way."""
    problem = mbocp.Problem.create(
        oscillator,
        {"min": 0.1, "max": 20.0, "guess": 4.0},
        30,
        start={"q": [1.0]},
        goal={"q": [2.0], "v": 0.0},
        cost={"time": weight},
    )
    s = solved(problem)
    assert ("the other terms choose the duration" in s.advice) is is_light
    if is_light:
        assert f"time is {weight * s.duration / s.cost:.1g} of the cost" in s.advice


@pytest.mark.parametrize(("begin", "hangs"), [(2.0, True), (1.9, False), (1.2, False)])
@pytest.mark.parametrize("steps", [50, 150])
def test_a_least_time_without_a_derivative_is_told(
    oscillator: mbocp.Robot, begin: float, hangs: bool, steps: int
) -> None:
    """From 2 to rest it takes pi, by one arc at the limit; a little less force has to swing once more."""
    problem = mbocp.Problem.create(
        oscillator,
        {"min": 0.1, "max": 20.0, "guess": 4.0},
        steps,
        start={"q": [begin]},
        goal={"q": [0.0], "v": 0.0},
        cost={"time": 1.0, "effort": 0.0},
        limits={"effort": 1.0},
        scheme="gauss2",
    )
    s = solved(problem)
    assert ("hangs on the limits of the controls" in s.advice) is hangs
    if not hangs:
        return
    told = re.search(r"changes it by ([0-9.]+) times .* by one of them, ([0-9.]+) s", s.advice)
    assert told is not None
    assert float(told[2]) == pytest.approx(s.duration / steps, rel=0.02)
    assert 0.0 < s.duration - np.pi < 1.1 * float(told[2])
    narrower = solved(problem.with_(limits={"effort": 1.0 - 1e-6}), warm_start=s)
    assert 1e6 * (narrower.duration / s.duration - 1.0) == pytest.approx(float(told[1]), rel=0.1)
