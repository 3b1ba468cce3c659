"""Errors that solutions tell: their orders, what is known of them, and where nothing is."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import mbocp
from mbocp.accuracy import accuracy_of, errors, follows_fast, with_accuracy
from mbocp.accuracy import flow as flows
from mbocp.exceptions import InvalidValue
from mbocp.formulation import Motion
from mbocp.solution import Accuracy, Solution
from mbocp.solution.later import retold
from tests.phases.test_holds import hits

EXAMPLES = Path(__file__).parents[2] / "examples"
LOCAL_ORDERS = {"se1": 2, "se2": 2, "midpoint": 3, "heun": 3, "rk4": 5}


def swing(scheme: str = "se1", steps: int = 40, **others: object) -> mbocp.Problem:
    words = {"goal": {"q": {"joint1": 1.0, "joint2": 0.6}, "v": 0}, **others}
    start = {"q": {"joint1": 0.3, "joint2": -0.2}}
    return mbocp.Problem.create(
        mbocp.load_robot("double_pendulum"), 1.0, steps, start=start, scheme=scheme, **words
    )


def solved(problem: mbocp.Problem) -> Solution:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return mbocp.solve(problem, check=True, accuracy=True)


@pytest.mark.parametrize("scheme", LOCAL_ORDERS)
def test_local_errors_have_the_order_of_the_scheme(scheme: str) -> None:
    cart_pole = mbocp.load_problem(EXAMPLES / "optima" / "cart_pole.toml").with_(scheme=scheme)
    coarse, fine = (solved(cart_pole.with_(num_steps=steps)).accuracy for steps in (100, 200))
    assert np.log2(coarse.local_error / fine.local_error) == pytest.approx(LOCAL_ORDERS[scheme], abs=0.15)
    assert fine.own_error < 0.02 * fine.local_error + 1e-10


def test_an_exact_step_has_no_error() -> None:
    """A mass under constant force: the midpoint rule is exact, and makes no energy."""
    problem = mbocp.load_problem(EXAMPLES / "optima" / "two_carts.toml").with_(scheme="midpoint")
    found = solved(problem).accuracy
    assert found.local_error < 1e-11
    assert abs(found.made_energy) < 1e-9
    assert found.replay_error < 1e-8


def test_made_energy_is_what_work_and_energy_differ_by() -> None:
    """Work of the controls along the replay of each step, by Simpson's rule on the flow."""
    problem = mbocp.load_problem(EXAMPLES / "optima" / "cart_pole.toml").with_(scheme="midpoint")
    solution = solved(problem)
    robot, flow = problem.robot, flows.Flow.of(problem.robot)
    qs, vs, us, dts = solution.qs, solution.vs, solution.us, np.diff(solution.t)
    energies = flow.energies(qs, vs)
    at_q, at_v = qs[:-1], vs[:-1]
    B = robot.actuation_matrix(qs[0])
    power = [np.einsum("ni,ni->n", at_v, us @ B.T)]
    for _ in range(8):
        at_q, at_v = flow.ends(at_q, at_v, us, dts / 8, 1)
        power.append(np.einsum("ni,ni->n", at_v, us @ B.T))
    work = dts * (np.array([1, 4, 2, 4, 2, 4, 2, 4, 1]) / 24.0 @ np.array(power))
    made = np.cumsum(np.diff(energies) - work)
    assert solution.accuracy.made_energy == pytest.approx(made[np.abs(made).argmax()], rel=1e-4)


def test_steps_make_no_energy_where_prescribed_velocities_leap() -> None:
    """Of fourth order: a drive goes on with another speed at each node, whatever the steps do."""
    unicycle = mbocp.load_problem(EXAMPLES / "so3" / "unicycle_pendulum.toml").with_(scheme="rk4")
    coarse, fine = (solved(unicycle.with_(num_steps=steps)).accuracy for steps in (50, 100))
    assert abs(fine.made_energy) < 1e-4 * fine.energy_range
    assert abs(fine.made_energy) < 0.1 * abs(coarse.made_energy)


def test_a_replay_tells_what_the_local_errors_come_to() -> None:
    """Of second order where the scheme is."""
    coarse, fine = (solved(swing("midpoint", steps)).accuracy for steps in (60, 120))
    assert np.log2(coarse.replay_error / fine.replay_error) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize(
    "name", ["loops/four_bar", "free_flyer/drone_flip", "so3/unicycle_pendulum", "paper/elastic_pendulum"]
)
def test_loops_attitudes_drives_and_springs_are_followed(name: str) -> None:
    found = solved(mbocp.load_problem(EXAMPLES / f"{name}.toml")).accuracy
    assert found.is_known
    assert 0.0 < found.local_error < 0.1
    assert found.own_error < 0.02 * found.local_error + 1e-10
    assert all([found.local_joint, found.way_joint, found.replay_joint])


