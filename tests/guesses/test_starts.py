"""Several starts: every guess is solved, the best one is returned, and it does not matter by whom."""

from __future__ import annotations

import json
import os
import signal
import threading
from collections.abc import Callable
from contextlib import closing
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

import mbocp
from mbocp.cli.solution_summary import solution_rows
from mbocp.exceptions import ProblemFileError
from mbocp.formulation import formulate
from mbocp.guesses import several
from mbocp.guesses.starts import guesses_in_turn, start_guesses
from mbocp.guesses.ways import branch_ways, middle_of_line, random_way, straight, turn_ways
from mbocp.job import Job
from mbocp.problem.goals.frames import pose_errors
from mbocp.programme import library
from mbocp.solvers import SolverSettings, Start, Status
from mbocp.solvers.strategies.elsewhere import Elsewhere, ElsewhereError
from mbocp.solvers.strategies.strategy import run_elsewhere

DRONE = {"name": "hector", "actuated": ["root_joint"]}


def pendulum(**solver: object) -> mbocp.Problem:
    return mbocp.Problem.create(
        "double_pendulum",
        3.0,
        60,
        goal={"q": [2.5, 2.0], "v": [0, 0]},
        cost={"velocity": 0.0},
        solver={"starts": 5, **solver},
        scheme="se1",
    )


def from_starts(problem: mbocp.Problem, callback: Callable | None = None, **options: object) -> tuple:
    job = Job.of(problem, callback=callback)
    return several.solve_from_starts(job, [(None, formulate(problem))], [], **options)[1:]


def test_the_best_of_all_starts_is_the_solution():
    solution = mbocp.solve(pendulum())
    assert solution.converged
    assert len(solution.starts) == 5
    costs = [start.cost for start in solution.starts if start.status is Status.CONVERGED]
    assert solution.cost == pytest.approx(min(costs), rel=1e-9)
    assert min(costs) < 0.99 * max(costs)  # these starts lead to different minima
    alone = mbocp.solve(pendulum(starts=1))
    assert not alone.starts
    assert solution.starts[0].cost == pytest.approx(alone.cost, rel=1e-9)
    chosen = next(start for start in solution.starts if start.cost == solution.cost)
    assert solution.guess_used == chosen.guess
    assert solution.iterations == chosen.iterations == sum(not r.is_guess for r in solution.history)


def test_nobody_can_tell_how_many_processes_there_were(monkeypatch):
    problem = pendulum()
    shown, shown_shared = [], []
    alone, words, records = from_starts(problem, shown.append, workers=1)
    monkeypatch.setattr(several, "_PATIENCE", 0.0)
    shared, words_shared, records_shared = from_starts(problem, shown_shared.append, workers=3)
    assert (words, records) == (words_shared, records_shared)
    assert sorted((r.phase, r.iteration, r.cost) for r in shown) == sorted(
        (r.phase, r.iteration, r.cost) for r in shown_shared
    )
    for name in ("xs", "us", "ms", "eta"):
        assert np.array_equal(getattr(alone.result.iterate, name), getattr(shared.result.iterate, name))


def test_another_process_gives_the_same_and_its_death_is_no_harm(monkeypatch):
    problem = pendulum(starts=2)
    formulation = formulate(problem)
    guess = start_guesses(formulation, None)[0]
    settings = SolverSettings.of(problem.solver, formulation.programme)
    task = partial(run_elsewhere, settings, Start(formulation.programme, guess.iterate))
    with closing(Elsewhere()) as process:
        there = process.run(task)
        here = mbocp.solve(pendulum(starts=1))
        assert there.result.record.cost == here.cost
        assert there.result.advice in here.advice
        os.kill(process._process.pid, signal.SIGKILL)
        with pytest.raises(ElsewhereError):
            process.run(task)
    monkeypatch.setattr(several, "_PATIENCE", 0.0)
    monkeypatch.setattr(Elsewhere, "run", _refuse)
    outcome, _, records = from_starts(problem, workers=2)
    assert outcome.result.status is Status.CONVERGED
    assert len(records) == 2


def _refuse(*_: object) -> None:
    raise ElsewhereError("gone")


def test_words_for_rows_survive_the_way_to_another_process():
    formulation = formulate(pendulum())
    programme = formulation.programme
    assert programme.describe_row(3, 0) == "kinematics of joint1 in the step to t = 0.2 s"
    settings = SolverSettings.of(pendulum(max_iterations=1).solver, programme)
    with closing(Elsewhere()) as process:
        start = Start(programme, start_guesses(formulation, None)[1].iterate)
        found = process.run(partial(run_elsewhere, settings, start))
    assert "largest violation: end condition 1 (joint1) at t = 3 s" in found.result.advice


def test_the_seed_changes_random_starts_alone():
    def guesses(seed: int) -> list:
        return start_guesses(formulate(pendulum(seed=seed)), None)

    first, again, other = guesses(0), guesses(0), guesses(1)
    assert [g.words for g in first] == [g.words for g in other]
    assert [g.kind for g in first] == ["line", "hold", "control", "", ""]
    for old, new in zip(first, again, strict=True):
        assert np.array_equal(old.iterate.xs, new.iterate.xs)
    same = [np.array_equal(a.iterate.xs, b.iterate.xs) for a, b in zip(first, other, strict=True)]
    assert same == [True, True, True, False, False]


