"""Dask in the place of this machine's processes."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

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
    assert ends(survived)[3] == "error"
    assert ends(survived)[4] == "crashed"
    assert survived.is_complete


def test_nobody_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbocp.study.pools._TIMEOUT", 0.5)
    with (
        pytest.raises(StudyError, match=r"--scheduler tcp://127.0.0.1:9: nobody answers there"),
        dask_executor("tcp://127.0.0.1:9"),
    ):
        pass
