"""The file of a study: what is written stays, what is cut off is forgotten, and nobody else writes."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from mbocp.exceptions import ResultFileError, StudyError
from mbocp.study.run_task import failure_row
from mbocp.study.table import FORMAT, FORMAT_VERSION, RowFile, read_table

HEADER: dict[str, Any] = {
    "format": FORMAT,
    "format_version": FORMAT_VERSION,
    "mbocp": "1",
    "name": "some",
    "digest": "a" * 64,
    "tasks": 10,
    "tables": {"seed": 1, "grid": {"cost.effort": [1, 2]}},
}


def row(index: int) -> dict[str, Any]:
    return {"index": index, "values": {}, **failure_row("error", f"number {index}")}


def indices(path: Path) -> list[int]:
    return [entry["index"] for entry in read_table(path)[1]]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Leave a file with three rows."""
    path = tmp_path / "rows.jsonl"
    file = RowFile(path, HEADER)
    for index in (2, 0, 1):
        file.append(row(index))
    file.close()
    file.close()
    return path


def test_rows_come_back_in_order(path: Path) -> None:
    header, rows = read_table(path)
    assert header == HEADER
    assert rows == [row(0), row(1), row(2)]
    assert [json.loads(line).get("index") for line in path.read_text().splitlines()] == [None, 2, 0, 1]


def test_rows_are_there_as_soon_as_they_are_written(tmp_path: Path) -> None:
    file = RowFile(tmp_path / "rows.jsonl", HEADER)
    file.append(row(3))
    assert indices(file.path) == [3]
    file.close()


def test_rows_reach_the_disk_within_a_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    now = [100.0]
    monkeypatch.setattr("mbocp.study.table.os.fsync", synced.append)
    monkeypatch.setattr("mbocp.study.table.time.monotonic", lambda: now[0])
    file = RowFile(tmp_path / "rows.jsonl", HEADER)
    for index in range(3):  # one batch
        file.append(row(index))
        file.tick()
    assert not synced
    now[0] += 0.6
    file.tick()
    file.tick()
    assert len(synced) == 1
    file.append(row(4))
    file.close()
    assert len(synced) == 2


@pytest.mark.parametrize(
    "torn", ['{"index": 5, "val', '{"index":5}', "{", "\0\0\0\0", "\0\0\0\n", '{"a": \n']
)
def test_a_torn_last_line_is_forgotten(path: Path, torn: str) -> None:
    whole = path.read_bytes()
    path.write_bytes(whole + torn.encode())
    assert indices(path) == [0, 1, 2]
    file = RowFile(path, HEADER, resume=True)
    assert sorted(entry["index"] for entry in file.rows) == [0, 1, 2]
    file.append(row(5))
    file.close()
    assert indices(path) == [0, 1, 2, 5]
    assert path.read_bytes().startswith(whole)


@pytest.mark.parametrize("length", [0, 1, 30, -1])
def test_a_torn_header_is_begun_anew(tmp_path: Path, length: int) -> None:
    path = tmp_path / "rows.jsonl"
    RowFile(path, HEADER).close()
    path.write_bytes(path.read_bytes()[:length])
    RowFile(path, HEADER, resume=True).close()
    assert read_table(path) == (HEADER, [])


def test_resume_begins_where_there_is_nothing(tmp_path: Path) -> None:
    RowFile(tmp_path / "rows.jsonl", HEADER, resume=True).close()
    assert read_table(tmp_path / "rows.jsonl") == (HEADER, [])


def test_a_file_is_not_replaced_unasked(path: Path) -> None:
    before = path.read_bytes()
    with pytest.raises(ResultFileError, match=r"rows.jsonl: exists already; go on with it \(--resume"):
        RowFile(path, HEADER)
    assert path.read_bytes() == before
    RowFile(path, HEADER, overwrite=True).close()
    assert indices(path) == []


def test_another_study_is_refused(path: Path) -> None:
    before = path.read_bytes()
    other = {**HEADER, "digest": "b" * 64, "tables": {"seed": 2, "grid": {"cost.effort": [1, 2]}}}
    with pytest.raises(StudyError, match=r"rows.jsonl: belongs to another study \('some'.*differ in seed\)"):
        RowFile(path, other, resume=True)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        (["hello"], "is not the table of a study"),
        (['{"format": "something"}'], "is not the table of a study"),
        ([json.dumps({**HEADER, "format_version": 9})], "has format version 9, this mbocp reads 1"),
        ([json.dumps(HEADER), "{}", json.dumps(row(1))], "is damaged: line 2"),
        ([json.dumps(HEADER), "??", json.dumps(row(1))], "is damaged: line 2"),
        ([json.dumps(HEADER), json.dumps(row(1)), json.dumps(row(1))], "is damaged: line 3"),
        ([json.dumps(HEADER), json.dumps(row(10))], "is damaged: line 2"),
    ],
)
def test_what_is_no_table_is_refused_and_left_alone(tmp_path: Path, lines: list[str], reason: str) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(ResultFileError, match=reason):
        read_table(path)
    with pytest.raises(ResultFileError, match=reason):
        RowFile(path, HEADER, resume=True)
    assert path.read_text() == "\n".join(lines) + "\n"


