"""The table of menus counts what it says."""

from __future__ import annotations

from benchmarks.menus import Result, menus_table


def test_minima_are_told_apart_by_their_costs():
    costs = {"one": [2.0], "four": [1.005, 2.0], "menu": [1.0, 3.0], "many": [1.0005, 2.0, 4.0]}
    result = Result(costs, dict.fromkeys(costs, 0.5))
    assert result.best == 1.0
    assert [way for way in costs if result.is_near(way)] == ["four", "menu", "many"]
    assert result.shared("many", "menu") == 1
    nothing = Result({way: [] for way in costs}, dict.fromkeys(costs, 0.5))
    rows = menus_table({"tasks": [result, nothing]}, 9).rows
    assert [row[1:6] for row in rows] == [
        ("one start", "0 of 1", "2", "1.0", "1 of 3"),
        ("four starts", "1 of 1", "1", "2.0", "1 of 3"),
        ("menu", "1 of 1", "1", "2.0", "1 of 3"),
        ("9 starts", "1 of 1", "1", "3.0", "3 of 3"),
    ]
