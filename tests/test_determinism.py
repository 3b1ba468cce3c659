"""The same problem gives the same bits: again, in other processes, with any number of threads and workers."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.study import Study, run_study

REST = [0.0, 0.0]


def pendulum(**others: Any) -> mbocp.Problem:
    return mbocp.Problem.create(
        "double_pendulum",
        1.5,
        40,
        goal={"q": [2.0, -1.0], "v": REST},
        cost={"velocity": 0.01},
        **{"integrator": {"scheme": "se1"}, **others},
    )


def four_bar() -> mbocp.Problem:
    return mbocp.Problem.create(
        "four_bar", 1.0, 30, goal={"q": {"crank": 2.5}, "v": [0, 0, 0]}, scheme="midpoint"
    )


PROBLEMS = {
    "without limits": pendulum,
    "with limits": lambda: pendulum(limits={"effort": 0.6, "velocity": 4.0}),
    "by IPOPT": lambda: pendulum(limits={"effort": 0.6}, solver={"method": "ipopt"}),
    "by sweeps": lambda: pendulum(solver={"method": "fbsm_newton"}),
    "a loop": four_bar,
}
_TIMES = ("wall_time_s", "phases", "history")


def digest(solution: mbocp.Solution) -> str:
    """SHA-256 of all that is not a time, and of the history without its times."""
    found = hashlib.sha256()
    for field in fields(solution):
        value = getattr(solution, field.name)
        if field.name not in _TIMES:
            found.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
    for record in solution.history:
        found.update(repr((record.cost, record.residual, record.increment, record.step_length)).encode())
    return found.hexdigest()


def digest_of(solution: mbocp.Solution, other: mbocp.Solution) -> str:
    """That of a solution as if it had been asked for with the options of another one."""
    return digest(replace(solution, problem_text=other.problem_text, options=other.options))


@pytest.mark.parametrize("name", PROBLEMS)
def test_solved_twice(name: str) -> None:
    first, second = (mbocp.solve(PROBLEMS[name](), check=True) for _ in range(2))
    assert digest(first) == digest(second)
    assert digest(first) != digest(mbocp.solve(PROBLEMS[name]().with_(duration=1.3)))


def test_solved_in_other_processes_with_one_and_two_threads() -> None:
    here = [digest(mbocp.solve(make())) for make in PROBLEMS.values()]
    code = (
        "import mbocp; from tests.test_determinism import PROBLEMS, digest; "
        "print(*(digest(mbocp.solve(make())) for make in PROBLEMS.values()))"
    )
    threads = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    others = [
        subprocess.Popen(
            [sys.executable, "-c", code],
            env={**os.environ, **dict.fromkeys(threads, number)},
            cwd=Path(__file__).parents[1],
            stdout=subprocess.PIPE,
            text=True,
        )
        for number in ("1", "2")
    ]
    for other in others:
        out, _ = other.communicate(timeout=120)
        assert out.split() == here


def test_a_study_with_one_and_four_workers(tmp_path: Path) -> None:
    problem = {
        "robot": "double_pendulum",
        "horizon": {"duration": 1.5, "steps": 40},
        "goal": {"q": [2.0, -1.0], "v": REST},
        "cost": {"velocity": 0.01},
        "integrator": {"scheme": "se1"},
    }
    sample = {"count": 12, "goal.q": {"uniform": [[-2, -2], [2, 2]]}}
    study = Study.from_tables({"problem": problem, "sample": sample, "record": ["q_final", "u", "mu"]})
    rows = []
    for workers in (1, 4):
        result = run_study(study, tmp_path / f"{workers}.jsonl", workers=workers)
        rows.append([{k: v for k, v in row.items() if not k.endswith("time_s")} for row in result.rows])
    assert rows[0] == rows[1]
    assert len({str(row["record"]["u"]) for row in rows[0]}) == 12
