"""Running a study: the rows, what goes wrong in tasks, going on, executors."""

from __future__ import annotations

import json
import multiprocessing
from collections import OrderedDict
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import ProblemError, ResultFileError, StudyError, UnknownJoint
from mbocp.study import Study, StudyResult, StudyWarning, run_study
from mbocp.study import run_task as task_module
from mbocp.study.run_task import FIELDS, check_record, make_problem, solution_row

from . import callables
from .conftest import EXAMPLES, PENDULUM, MakeStudy

GOALS = [[0, 0, -5], [3, 0, -4], [0, 4, -3]]


def timeless(result: StudyResult) -> list[dict[str, Any]]:
    """Rows without what differs from run to run."""
    return [{k: v for k, v in row.items() if not k.endswith("time_s")} for row in result.rows]


def ends(result: StudyResult) -> list[str]:
    return result.column("status").tolist()


@pytest.fixture(scope="module")
def small() -> Study:
    tables = {
        "grid": {"goal.q": GOALS, "cost.effort": [0.5, 1.0]},
        "record": ["q_final", "v_final", "u", "eta"],
    }
    return Study.from_tables({"problem": PENDULUM, **tables})


@pytest.fixture(scope="module")
def solved(small: Study, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All rows of the small study, to be read and copied."""
    path = tmp_path_factory.mktemp("small") / "rows.jsonl"
    run_study(small, path)
    return path


def test_rows_say_what_the_solutions_say(small: Study, tmp_path: Path) -> None:
    seen: list[int] = []
    counts: list[tuple[int, int]] = []
    result = run_study(
        small,
        tmp_path / "rows.jsonl",
        workers=2,
        callback=lambda row: seen.append(row["index"]),
        progress=lambda done, total: counts.append((done, total)),
    )
    assert result.is_complete
    assert sorted(seen) == list(range(6))
    assert counts == [(n, 6) for n in range(7)]
    for task, row in zip(small.tasks(), result.rows, strict=True):
        problem = make_problem(small.job, task.overrides)
        solution = mbocp.solve(problem)
        assert set(row) == {"index", "values", *FIELDS, "record"}
        assert (row["index"], row["values"]) == (task.index, task.values)
        assert (row["status"], row["converged"], row["message"]) == ("converged", True, "")
        assert row["iterations"] == solution.iterations
        for name in ("cost", "residual", "constraint_violation"):
            assert row[name] == getattr(solution, name)
        assert 0.0 < row["solver_time_s"] < row["total_time_s"]
        distance = np.linalg.norm(problem.robot.difference(problem.goal.q, solution.q_final))
        assert row["goal_distance"] == distance
        assert row["record"]["q_final"] == solution.q_final.tolist()
        assert row["record"]["v_final"] == solution.vs[-1].tolist()
        assert row["record"]["u"] == solution.us.tolist()
        assert row["record"]["eta"] == solution.eta.tolist()


def test_rows_have_what_was_found() -> None:
    problem = mbocp.load_problem(EXAMPLES / "design/counterweight.toml", {"horizon.steps": 12})
    solution, names = mbocp.solve(problem), ["duration", "parameters", "via_times"]
    check_record(names)
    row = solution_row(problem, solution, 0.0, names)["record"]
    assert row == {"duration": solution.duration, "parameters": solution.parameters, "via_times": {}}
    assert len(row["parameters"]) == 2


def test_all_executors_make_the_same_table(small: Study, solved: Path, tmp_path: Path) -> None:
    local = StudyResult.load(solved)
    context = multiprocessing.get_context("forkserver")
    for name, executor in (
        ("processes", ProcessPoolExecutor(2, mp_context=context)),
        ("threads", ThreadPoolExecutor(3)),
    ):
        with executor:
            result = run_study(small, tmp_path / f"{name}.jsonl", executor=executor)
        assert timeless(result) == timeless(local)
        assert result.header == local.header


class _Counting(Executor):
    """Runs nothing until asked for a result, and counts what it was given."""

    def __init__(self) -> None:
        self.inner = ThreadPoolExecutor(1)
        self.waiting, self.most = 0, 0

    def submit(self, function: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.waiting += 1
        self.most = max(self.most, self.waiting)
        future = self.inner.submit(function, *args, **kwargs)
        future.add_done_callback(lambda _: self._less())
        return future

    def _less(self) -> None:
        self.waiting -= 1


def test_few_tasks_are_under_way(make: MakeStudy, tmp_path: Path) -> None:
    study = make(grid={"cost.effort": {"linspace": [1, 2, 20]}})
    executor = _Counting()
    with executor.inner:
        run_study(study, tmp_path / "rows.jsonl", executor=executor, workers=2)
    assert executor.most == 4


def bad(make: MakeStudy, *kinds: int, **more: Any) -> Study:
    entries: list[dict[str, Any]] = [{}] * 3 + [{"solver.max_iterations": kind} for kind in kinds] + [{}] * 3
    return make(list=[{"cost.effort": 1.0 + i, **entry} for i, entry in enumerate(entries)], **more)


def test_errors_and_crashes_are_rows(make: MakeStudy, tmp_path: Path) -> None:
    study = bad(make, 101, 102, 103, 105)
    result = run_study(study, tmp_path / "rows.jsonl", workers=2, solve=callables.sometimes_bad)
    assert ends(result) == ["converged"] * 3 + ["error", "crashed", "crashed", "crashed"] + ["converged"] * 3
    messages = result.column("message")
    assert messages[3] == "RuntimeError: no luck today"
    assert "SIGKILL" in messages[4]
    assert "SIGSEGV" in messages[5]
    assert "exit status 3" in messages[6]
    assert np.isnan(result.column("cost")[3:7]).all()
    assert not result.column("converged")[3:7].any()


def test_too_little_memory_costs_a_row(make: MakeStudy, tmp_path: Path) -> None:
    study = bad(make, 106, 107)
    result = run_study(study, tmp_path / "rows.jsonl", workers=1, solve=callables.short_of_memory)
    assert ends(result) == ["converged"] * 3 + ["error"] * 2 + ["converged"] * 3
    messages = result.column("message")
    assert messages[3].startswith("MemoryError")
    assert "MemoryLimitExceeded: horizon.steps: 1e+05 steps" in messages[4]


def test_a_problem_that_cannot_be_is_a_row(make: MakeStudy, tmp_path: Path) -> None:
    study = make(grid={"goal.q": [[0, 0, -5], [0, 0, -4]]})
    result = run_study(study, tmp_path / "rows.jsonl", workers=1)
    assert ends(result) == ["converged", "error"]
    assert "InconsistentStart: <study>: goal.q: violates constraint" in result.rows[1]["message"]


def test_a_solver_is_stopped_in_time(make: MakeStudy, tmp_path: Path) -> None:
    """The solver looks at the clock: the row has what it came to."""
    study = make(grid={"cost.effort": [1.0, 2.0]}, time_limit=1e-9)
    result = run_study(study, tmp_path / "rows.jsonl", workers=1)
    assert ends(result) == ["timeout", "timeout"]
    for row in result.rows:
        assert row["message"].startswith("stopped after time_limit = 1e-09 s; ")
        assert row["cost"] > 0.0
        assert row["residual"] > 0.0


def test_what_does_not_stop_is_killed(make: MakeStudy, tmp_path: Path) -> None:
    study = bad(make, 104, time_limit=0.2)
    result = run_study(study, tmp_path / "rows.jsonl", workers=2, solve=callables.sometimes_bad)
    assert ends(result) == ["converged"] * 3 + ["timeout"] + ["converged"] * 3
    assert result.rows[3]["message"] == "killed after time_limit = 0.2 s, it did not stop by itself"


def test_workers_have_one_thread_and_the_parents_words(
    make: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MBOCP_TEST_WORD", "hello")
    study = make(grid={"cost.effort": [1.0]})
    result = run_study(study, tmp_path / "rows.jsonl", workers=1, solve=callables.threads)
    assert ends(result) == ["converged"]


def test_resume_does_what_is_missing(small: Study, solved: Path, tmp_path: Path) -> None:
    path, whole = tmp_path / "rows.jsonl", StudyResult.load(solved)
    header, *lines = solved.read_text().splitlines(keepends=True)
    path.write_text(header + lines[4] + lines[1] + lines[5][:-20])
    kept = {json.loads(lines[i])["index"] for i in (4, 1)}
    seen: list[int] = []
    result = run_study(small, path, resume=True, callback=lambda row: seen.append(row["index"]))
    assert sorted(seen) == sorted(set(range(6)) - kept)
    assert timeless(result) == timeless(whole)
    again = run_study(small, path, resume=True, callback=lambda row: seen.append(-1))
    assert again.rows == result.rows
    assert -1 not in seen


def test_ctrl_c_leaves_what_is_done(small: Study, tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"

    def stop(row: Any) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(small, path, callback=stop, workers=1)
    left = StudyResult.load(path)
    assert len(left) == 1
    assert not left.is_complete
    assert len(left.missing) == 5
    assert run_study(small, path, resume=True).is_complete


def test_files_are_kept(small: Study, solved: Path, make: MakeStudy, tmp_path: Path) -> None:
    path, before = tmp_path / "rows.jsonl", solved.read_bytes()
    path.write_bytes(before)
    with pytest.raises(ResultFileError, match="exists already"):
        run_study(small, path)
    with pytest.raises(StudyError, match=r"belongs to another study .* they differ in record, grid"):
        run_study(make(grid={"cost.effort": [1.0]}), path, resume=True)
    with pytest.raises(StudyError, match="resume and overwrite: give one of the two"):
        run_study(small, path, resume=True, overwrite=True)
    assert path.read_bytes() == before
    assert len(run_study(make(grid={"cost.effort": [1.0]}), path, overwrite=True)) == 1


def test_a_study_that_is_wrong_altogether_does_not_begin(make: MakeStudy, tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    with pytest.raises(ProblemError, match="violates constraint 'rod'"):
        run_study(make(grid={"goal.q": [[0, 0, -4]]}), path)
    named = make(fixed={"goal.q": {}}, grid={"goal.q.bobb": [1.0, 2.0]})
    with pytest.raises(UnknownJoint, match="has no joint 'bobb'"):
        run_study(named, path)
    assert not path.exists()


def test_a_first_task_that_cannot_be_is_no_reason_to_stop(make: MakeStudy, tmp_path: Path) -> None:
    study = make(grid={"goal.q": [[0, 0, -4], [0, 0, -5]]})
    with pytest.warns(StudyWarning, match=r"task 0 \(goal.q = \[0, 0, -4\]\) cannot be made"):
        result = run_study(study, tmp_path / "rows.jsonl", workers=1)
    assert ends(result) == ["error", "converged"]


def test_a_kind_that_is_wrong_is_a_warning(make: MakeStudy, tmp_path: Path) -> None:
    study = make(grid={"integrator.scheme": ["se1", "se3"]})
    with pytest.warns(StudyWarning, match=r"task 1 \(integrator.scheme = se3\) cannot be made: .*'se3'"):
        result = run_study(study, tmp_path / "rows.jsonl", workers=1)
    assert ends(result) == ["converged", "error"]


def test_another_version_is_a_warning(make: MakeStudy, tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    study = make(grid={"cost.effort": [1.0]})
    run_study(study, path)
    path.write_text(path.read_text().replace(f'"mbocp":"{mbocp.__version__}"', '"mbocp":"0.0.1"'))
    with pytest.warns(StudyWarning, match=r"was begun by mbocp 0.0.1"):
        run_study(study, path, resume=True)


class _Broken(Executor):
    def submit(self, function: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        raise BrokenProcessPool("worn out")


def test_an_executor_that_gives_up(small: Study, tmp_path: Path) -> None:
    with pytest.raises(
        StudyError, match=r"the executor has given up \(BrokenProcessPool: worn out\).*resume"
    ):
        run_study(small, tmp_path / "rows.jsonl", executor=_Broken())
    assert len(StudyResult.load(tmp_path / "rows.jsonl")) == 0


class _Elsewhere(Executor):
    def submit(self, function: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_exception(ModuleNotFoundError("No module named 'mbocp'"))
        return future


def test_an_executor_without_mbocp(small: Study, tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"the executor cannot run tasks: .*No module named 'mbocp'"):
        run_study(small, tmp_path / "rows.jsonl", executor=_Elsewhere())


def test_arguments_that_cannot_be(small: Study, tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="workers: got 0"):
        run_study(small, tmp_path / "rows.jsonl", workers=0)
    with pytest.raises(
        StudyError, match="cannot be sent to another process; write it at the top of a module"
    ):
        run_study(small, tmp_path / "rows.jsonl", solve=lambda problem: mbocp.solve(problem))


def test_a_robot_is_loaded_once(make: MakeStudy, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(task_module, "_robots", OrderedDict())
    study = make(grid={"robot.gravity": [[0, 0, -1], [0, 0, -2]], "cost.effort": [1.0, 2.0, 3.0]})
    problems = [make_problem(study.job, task.overrides) for task in study.tasks()]
    assert len({id(problem.robot) for problem in problems}) == 2
    assert [p.robot.model.gravity.linear[2] for p in problems] == [-1, -1, -1, -2, -2, -2]
    assert [float(np.max(p.cost.effort)) for p in problems] == [1, 2, 3, 1, 2, 3]


def test_numbers_that_one_task_finds_are_found_for_it_alone(tmp_path: Path) -> None:
    base = {"of": "robot.base.y", "min": -0.4, "max": 0.4, "start": 0.1}
    study = Study.from_tables(
        {
            "problem": str(EXAMPLES / "design" / "base_placement.toml"),
            "fixed": {"horizon.steps": 20},
            "axis": [
                {
                    "name": "base",
                    "values": [
                        {"label": "found", "parameter": [base]},
                        {"label": "as it is", "parameter": []},
                    ],
                }
            ],
        }
    )
    found, given = run_study(study, tmp_path / "rows.jsonl", workers=1).rows
    assert found["goal_distance"] < 1e-6  # of the robot with the base that was found
    alone = mbocp.load_problem(
        EXAMPLES / "design" / "base_placement.toml", ["horizon.steps=20", "parameter=[]"]
    )
    assert given["cost"] == mbocp.solve(alone).cost > found["cost"]
