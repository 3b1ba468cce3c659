"""Messages stay short and are made in bounded time, whatever they quote."""

from __future__ import annotations

import time

import pytest

from mbocp._text import MAX_MESSAGE, MAX_QUOTE, shorten, show
from mbocp.exceptions import MbocpError, RobotFileError, UnknownJoint


def bomb(levels: int) -> list[object]:
    """A list of 9**levels entries that takes little memory, as a YAML file with aliases makes it."""
    value: list[object] = ["lol"]
    for _ in range(levels):
        value = [value] * 9
    return value


@pytest.mark.parametrize(
    "value", [None, True, 3, -2.5, "word", [1, 2], {"a": [1.0]}, ("x", "y"), [[0.0] * 7]]
)
def test_small_values_are_shown_as_python_writes_them(value):
    assert show(value) == repr(value)


@pytest.mark.parametrize(
    "value",
    ["x" * 10**6, list(range(10**5)), bomb(30), {"k": bomb(30)}, 10**5000, {str(k): k for k in range(1000)}],
    ids=["text", "list", "bomb", "table of bombs", "integer", "table"],
)
def test_large_values_are_shown_in_few_characters_and_little_time(value):
    began = time.perf_counter()
    assert len(show(value)) <= MAX_QUOTE
    assert time.perf_counter() - began < 1.0


def test_shortened_keeps_beginning_and_end():
    text = "a" * 100 + "b" * 100
    assert shorten(text, 200) == text
    cut = shorten(text, 50)
    assert len(cut) == 50
    assert cut.startswith("aaa")
    assert cut.endswith("bbb")
    assert "[...]" in cut


@pytest.mark.parametrize(
    "error",
    [
        MbocpError("x" * 10**6),
        RobotFileError("robot.toml", "y" * 10**6),
        UnknownJoint("j" * 10**5, "robot", ["k" * 10**5] * 50),
    ],
    ids=lambda error: type(error).__name__,
)
def test_messages_are_bounded(error):
    assert len(str(error)) <= MAX_MESSAGE