def test_places_that_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(ResultFileError, match="no such file"):
        read_table(tmp_path / "rows.jsonl")
    with pytest.raises(ResultFileError, match="is a folder"):
        RowFile(tmp_path, HEADER, resume=True)
    with pytest.raises(ResultFileError, match=r"there is no folder .*/nowhere'; make it first"):
        RowFile(tmp_path / "nowhere" / "rows.jsonl", HEADER)


def test_one_process_at_a_time(path: Path) -> None:
    file = RowFile(path, HEADER, resume=True)
    with pytest.raises(ResultFileError, match="another process is writing it"):
        RowFile(path, HEADER, resume=True)
    with pytest.raises(ResultFileError, match="another process is writing it"):
        RowFile(path, HEADER, overwrite=True)
    read_table(path)  # reading neither needs nor loses the lock
    with pytest.raises(ResultFileError, match="another process is writing it"):
        RowFile(path, HEADER, resume=True)
    file.close()
    RowFile(path, HEADER, resume=True).close()


def test_forked_children_do_not_keep_the_lock(path: Path) -> None:
    """A child that outlives the writer, as a pool's processes may, must not stand in the way."""
    code = f"""
import os, time
from pathlib import Path
from mbocp.study.table import RowFile
file = RowFile(Path({str(path)!r}), {HEADER!r}, resume=True)
child = os.fork()
if child == 0:
    os.close(1)
    os.close(2)
    time.sleep(60)
print(child, flush=True)
os.kill(os.getpid(), 9)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    child = int(done.stdout)
    try:
        RowFile(path, HEADER, resume=True).close()
    finally:
        os.kill(child, 9)


def test_a_full_disk_is_an_error_and_no_loss(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = RowFile(path, HEADER, resume=True)
    written = os.write

    def half(handle: int, data: bytes) -> int:
        if len(data) < 40:
            raise OSError(28, "No space left on device")
        return written(handle, data[: len(data) // 2])

    monkeypatch.setattr("mbocp.study.table.os.write", half)
    with pytest.raises(ResultFileError, match=r"rows.jsonl: cannot be written: No space left"):
        file.append(row(7))
    file.close()
    monkeypatch.undo()
    assert indices(path) == [0, 1, 2]
    file = RowFile(path, HEADER, resume=True)
    file.append(row(7))
    file.close()
    assert indices(path) == [0, 1, 2, 7]


@pytest.mark.parametrize(
    ("place", "key", "value"),
    [
        (0, "tasks", "ten"),
        (0, "tasks", 10**12),
        (0, "varied", "x"),
        (0, "by", [1]),
        (1, "index", True),
        (1, "values", [1]),
        (1, "converged", "yes"),
        (1, "cost", "low"),
        (1, "iterations", 10**400),
        (1, "record", 3),
    ],
)
def test_values_of_another_kind_are_damage(path: Path, place: int, key: str, value: object) -> None:
    lines = path.read_text().splitlines()
    lines[place] = json.dumps({**json.loads(lines[place]), key: value})
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(ResultFileError, match="is damaged"):
        read_table(path)


def test_nested_beyond_measure_is_damage(path: Path) -> None:
    lines = path.read_text().splitlines()
    lines[1] = '{"index": 2, "values": ' + "[" * 100_000 + "]" * 100_000 + "}"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(ResultFileError, match="is damaged: line 2"):
        read_table(path)


def test_a_full_disk_leaves_the_rows_that_are_whole(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk takes half a row; once there is room again, the study goes on."""
    write, room = os.write, [7]

    def write_what_fits(handle: int, line: bytes) -> int:
        if not room:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(handle, line[: room.pop()])

    file = RowFile(path, HEADER, resume=True)
    with monkeypatch.context() as patch:
        patch.setattr("mbocp.study.table.os.write", write_what_fits)
        with pytest.raises(ResultFileError, match="cannot be written: No space left on device"):
            file.append(row(3))
    file.close()
    assert indices(path) == [0, 1, 2]
    file = RowFile(path, HEADER, resume=True)
    file.append(row(3))
    file.close()
    assert indices(path) == [0, 1, 2, 3]
