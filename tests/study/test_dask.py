"""Dask in the place of this machine's processes."""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from mbocp.exceptions import StudyError
from mbocp.study import run_study
from mbocp.study.pools import dask_executor

from . import callables
from .conftest import MakeStudy
from .test_run import GOALS, bad, ends, timeless

pytest.importorskip("distributed", reason="Dask's `distributed` is not installed")


@pytest.fixture(autouse=True)
def _dasks_own_warnings() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        yield


def test_a_local_cluster_makes_the_same_table(make: MakeStudy, tmp_path: Path) -> None:
    study = make(grid={"goal.q": GOALS}, record=["q_final"])
    with ThreadPoolExecutor(1) as here:
        local = run_study(study, tmp_path / "local.jsonl", executor=here)
    # A worker that dies is a row, too; the others take what it had.
    crashing = bad(make, 101, 102)
    with dask_executor("local", 2) as (executor, workers):
        assert workers == 2
        result = run_study(study, tmp_path / "dask.jsonl", executor=executor, workers=workers)
        survived = run_study(
            crashing,
            tmp_path / "crash.jsonl",
            executor=executor,
            workers=workers,
            solve=callables.sometimes_bad,
        )
    assert timeless(result) == timeless(local)
    assert result.header == local.header
    assert ends(survived) == ["converged"] * 3 + ["error", "crashed"] + ["converged"] * 3


class _Killed(Exception):
    """What an executor says of all tasks that a worker had when it died."""


class _Shared(Executor):
    """One worker, which begins when it has two tasks or somebody waits; equal calls are one, as with Dask."""

    def __init__(self) -> None:
        self._seen: dict[Any, Future[Any]] = {}
        self._waits: list[tuple[Future[Any], Any]] = []
        threading.Thread(target=self._work, daemon=True).start()

    def submit(self, function: Any, /, *args: Any, **_: Any) -> Future[Any]:
        key = repr((function, args))
        if key not in self._seen:
            self._seen[key] = Future()
            self._waits.append((self._seen[key], lambda: function(*args)))
        return self._seen[key]

    def _work(self) -> None:
        while True:
            time.sleep(0.05)
            mine, self._waits = self._waits, []
            rows = [call() for _, call in mine]
            dies = any(row is not None and row["status"] == "error" for row in rows)
            for (future, _), row in zip(mine, rows, strict=True):
                if dies:
                    future.set_exception(_Killed())
                else:
                    future.set_result(row)


def test_a_worker_that_dies_takes_no_neighbour_with_it(make: MakeStudy, tmp_path: Path) -> None:
    study = bad(make, 101)
    result = run_study(
        study, tmp_path / "rows.jsonl", executor=_Shared(), workers=2, solve=callables.sometimes_bad
    )
    assert ends(result) == ["converged"] * 3 + ["crashed"] + ["converged"] * 3
    assert "_Killed" in result.column("message")[3]


def test_nobody_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbocp.study.pools._TIMEOUT", 0.5)
    with (
        pytest.raises(StudyError, match=r"--scheduler tcp://127.0.0.1:9: nobody answers there"),
        dask_executor("tcp://127.0.0.1:9"),
    ):
        pass
