"""The lattice as a study: the same as the example's file, and solved end to end."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from mbocp_papers.so3 import CHOICES, FORMULATIONS, lattice
from mbocp_papers.so3.data import formulation
from mbocp_papers.so3.experiment import (
    SOLVERS,
    Lattice,
    example_file,
    lattice_study,
    parse_lattice,
    task_problem,
)
from mbocp_papers.so3.outcomes import UPRIGHT, outcomes_of, turn_from_upright

from mbocp.exceptions import InvalidValue
from mbocp.study import Study, run_study
from mbocp.study.run_task import make_problem


def test_the_study_is_the_example() -> None:
    example = Study.load(example_file("lattice.toml"))
    assert lattice_study().digest == example.digest
    assert len(example) == 6 * 2028
    assert example.groups == ("formulation",)


def test_the_tasks_are_those_of_the_data() -> None:
    study = lattice_study(Lattice(3, 4))
    tasks = lattice(3, 4)
    assert len(study) == 6 * len(tasks)
    for index, task in enumerate(tasks):
        for one, place in zip(FORMULATIONS, range(6), strict=True):
            found = study.task(6 * index + place)
            assert found.values["formulation"] == one.label
            assert found.overrides["robot.rotations"] == one.rotations
            assert found.overrides["integrator.lie"] == one.lie
            assert math.isclose(found.overrides["goal.q.base_x"], task.x, abs_tol=1e-15)
            assert math.isclose(found.overrides["goal.q.base_y"], task.y, abs_tol=1e-15)
            assert math.isclose(found.overrides["goal.q.yaw"], task.yaw, abs_tol=1e-15)


@pytest.mark.parametrize("solver", SOLVERS)
def test_problems_have_the_choices(solver: str) -> None:
    study = lattice_study(Lattice(2, 2), solver=solver)
    problem = make_problem(study.job, study.task(5).overrides)
    assert problem.solver.method == solver
    assert problem.robot.rotations == "dcm"
    assert problem.lie == "munthe_kaas"
    assert (problem.num_steps, problem.duration) == (100, 3.0)
    assert np.allclose(problem.cost.control_rate, 2 * CHOICES.k_3)
    assert problem.cost.potential == -CHOICES.k_2
    weights = problem.cost.tracking * np.asarray(problem.cost.tracking_weights)[:6]
    assert np.allclose(weights, [2 * CHOICES.c_x, 2 * CHOICES.c_y, 0, 0, 0, 2 * CHOICES.c_theta])
    assert np.allclose(problem.limits.u_upper, [CHOICES.yaw_rate, CHOICES.acceleration])
    assert problem.guess.kind == "line"
    assert problem.goal.redundant == "drop"
    assert problem.goal.guard


def test_the_variant_as_printed() -> None:
    study = lattice_study(Lattice(2, 2), variant="as_printed", solver="ipopt")
    problem = make_problem(study.job, study.task(0).overrides)
    assert problem.goal.redundant == "keep"
    assert not problem.goal.guard
    assert problem.guess.kind == "at_rest"


def test_words_of_a_lattice() -> None:
    assert parse_lattice("13x13x12") == Lattice()
    assert str(Lattice()) == "13x13x12"
    assert parse_lattice("1x1x1").num_tasks == 1
    assert len(lattice_study(Lattice(1, 1))) == 6
    with pytest.raises(InvalidValue, match="--lattice: got 13x12, expected places along x"):
        parse_lattice("13x12")
    with pytest.raises(InvalidValue, match="got 0x0x4"):
        parse_lattice("0x0x4")
    with pytest.raises(InvalidValue, match="as many places along x as along y"):
        parse_lattice("5x4x4")


def test_unknown_words_are_refused() -> None:
    with pytest.raises(InvalidValue, match="variant: got printed, expected one of corrected, as_printed"):
        lattice_study(variant="printed")
    with pytest.raises(InvalidValue, match="solver: got snopt"):
        lattice_study(solver="snopt")


def test_the_figures_task() -> None:
    problem = task_problem(formulation("DCM RK+BG"))
    x, y, *pendulum, yaw = problem.goal.q
    assert (x, y, yaw) == (0.5, 0.5, math.pi)
    assert pendulum == [0, 0, 0, 1]
    assert (problem.robot.rotations, problem.lie) == ("dcm", "baumgarte")


def test_a_small_lattice_from_end_to_end(tmp_path: Path) -> None:
    """Four tasks with quaternions on the group: the shape of examples/so3/unicycle_pendulum.toml."""
    study = lattice_study(Lattice(2, 1), labels=["Q RK-MK"])
    result = run_study(study, tmp_path / "rows.jsonl", workers=1)
    outcomes = outcomes_of(result)
    (runs,) = outcomes.runs
    assert runs.ends == (UPRIGHT,) * 4
    assert runs.tasks.tolist() == [0, 1, 2, 3]
    assert outcomes.common.tolist() == [0, 1, 2, 3]
    assert outcomes.is_complete
    finals = result.column("q_final")
    assert np.allclose(finals[:, :2], [[-1, -1], [-1, 1], [1, -1], [1, 1]], atol=1e-7)
    assert max(turn_from_upright(q) for q in finals) < 1e-6
    assert result.column("manifold_drift_resimulated").max() < 1e-13
