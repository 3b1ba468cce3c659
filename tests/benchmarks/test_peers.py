"""The judge of the side-by-side benchmark sees what is wrong; its tasks are those of the files."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from benchmarks.peers import __main__ as peers
from benchmarks.peers.environments import Environment
from benchmarks.peers.judge import judge
from benchmarks.peers.task import Array, Task, load_task

PROBLEMS = Path(peers.__file__).parent / "problems"
NAMES = ("U", "U-lim", "F", "F-lim", "F-500", "Z", "D")


def task_of(name: str, folder: Path) -> Task:
    return load_task(peers._written(name, folder))


def rolled_out(task: Task, us: Array) -> tuple[Array, Array]:
    data, q, v = task.model.createData(), task.q0, np.zeros(task.model.nv)
    qs, vs = [q], [v]
    for u in us:
        v = v + task.dt * pin.aba(task.model, data, q, v, task.torque_map @ u)
        q = pin.integrate(task.model, q, task.dt * v)
        qs.append(q)
        vs.append(v)
    return np.array(qs), np.array(vs)


@pytest.mark.parametrize("name", NAMES)
def test_tasks_are_those_of_the_problem_files(name: str, tmp_path: Path) -> None:
    task, problem = task_of(name, tmp_path), mbocp.load_problem(PROBLEMS / f"{name}.toml")
    robot, rng = problem.robot, np.random.default_rng(3)
    assert (task.duration, task.num_steps) == (problem.duration, problem.num_steps)
    assert problem.scheme == "semi_implicit_euler"
    assert np.allclose(problem.q_start, task.q0)
    assert np.abs(pin.difference(task.model, task.goal, problem.goal.q)).max() < 1e-12
    assert np.all(np.asarray(problem.cost.velocity) == task.weight)
    assert np.all(np.asarray(problem.cost.effort) == 1.0)
    q, v = pin.integrate(task.model, task.q0, rng.standard_normal(robot.nv)), rng.standard_normal(robot.nv)
    u = rng.standard_normal(robot.nu)
    one = pin.aba(task.model, task.model.createData(), q, v, task.torque_map @ u)
    push = robot.actuation_matrix(q) @ u + robot.force_elements(q, v)
    other = pin.aba(robot.model, robot.model.createData(), q, v, push)
    assert np.abs(one - other).max() < 1e-9 * (1.0 + np.abs(one).max())
    assert task.is_limited == name.endswith("lim")


@pytest.mark.parametrize("name", ["U-lim", "D"])
def test_the_judge_sees_what_is_wrong(name: str, tmp_path: Path) -> None:
    whole = task_of(name, tmp_path)
    us = np.tile(0.97 * whole.holding(), (20, 1))
    task = replace(whole, num_steps=20, duration=0.2)
    qs, vs = rolled_out(task, us)
    near = replace(task, goal=qs[-1])
    found = judge(near, qs, vs, us)
    assert found.defect < 1e-12
    assert found.excess == 0.0
    assert found.end == pytest.approx(np.abs(vs[-1]).max(), rel=1e-9)
    cost = near.dt / 2 * (np.sum(us**2) + near.weight * np.sum(vs[:-1] ** 2))
    assert found.cost == pytest.approx(cost, rel=1e-12)
    assert found.rolled_cost == pytest.approx(cost, rel=1e-12)
    moved = vs.copy()
    moved[7] += 1e-3
    assert judge(near, qs, moved, us).defect > 5e-4
    assert judge(task, qs, vs, us).end > 0.1
    assert judge(near, qs, vs, np.full_like(us, np.nan)).error == np.inf
    if near.is_limited:
        assert judge(near, qs, vs, us + 60.0).excess > 1.0


def test_what_is_not_installed_is_named(tmp_path: Path) -> None:
    none = Environment(tmp_path / "python", {}, "not installed: no network")
    path = peers._written("U", tmp_path)
    tool = next(tool for tool in peers._TOOLS if tool.package == "crocoddyl")
    found = peers._solved(tool, none, load_task(path), path, 1, 1.0)
    table = peers._table(load_task(path), [found, found])
    assert found.verdict is None
    assert all("not installed: no network" in row[-1] for row in table.rows)


@pytest.mark.slow
@pytest.mark.parametrize("module", ["own:auto", "casadi_nlp:ipopt", "casadi_nlp:fatrop"])
def test_solvers_of_this_environment_reach_the_optimum(module: str, tmp_path: Path) -> None:
    path, out = peers._written("U", tmp_path), tmp_path / "out.npz"
    root = Path(__file__).parents[2]
    command = [sys.executable, "-m", "benchmarks.peers.tools.one", module, str(path), str(out), "1"]
    subprocess.run(command, check=True, cwd=root, env={**os.environ, "PYTHONPATH": str(root)})
    with np.load(out) as kept:
        found = judge(load_task(path), kept["qs"], kept["vs"], kept["us"])
    assert found.cost == pytest.approx(456.10444, abs=1e-5)
    assert found.error < 1e-7