def test_shares_say_whether_steps_are_too_long() -> None:
    assert not solved(swing("se1", 15)).accuracy.is_small
    assert solved(swing("rk4", 60)).accuracy.is_small
    assert Accuracy().is_small  # nothing is known against it
    assert math.isnan(Accuracy(sum_of_errors=0.0, way=0.0).share)


def test_a_way_that_is_round_off_has_no_share_of_errors() -> None:
    robot = mbocp.load_robot("double_pendulum", gravity=[0, 0, 0])
    qs = 1e-15 * np.random.default_rng(0).standard_normal((11, 2))
    found = accuracy_of(robot, Motion(qs, np.zeros((11, 2)), np.zeros((10, robot.nu)), np.full(10, 0.1)))
    assert 0.0 < found.local_error < 1e-13
    assert math.isnan(found.share)
    assert found.is_small


def test_what_is_not_finite_or_too_stiff_has_no_errors() -> None:
    problem = swing()
    solution = solved(problem)
    motion = Motion(solution.qs, solution.vs, solution.us, np.diff(solution.t))
    broken = dataclasses.replace(motion, vs=np.full_like(motion.vs, np.nan))
    assert not accuracy_of(problem.robot, broken).is_known
    wild = dataclasses.replace(motion, us=1e9 * motion.us, dts=10 * motion.dts)
    assert not accuracy_of(problem.robot, wild).is_known


def test_feedback_keeps_an_unstable_robot_near_its_motion() -> None:
    """Upright, errors of an open loop grow; those of the closed one stay those of a few steps."""
    problem = swing("midpoint", 40, cost={"effort": 0.01, "velocity": 1.0}).with_(
        start={"q": [np.pi - 0.2, 0.2]}, goal={"q": [np.pi + 0.2, 0.0]}
    )
    coarse, fine = (solved(problem.with_(num_steps=steps)).accuracy for steps in (40, 80))
    assert fine.tracked_error < fine.replay_error
    assert coarse.tracked_error > 2.0 * fine.tracked_error


def test_by_default_nobody_looks() -> None:
    assert not mbocp.solve(swing()).accuracy.is_known


def test_what_did_not_converge_is_not_looked_at() -> None:
    problem = swing(solver={"max_iterations": 1})
    assert not mbocp.solve(problem, accuracy=True).accuracy.is_known


def test_small_robots_are_followed_without_being_asked() -> None:
    problem = swing()
    assert follows_fast(problem)
    assert mbocp.solve(problem, accuracy=None).accuracy.is_known
    assert follows_fast(mbocp.load_problem(EXAMPLES / "legged" / "solo12_trot.toml"))
    large = mbocp.load_problem(EXAMPLES / "loops" / "stewart.toml")
    assert not follows_fast(large)


def test_what_is_held_is_followed() -> None:
    """Where the tip of a pendulum hits a wire, slides and leaves it, replays are of the order of midpoint."""
    coarse, fine = (solved(on_a_wire(finer)).accuracy for finer in (4, 8))
    assert np.log2(coarse.replay_error / fine.replay_error) == pytest.approx(2.0, abs=0.2)
    assert np.log2(coarse.tracked_error / fine.tracked_error) == pytest.approx(2.0, abs=0.2)
    assert fine.local_error < coarse.local_error / 4.0
    assert fine.own_error < 0.02 * fine.local_error


def on_a_wire(finer: int, **more: object) -> mbocp.Problem:
    phases = hits(scheme="midpoint").phase
    return hits(*({"steps": finer * phase.steps} for phase in phases), scheme="midpoint", **more)


def test_files_and_json_carry_it(tmp_path: Path) -> None:
    solution = solved(swing())
    again = Solution.load(solution.save(tmp_path / "swing.h5"))
    np.testing.assert_equal(dataclasses.asdict(again.accuracy), dataclasses.asdict(solution.accuracy))
    written = json.loads(solution.to_json())["accuracy"]
    assert written["local_error"] == solution.accuracy.local_error
    assert json.loads(mbocp.solve(swing()).to_json())["accuracy"] is None


def test_infinite_replays_are_stored(tmp_path: Path) -> None:
    solution = solved(swing())
    wild = dataclasses.replace(
        solution, accuracy=dataclasses.replace(solution.accuracy, replay_error=math.inf)
    )
    assert Solution.load(wild.save(tmp_path / "wild.h5")).accuracy.replay_error == math.inf
    assert json.loads(wild.to_json())["accuracy"]["replay_error"] is None


def test_a_foreign_value_in_the_file_is_refused() -> None:
    from mbocp.solution.checked import read_records

    with pytest.raises(InvalidValue, match="Accuracy 0"):
        read_records(Accuracy, [{"local_error": "much"}])


