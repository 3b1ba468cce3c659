"""The command line with a solver that answers at once; the real one is tested with the solvers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import mbocp
from mbocp.cli.app import app
from mbocp.formulation import Motion
from mbocp.problem import Problem
from mbocp.solution import IterationRecord, Labels, Phase, Solution, Status
from mbocp.solution.goal_error import goal_error

ARM = """
robot = "ur5"
[horizon]
duration = 1.0
steps = 10
[goal]
q = [0.5, -1.2, 0.5, -0.3, 0.4, 0.2]
v = [0, 0, 0, 0, 0, 0]
"""

Run = Callable[..., Any]  # of arguments to what a CliRunner returns


def straight_line(problem: Problem, status: Status = Status.CONVERGED) -> Solution:
    """Make up a solution that goes straight to the goal."""
    robot, num = problem.robot, problem.num_steps
    t = np.linspace(0.0, problem.duration, num + 1)
    way = robot.difference(problem.q_start, problem.goal.q)
    qs = np.array([robot.integrate(problem.q_start, way * s) for s in np.linspace(0.0, 1.0, num + 1)])
    vs = np.zeros((num + 1, robot.nv))
    history = tuple(IterationRecord(k, 10.0**-k, 0.1, 12.5, 1.0, phase="monolithic") for k in range(4))
    return Solution(
        status=status,
        advice="all is well" if status is Status.CONVERGED else "try another guess",
        solver="monolithic",
        iterations=3,
        cost=12.5,
        residual=1e-12,
        increment=1e-13,
        unknowns=320,
        wall_time_s=0.25,
        phases=(Phase("compile", 0, 0.2), Phase("monolithic", 3, 0.05)),
        history=history,
        t=t,
        qs=qs,
        vs=vs,
        ps=vs,
        us=np.ones((num, robot.nu)),
        lams=np.zeros((num, robot.nc)),
        zetas=np.zeros((num, robot.nc)),
        mus=np.ones((num + 1, 2 * robot.nv)),
        control_hamiltonians=np.full(num, 3.0),
        control_momenta=np.full((num + 1, 1), -2.5),
        control_momentum_names=("rotation about z",),
        control_momentum_meanings=("adjoint mu_q of shoulder_pan_joint, a cyclic coordinate",),
        problem_name=problem.name,
        robot_name=robot.name,
        robot_spec=dict(robot.spec),
        guess_used="a straight line",
        goal_error=goal_error(problem, Motion(qs, vs, np.ones((num, robot.nu)), np.diff(t)), vs),
        versions={"mbocp": "0.1.0"},
        labels=Labels.of_robot(robot),
    )


class FakeSolver:
    """Takes the place of `mbocp.solve`."""

    def __init__(self) -> None:
        self.status = Status.CONVERGED
        self.error: BaseException | None = None
        self.problems: list[Problem] = []

    def __call__(
        self,
        problem: Problem,
        *,
        callback: Callable[[Any], object] | None = None,
        accuracy: bool | None = False,
    ) -> Solution:
        self.problems.append(problem)
        solution = straight_line(problem, self.status)
        for record in solution.history:
            if callback is not None:
                callback(record)
        if self.error is not None:
            raise self.error
        return solution


@pytest.fixture
def solver(monkeypatch: pytest.MonkeyPatch) -> FakeSolver:
    fake = FakeSolver()
    monkeypatch.setitem(vars(mbocp), "solve", fake)
    return fake


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with the arm's problem file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.toml").write_text(ARM)
    return tmp_path


@pytest.fixture
def run() -> Run:
    def invoke(*arguments: str) -> Any:
        return CliRunner().invoke(app, arguments, env={"COLUMNS": "200", "TERM": "dumb"})

    return invoke


@pytest.fixture
def result(folder: Path, run: Run, solver: FakeSolver) -> Path:
    """Leave a saved result."""
    assert run("solve", "arm.toml", "-o", "arm.h5", "-q").exit_code == 0
    return folder / "arm.h5"
