"""The short form of the campaign: what says converged is, and what cannot be solved never says so."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mbocp
from tests.campaign.classes import CLASSES, QUICK
from tests.campaign.robots import ROBOTS
from tests.campaign.run import motion_of, plan, read_rows, run_task
from tests.campaign.table import false_converged, show, worst
from tests.campaign.tasks import draw
from tests.checker import check_solution
from tests.checker.conditions import step_of

# These ask of a method of order four what others above ask of one of order one, and it is asked alone, too.
TWICE = ("rates_gauss2", "free_gauss2", "double_pendulum_gauss2")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in TWICE else []) for name in QUICK]
)
def test_random_tasks(name: str, tmp_path: Path) -> None:
    rows = [run_task(name, seed, tmp_path) for seed in range(2)]
    assert false_converged(rows) == []
    assert all(row["status"] not in ("crash", "refused") for row in rows), rows
    feasible = [row for row in rows if row["feasible"]]
    solved = ("converged", "under_resolved")  # the second: limits are left between nodes, and that is said
    assert all(row["status"] in solved for row in feasible), rows
    assert show(rows).count("\n") == 3
    assert "stationarity" in worst(rows)


@pytest.mark.parametrize(("name", "seed"), [("free_rk4", 43), ("rates_heun", 13), ("rates_heun", 2)])
def test_dynamics_that_amplify_leave_no_end_condition_out(name: str, seed: int, tmp_path: Path) -> None:
    """Random controls make these pendulums tumble: end conditions looked as if the dynamics implied them."""
    row = run_task(name, seed, tmp_path)
    assert (row["status"], row["failures"]) == ("converged", [])
    assert "left out" not in row["advice"]


def test_a_barrier_that_rose_at_a_huge_cost_falls_with_it(tmp_path: Path) -> None:
    """A system was singular where the cost was a billion times that of the optimum."""
    row = run_task("double_pendulum_stages", 91002, tmp_path)
    assert (row["status"], row["failures"]) == ("converged", [])
    assert row["residual"] <= 1e-8


def test_a_motion_in_another_configuration_is_found(tmp_path: Path) -> None:
    """The controls hold the arm folded alone, which the pose of the goal does not say."""
    row = run_task("double_pendulum_pose", 5, tmp_path)
    assert (row["status"], row["failures"]) == ("converged", [])


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        ("double_pendulum_gauss2", 33),
        pytest.param("free_gauss2", 11, marks=pytest.mark.slow),
        pytest.param("rates_gauss2", 10, marks=pytest.mark.slow),
        pytest.param("rates_gauss2", 28, marks=pytest.mark.slow),
    ],
)
def test_limits_that_hold_within_steps_are_among_the_optimality_conditions(
    name: str, seed: int, tmp_path: Path
) -> None:
    task = draw(name, seed, tmp_path)
    solution = mbocp.solve(mbocp.Problem.create(**task.tables))
    motion = motion_of(solution)
    within = [k for k, word in enumerate(motion.path_names) if word.endswith(" steps")]
    assert np.abs(motion.lam_path[:, within]).max() > 0.0
    assert check_solution(task.loaded.system, task.task, motion).failures == ()
    without = replace(motion, path_names=("",) * len(motion.path_names))
    assert "stationarity" in check_solution(task.loaded.system, task.task, without).failures


def impossible(name: str) -> list[int]:
    """Seeds of the first tasks of a class that nothing can solve."""
    return [seed for seed in range(120) if not draw(name, seed, Path()).is_feasible][:3]


def test_tasks_that_are_impossible_never_converge(tmp_path: Path) -> None:
    """A joint would have to be faster on average than it may be."""
    seeds = impossible("double_pendulum")
    assert seeds
    for seed in seeds:
        task = draw("double_pendulum", seed, tmp_path).task
        mean = np.abs(task.q_goal - task.q_start) / task.duration
        assert np.any(mean > task.v_limits[1])
        assert run_task("double_pendulum", seed, tmp_path)["status"] not in ("converged", "crash")


@pytest.mark.parametrize("name", QUICK)
def test_the_motion_behind_a_task_is_feasible(name: str, tmp_path: Path) -> None:
    task = draw(name, 2, tmp_path)
    system, w, t = task.loaded.system, task.witness, task.task
    system.choose_rows(t.q_start)
    step = step_of(system, t)
    for n in range(t.num_steps):
        x0, x1 = (np.concatenate([w.qs[k], w.vs[k]]) for k in (n, n + 1))
        rows, sizes = step.rows(x0, x1, step.multipliers(x0, x1, w.us[n]), w.us[n])
        assert np.abs(rows).max() < 1e-10 * (1 + sizes.max())
    if task.is_feasible:
        for values, (lower, upper) in ((w.us, t.u_limits), (w.vs, t.v_limits), (w.qs, t.q_limits)):
            assert np.all((values >= lower) & (values <= upper))


def test_tasks_are_reproducible_and_spread(tmp_path: Path) -> None:
    for name in ("acrobot", "double_pendulum_slow"):
        first, again, other = (draw(name, seed, tmp_path).task for seed in (4, 4, 5))
        np.testing.assert_array_equal(first.q_goal, again.q_goal)
        assert first.duration == again.duration != other.duration
    tasks = plan(2000)
    assert len(set(tasks)) == len(tasks)
    assert abs(len(tasks) - 2000) < 30
    assert {name for name, _ in tasks[: len(CLASSES)]} >= {c.name for c in CLASSES.values() if c.share >= 1}
    assert Counter(c.robot for c in CLASSES.values()).keys() == ROBOTS.keys()


def test_a_torn_last_line_is_left_out(tmp_path: Path) -> None:
    file = tmp_path / "rows.jsonl"
    file.write_text('{"class": "a", "seed": 1}\n{"class": "a", "se')
    assert read_rows(file) == [{"class": "a", "seed": 1}]