def test_the_summary_tells_it(capsys: pytest.CaptureFixture[str]) -> None:
    from mbocp.cli.solution_summary import print_summary

    problem = swing("se1", 15)
    print_summary(solved(problem), problem)
    said = capsys.readouterr().out
    assert said.splitlines()[1].startswith("coarse")
    assert "a step is wrong by" in said
    assert "the steps make" in said or "the steps lose" in said
    beside = r"work .* J by the controls, braking left out; the steps \w+ .* J beside it"
    assert re.search(beside, " ".join(said.split()))
    print_summary(mbocp.solve(problem), problem)
    assert "a step is wrong by" not in capsys.readouterr().out
    print_summary(solved(swing("gauss2", 60)), problem)
    assert "braking left out\n" in capsys.readouterr().out


@pytest.mark.parametrize(("left_over", "expected"), [(0.3, 0.5), (1e3, math.inf)])
def test_replays_are_followed_until_two_digits_stay(left_over: float, expected: float) -> None:
    """What one part of a step leaves over falls with the parts; where it stays too large, nothing is told."""
    course = SimpleNamespace(flow=SimpleNamespace(differences=np.subtract))
    motion = SimpleNamespace(qs=np.zeros((2, 1)), vs=np.zeros((2, 1)))
    missed = errors._miss(course, lambda parts: np.array([0.5 + left_over / parts**2]), motion, 1, 6)  # type: ignore[arg-type]
    assert missed == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("own", "expected"), [(0.0, 1), (1e-16, 1), (2.5e-14, 1), (2.6e-14, 2), (1e-6, 5)])
def test_parts_are_halved_until_the_flow_is_exact(own: float, expected: int) -> None:
    """Each halving makes the flow 2^8 times as exact."""
    assert errors._useful_halvings(own, 1) == expected


@pytest.mark.parametrize(("parts", "expected"), [(2, 5), (16, 2), (64, 0)])
def test_parts_are_not_shorter_than_the_shortest(parts: int, expected: int) -> None:
    assert errors._useful_halvings(1e-6, parts) == expected


def test_a_step_that_is_wrong_by_far_is_no_motion() -> None:
    """By a scheme of order one the velocities tell; no joint turns by 1 rad in a step."""
    coarse = mbocp.solve(swing("se1", 5, goal={"q": [2.2, -1.5], "v": 0}, cost={"effort": 1.0}))
    assert coarse.status == "under_resolved"
    finer = mbocp.solve(swing("se1", 8, goal={"q": [2.2, -1.5], "v": 0}, cost={"effort": 1.0}))
    assert finer.converged
    assert re.search(r"; the step to t = .* s is wrong by 0\.\d+ rad at joint", finer.advice)
    assert re.match(r"the step to t = 0\.8 s is wrong by 0\.56 rad at joint2", coarse.advice)


def test_other_controls_than_those_of_the_motion_are_no_motion() -> None:
    """By other schemes the flow tells."""
    problem, never = swing("midpoint", 12), math.inf
    found = mbocp.solve(problem, check=True)
    assert with_accuracy(problem, found, never).converged
    told = with_accuracy(problem, retold(found, us=found.us + 50.0), never)
    assert told.status == "under_resolved"
    assert re.match(r"the step to t = .* is wrong by .* rad at joint", told.advice)
    told = with_accuracy(problem, retold(found, us=found.us + 0.3), never)
    assert 0.1 < told.accuracy.local_error < 0.4
    assert told.converged
    assert told.advice.startswith(f"{found.advice}; the step to t = ")


@pytest.mark.parametrize(("scheme", "steps"), [("lobatto2", 8), ("heun", 9)])
def test_a_wrong_step_of_any_order_is_told(scheme: str, steps: int) -> None:
    """By the flow of the longest steps; status and words are those of order one."""
    problem = swing(scheme, steps, goal={"q": [2.2, -1.5], "v": 0}, cost={"effort": 1.0})
    found = mbocp.solve(problem)
    told = re.search(r"the step to t = .* s is wrong by ([\d.]+) rad at joint", found.advice)
    exact = mbocp.solve(problem, accuracy=True)
    assert told
    assert float(told[1]) == pytest.approx(exact.accuracy.local_error, rel=0.05)
    assert exact.advice.count("the step to t = ") == 1
    assert "is wrong by" not in mbocp.solve(problem.with_(num_steps=60)).advice


def test_velocities_tell_what_a_step_of_order_one_is_wrong_by() -> None:
    found = solved(swing("se1"))
    told = 0.5 * np.abs(np.diff(found.vs, axis=0)).max() * found.t[1]
    assert told == pytest.approx(found.accuracy.local_error, rel=0.1)
