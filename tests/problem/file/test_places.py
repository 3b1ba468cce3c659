"""Where keys stand in a TOML text."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mbocp._files import parse_toml
from mbocp.problem.file.places import KeyPosition, place_of

ROOT = Path(__file__).parents[3]
FILES = sorted([*ROOT.glob("examples/**/*.toml"), *ROOT.glob("robots/**/*.toml"), ROOT / "pyproject.toml"])

TEXT = '''# [goal]  q = 1
robot = "a # [start]"
a.b.'c' = """
[limits]
velocity = 1 \\""" """""
[ "goal" ] # q
q = [ 0.0, # three
  1.0, [2.0,
3.0] ]
frame = { name = 'x = }', pose = { "position" = [1, 2] } }
[[phase]]
[phase.limits]
velocity = true
[[phase]]
name = "second"
[[phase.via]]
share = 0.5
[path]
kind = "line"
'''


def inner(value: Any, key: str) -> Iterator[str]:
    """All keys and entries of a value, but for those whose names have dots."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, entry in pairs:
        if "." in str(name):
            continue
        yield f"{key}{name}"
        yield from inner(entry, f"{key}{name}.")


@pytest.mark.parametrize(
    ("key", "line", "column"),
    [
        ("robot", 2, 1),
        ("a.b.c", 3, 5),
        ("goal", 6, 3),
        ("goal.q[1]", 8, 3),
        ("goal.q.2.1", 9, 1),
        ("goal.frame.pose.position", 10, 36),
        ("phase.0.limits.velocity", 13, 1),
        ("phase.1.name", 15, 1),
        ("phase.1.via.0.share", 17, 1),
    ],
)
def test_keys_are_found(key: str, line: int, column: int) -> None:
    assert place_of(TEXT, key) == KeyPosition(line, column)


def test_a_table_that_lacks_a_key_has_a_place() -> None:
    assert place_of(TEXT, "phase.1.limits.velocity") == KeyPosition(14, 3)
    assert place_of(TEXT, "path.0.kind") == place_of(TEXT, "path.kind") == KeyPosition(19, 1)


@pytest.mark.parametrize("key", ["limits.velocity", "start", "velocity", "b.c"])
def test_what_is_in_strings_and_comments_is_no_key(key: str) -> None:
    assert place_of(TEXT, key) is None


@pytest.mark.parametrize("file", FILES, ids=lambda path: path.name)
def test_every_key_of_a_file_has_a_place_that_begins_with_its_name(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    lines = text.splitlines()
    for key in inner(parse_toml(text), ""):
        *_, name = key.split(".")
        place = place_of(text, key)
        assert place is not None, key
        rest = lines[place.line - 1][place.column - 1 :]
        assert name.isdecimal() or rest.lstrip("\"'").startswith(name), (key, place)
