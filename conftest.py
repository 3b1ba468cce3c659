"""Marks tests by their levels, leaves out files of levels that are not asked for, begins with the longest."""

from __future__ import annotations

import os
from collections import defaultdict
from pathlib import Path

import pytest

from mbocp._environment import available_workers
from tests.levels import LONGEST, level_of, name_of

# Processes share the cores: threads of a BLAS would wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")


@pytest.hookimpl(optionalhook=True)  # without pytest-xdist nobody asks
def pytest_xdist_auto_num_workers() -> int:
    """One more than there are cores: tests wait, too, for processes that they start."""
    return available_workers() + 1


def pytest_itemcollected(item: pytest.Item) -> None:
    """Mark a test by the level of its file."""
    item.add_marker(level_of(item.path))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files that take longest first."""
    ranks = {name: rank for rank, name in enumerate(LONGEST)}
    items.sort(key=lambda item: ranks.get(name_of(item.path), len(ranks)))


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no file of which `-m` selects nothing."""
    if not (collection_path.name.startswith("test_") and collection_path.suffix == ".py"):
        return None
    level, asked = level_of(collection_path), config.option.markexpr or "True"
    return None if any(eval(asked, {}, defaultdict(bool, {level: True, "slow": s})) for s in (0, 1)) else True