def test_a_guess_that_was_asked_for_comes_first():
    problem = pendulum(starts=2).with_(guess={"kind": "hold"})
    assert [guess.kind for guess in start_guesses(formulate(problem), None)] == ["hold", "line"]


def test_a_warm_start_comes_first():
    saved = mbocp.solve(pendulum(starts=1))
    solution = mbocp.solve(pendulum(starts=2), warm_start=saved)
    assert solution.starts[0].guess == "warm start from a solution"
    assert solution.starts[0].iterations <= 2


def test_files_json_and_summary_tell_of_all_starts(tmp_path):
    solution = mbocp.solve(pendulum(starts=3))
    loaded = mbocp.Solution.load(solution.save(tmp_path / "result.h5"))
    assert loaded.equals(solution)
    assert loaded.starts == solution.starts
    table = json.loads(solution.to_json())["starts"]
    assert [row["cost"] for row in table] == [start.cost for start in solution.starts]
    row = dict(solution_rows(solution, ""))["starts"]
    first, *lines = str(row).splitlines()
    assert first.startswith(f"number {1 + [s.cost for s in solution.starts].index(solution.cost)} of 3 ")
    assert len(lines) == len({f"{start.cost:.6g}" for start in solution.starts})
    assert "starts = 3" in solution.problem_text


def test_nothing_is_compiled_for_further_starts(monkeypatch):
    mbocp.solve(pendulum(starts=1))

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("compiled anew")

    monkeypatch.setattr(library, "run_compiler", refuse)
    assert mbocp.solve(pendulum(starts=4)).converged


@pytest.mark.parametrize(("key", "value"), [("starts", 0), ("starts", 1.5), ("seed", -1)])
def test_numbers_that_cannot_be_are_refused(key, value):
    with pytest.raises(ProblemFileError, match=f"solver.{key}"):
        pendulum(**{key: value})


def test_ctrl_c_in_a_later_start_returns_the_best_so_far(monkeypatch):
    monkeypatch.setattr(several, "available_threads", lambda: 1)

    def callback(record: mbocp.solution.IterationRecord) -> None:
        if "start 3" in record.phase:
            raise KeyboardInterrupt

    solution = mbocp.solve(pendulum(), callback=callback)
    assert solution.status is Status.INTERRUPTED
    assert [start.status for start in solution.starts[:2]] == [Status.CONVERGED] * 2
    assert len(solution.starts) == 3


def test_ctrl_c_ends_processes_in_their_midst(monkeypatch):
    monkeypatch.setattr(several, "_PATIENCE", 0.0)
    monkeypatch.setattr(several, "available_threads", lambda: 3)
    ended: list[Elsewhere] = []
    run = Elsewhere.run

    def run_and_note(process: Elsewhere, task: object) -> object:
        in_process.set()
        try:
            return run(process, task)
        finally:
            ended.append(process)

    def callback(record: mbocp.solution.IterationRecord) -> None:
        assert in_process.wait(60.0)
        raise KeyboardInterrupt

    in_process = threading.Event()
    monkeypatch.setattr(Elsewhere, "run", run_and_note)
    solution = mbocp.solve(pendulum(), callback=callback)
    assert solution.status is Status.INTERRUPTED
    assert len(solution.starts) < 5
    assert ended
    assert all(process.is_over for process in ended)


def test_where_no_start_converges_the_other_kinds_follow():
    solution = mbocp.solve(pendulum(starts=2, max_iterations=1))
    assert not solution.converged
    assert len(solution.starts) == 3


def drone() -> mbocp.Problem:
    turned = [0.0, 0.0, np.sin(0.6), np.cos(0.6)]
    return mbocp.Problem.create(
        DRONE,
        1.0,
        30,
        goal={"q": [1.0, 0.5, 0.2, *turned], "v": [0] * 6},
        cost={"velocity": 10.0},
        solver={"starts": 5},
        scheme="se1",
    )


def test_a_free_flyer_turns_the_other_way_around_to_the_same_place():
    problem = drone()
    ((words, way),) = turn_ways(formulate(problem))
    assert words == "line, root_joint the other way around"
    shares = np.linspace(0.0, 1.0, 50)
    qs = way(problem.q_start, shares)
    robot = problem.robot
    assert np.abs(robot.difference(qs[-1], problem.goal.q)).max() < 1e-12
    turns = np.array([robot.difference(a, b)[5] for a, b in pairwise(qs)])
    assert turns.sum() == pytest.approx(1.2 - 2 * np.pi)
    assert (turns < 0.0).all()


def test_starts_of_a_free_flyer_stay_on_the_group_and_converge():
    guesses = start_guesses(formulate(drone()), None)
    for guess in guesses:
        quaternions = guess.iterate.xs[:, 3:7]
        assert np.abs(np.linalg.norm(quaternions, axis=1) - 1.0).max() < 1e-12
    assert mbocp.solve(drone()).converged


