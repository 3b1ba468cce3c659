"""Files that a user names are regular and of bounded size, TOML of bounded depth; else one error says why."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from mbocp._files import (
    MAX_LEVELS,
    is_file,
    is_folder,
    parse_toml,
    path_of,
    read_bytes,
    read_text,
    read_toml,
)
from mbocp.exceptions import Unreadable


def test_text_and_tables_of_a_file(tmp_path):
    file = tmp_path / "a.toml"
    file.write_bytes("name = 'ü'\r\nx = [1, 2.5]\r\n".encode())
    assert read_text(file) == "name = 'ü'\nx = [1, 2.5]\n"
    assert read_toml(file) == {"name": "ü", "x": [1, 2.5]}
    assert read_bytes(file).startswith(b"name")
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert read_toml(file) == {"name": "ü", "x": [1, 2.5]}


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/null"])
def test_devices_are_refused(device):
    with pytest.raises(Unreadable, match="is a device, expected a robot"):
        read_text(device, expected="a robot")


def test_pipes_are_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(Unreadable, match="is a pipe"):
        read_text(tmp_path / "pipe")


def test_folders_missing_files_and_impossible_names_are_refused(tmp_path):
    with pytest.raises(Unreadable, match="is a folder"):
        read_text(tmp_path)
    with pytest.raises(Unreadable, match="no such file"):
        read_text(tmp_path / "missing")
    with pytest.raises(Unreadable, match="too long"):
        read_text(tmp_path / ("x" * 5000))
    with pytest.raises(Unreadable, match="null"):
        read_text("a\0b")
    (tmp_path / "file").touch()
    with pytest.raises(Unreadable, match="Not a directory"):
        read_text(tmp_path / "file" / "below")


def test_a_large_file_is_refused_with_the_limit(tmp_path):
    file = tmp_path / "large"
    with file.open("wb") as handle:
        handle.truncate(3 * 2**30)  # sparse
    began = time.perf_counter()
    with pytest.raises(Unreadable, match=r"has 3072.0 MB, expected a robot of at most 1 MB"):
        read_text(file, expected="a robot", limit=2**20)
    assert time.perf_counter() - began < 1.0
    file.write_bytes(b"x" * 100)
    assert len(read_bytes(file, limit=100)) == 100
    with pytest.raises(Unreadable, match="of at most"):
        read_bytes(file, limit=99)


def test_what_is_no_utf8_is_refused(tmp_path):
    file = tmp_path / "latin"
    file.write_bytes("ü".encode("latin-1"))
    with pytest.raises(Unreadable, match="UTF-8"):
        read_text(file)
    file.write_text("arm", encoding="utf-16")
    with pytest.raises(Unreadable, match="in UTF-16, expected a text file: save it in UTF-8"):
        read_text(file)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("x = [", "malformed TOML: .*line 1, column 6"),
        (
            'robot = "ur5"\n\n[[robot.payload]]\n',
            r"\[\[robot\.payload\]\] gives again .*line 3, column 16\); .* robot as the table \[robot\], not",
        ),
        ("[a]\nb = 1\n[a]\n", r"\[a\] gives again .*line 3"),
        ("a = 1\na = 2", r"TOML: a = 2 gives again .*line 2, column 6\); give each once$"),
        ("a = {b = 1}\na.c = 2\nd = 1", r"a\.c = 2 gives again .*line 2.* a as the table \[a\]"),
        ("x = " + "[" * 5000 + "]" * 5000, f"nested more than {MAX_LEVELS} deep"),
        (
            "x = " + "[" * (MAX_LEVELS + 1) + "]" * (MAX_LEVELS + 1),
            r"x\[0\]\[0\].*: lists or tables are",
        ),
        ("x = " + "{a = " * 3000 + "1" + "}" * 3000, "nested more than"),
        ("x = " + "9" * 5000, "64 bits"),
        ("a.b = 1" + "0" * 400, "a.b: got an integer of about 401 digits, expected an integer of 64 bits"),
        ("x = [9223372036854775808]", r"x\[0\]: got 9223372036854775808"),
        ("x = 2020-13-45", "malformed TOML"),
        (".".join("a" * 100_000) + " = 1", "a key of more than"),
        ("[" + " . ".join(['"a"'] * 100_000) + "]", "a key of more than"),
    ],
    ids=lambda value: value[:20],
)
def test_malformed_toml_is_refused_in_short_time(text, reason):
    began = time.perf_counter()
    with pytest.raises(Unreadable, match=reason):
        parse_toml(text)
    assert time.perf_counter() - began < 2.0


def test_the_largest_that_toml_allows_is_read():
    deep = "[" * (MAX_LEVELS - 1) + "]" * (MAX_LEVELS - 1)
    document = parse_toml(f"x = {deep}\ny = [9223372036854775807, -9223372036854775808]\nt = 2020-12-31")
    assert document["y"] == [2**63 - 1, -(2**63)]


def test_names_that_no_file_can_have(tmp_path):
    (tmp_path / "a").touch()
    assert is_file(tmp_path / "a")
    assert is_folder(tmp_path)
    for name in ("x" * 5000, "a\0b", "gone", "a/b"):
        assert not is_file(tmp_path / name)
        assert not is_folder(tmp_path / name)
    assert path_of("~/a") == Path.home() / "a"
    assert path_of("~no_such_user_here/a") == Path("~no_such_user_here/a")
