"""What an iterate takes along to a problem with other path constraints."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mbocp.programme import BoundMultipliers, Iterate
from mbocp.programme.iterate import IterateRecord

NAMES = st.lists(st.sampled_from("abcdef"), max_size=8).map(tuple)
STEPS = 3


def iterate(names: tuple[str, ...], rng: np.random.Generator) -> Iterate:
    """Numbers of no meaning, with a column for each name."""
    bounds = BoundMultipliers(
        xs=rng.normal(size=(STEPS + 1, 2)),
        us=rng.normal(size=(STEPS, 1)),
        path=rng.normal(size=(STEPS, len(names))),
        guard=np.zeros(0),
    )
    sizes = {"xs": (STEPS + 1, 2), "ys": (STEPS, 0), "us": (STEPS, 1), "ms": (STEPS, 2)}
    return Iterate(**{k: rng.normal(size=s) for k, s in sizes.items()}, eta=rng.normal(size=2), bounds=bounds)


def programme(names: tuple[str, ...]) -> SimpleNamespace:
    return SimpleNamespace(path_names=names, num_steps=STEPS, bounds=SimpleNamespace(nh=len(names)))


def test_an_iterate_without_multipliers_names_none() -> None:
    start = replace(iterate(("a", "b"), np.random.default_rng(0)), bounds=None)
    assert IterateRecord.of(start, programme(("a", "b"))).names == ()


@given(NAMES, NAMES)
def test_rows_keep_their_multipliers_by_name(before, after):
    start = iterate(before, np.random.default_rng(0))
    found = IterateRecord.of(start, programme(before)).into(programme(after))
    for column, name in enumerate(after):
        is_known = before == after or (before.count(name) == 1 and after.count(name) == 1)
        expected = (
            start.bounds.path[:, column if before == after else before.index(name)]
            if is_known
            else np.zeros(STEPS)
        )
        np.testing.assert_array_equal(found.bounds.path[:, column], expected)
    for name in ("xs", "ys", "us", "ms", "eta"):
        np.testing.assert_array_equal(getattr(found, name), getattr(start, name))
    np.testing.assert_array_equal(found.bounds.xs, start.bounds.xs)
    np.testing.assert_array_equal(found.bounds.us, start.bounds.us)