def test_random_ways_keep_loops_closed_and_lead_to_the_goal():
    problem = mbocp.load_problem("examples/loops/four_bar.toml")
    robot, shares = problem.robot, np.linspace(0.0, 1.0, 41)
    direct = straight(problem)(problem.q_start, shares)
    for seed in range(3):
        qs = random_way(problem, np.random.default_rng(seed))(problem.q_start, shares)
        assert max(np.abs(robot.constraint_residual(q)).max() for q in qs) < 1e-9
        assert np.abs(robot.difference(qs[-1], problem.goal.q)).max() < 1e-6
        assert np.abs(qs - direct).max() > 1e-2
        known = random_way(problem, np.random.default_rng(seed), middle=middle_of_line(problem))
        assert np.array_equal(known(problem.q_start, shares), qs)
    assert not list(turn_ways(formulate(problem)))


def test_random_ways_stay_within_limits():
    limits = {"position": {"joint1": [-0.5, 3.0], "joint2": [-0.5, 2.5]}}
    problem = pendulum().with_(limits=limits)
    for seed in range(5):
        qs = random_way(problem, np.random.default_rng(seed))(problem.q_start, np.linspace(0.0, 1.0, 21))
        assert (qs >= problem.limits.q_lower).all()
        assert (qs <= problem.limits.q_upper).all()
    assert mbocp.solve(problem).converged


def test_starts_in_natural_coordinates():
    problem = mbocp.Problem.create(
        {"name": "double_pendulum", "damping": False},
        1.5,
        40,
        goal={"q": [2.0, -1.0], "v": [0, 0]},
        coordinates="natural",
        solver={"starts": 4},
        scheme="se1",
    )
    assert {words for words, _ in turn_ways(formulate(problem))} == {
        "line, joint1 the other way around",
        "line, joint2 the other way around",
    }
    solution = mbocp.solve(problem)
    assert solution.converged
    assert len(solution.starts) == 4


def test_a_stopped_batch_leaves_no_process(monkeypatch):
    monkeypatch.setattr(several, "_PATIENCE", 0.0)
    made: list[Elsewhere] = []
    monkeypatch.setattr(several, "Elsewhere", lambda: made.append(Elsewhere()) or made[-1])
    from_starts(pendulum(), workers=2)
    assert all(p._process is None or p._process.poll() is not None for p in made)


ARM = """
<robot name="two_links"><link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.5"/><mass value="1"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0 0 0.5"/><mass value="1"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tip"/>
  <joint name="joint1" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="1 0 0"/>
    <limit lower="-9" upper="9" effort="99" velocity="99"/></joint>
  <joint name="joint2" type="revolute"><parent link="upper"/><child link="lower"/><axis xyz="1 0 0"/>
    <origin xyz="0 0 1"/><limit lower="-9" upper="9" effort="99" velocity="99"/></joint>
  <joint name="hand" type="fixed"><parent link="lower"/><child link="tip"/><origin xyz="0 0 1"/></joint>
</robot>
"""


def test_a_frame_is_approached_in_other_configurations_of_the_arm(tmp_path):
    """The tool of two links reaches a point with the elbow on either side, after any number of turns."""
    file = tmp_path / "two_links.urdf"
    file.write_text(ARM)
    problem = mbocp.Problem.create(
        str(file),
        2.0,
        50,
        start={"q": [0.3, 0.3]},
        goal={"frame": {"name": "tip", "y": 1.0, "z": 0.8}, "v": [0, 0]},
        solver={"starts": 6},
        scheme="se1",
    )
    formulation = formulate(problem)
    ways = [*branch_ways(problem), *turn_ways(formulation)]
    assert [words for words, _ in ways] == [
        "line to configuration 2 of 2 at the goal",
        "line, joint2 the other way around",
        "line, joint1 the other way around",
    ]
    for _, way in ways:
        end = way(problem.q_start, np.array([0.0, 1.0]))[-1]
        errors = pose_errors(problem.robot, problem.goal, end)
        assert errors.positions.max() < 1e-8
        assert np.abs(end - problem.goal.q).max() > 0.1
    solution = mbocp.solve(problem)
    assert solution.converged
    assert solution.starts[1].guess == "line to configuration 2 of 2 at the goal"


def test_where_one_start_fails_other_configurations_at_the_goal_follow(tmp_path):
    file = tmp_path / "two_links.urdf"
    file.write_text(ARM)
    goal = {"frame": {"name": "tip", "y": 1.0, "z": 0.8}, "v": [0, 0]}
    problem = mbocp.Problem.create(str(file), 2.0, 50, start={"q": [0.3, 0.3]}, goal=goal, scheme="se1")
    names = [name for name, _ in guesses_in_turn(formulate(problem), None)]
    assert names == ["line", "line to configuration 2 of 2 at the goal", "hold", "control"]
    named = problem.with_(guess={"kind": "line"})
    assert [name for name, _ in guesses_in_turn(formulate(named), None)] == ["line"]
    failing = mbocp.solve(problem.with_(solver={"max_iterations": 1}))
    assert [phase.name for phase in failing.phases if "configuration 2" in phase.name]
