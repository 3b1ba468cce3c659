"""Every file of tests has one level, and every place of a level decides on some."""

from __future__ import annotations

from pathlib import PurePosixPath

import pytest

from tests.levels import LEVELS, LONGEST, ROOT, level_of, name_of

FILES = [file for folder in ("tests", "papers/tests") for file in (ROOT / folder).rglob("test_*.py")]


def test_each_file_has_one_level(request: pytest.FixtureRequest) -> None:
    assert {level_of(file) for file in FILES} == set(LEVELS)
    assert [level for level in LEVELS if request.node.get_closest_marker(level)] == ["unit"]


def test_the_longest_files_are_there() -> None:
    assert set(LONGEST) <= {name_of(file) for file in FILES}


def test_each_place_decides_on_files() -> None:
    """It is there, once, and without it its files had another level."""
    places = [(PurePosixPath(place), level) for level, named in LEVELS.items() for place in named]
    levels, names = dict(places), [PurePosixPath(name_of(file)) for file in FILES]
    assert len(levels) == len(places)
    for place, level in places:
        assert any(place in (name, *name.parents) for name in names), place
        assert next((levels[p] for p in place.parents if p in levels), "physics") != level, place
