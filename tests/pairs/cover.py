"""Few sets of features in which every pair of them occurs."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import combinations

from tests.pairs.features import FEATURES

__all__ = ["Pair", "cover", "pairs_within"]

Pair = tuple[str, str]


def pairs_within(names: Collection[str]) -> list[Pair]:
    """Pairs of a set, in the order of names."""
    return list(combinations(sorted(names), 2))


def cover(wanted: Sequence[Pair], refused: Collection[Pair], most: int) -> list[tuple[str, ...]]:
    """Sets of at most so many features that hold all wanted pairs and none of the refused, greedily.

    Features of the same factor never stand together.
    """
    apart, left, found = set(refused), dict.fromkeys(wanted), []
    names = sorted({name for pair in wanted for name in pair})
    while left:
        chosen = set(next(iter(left)))
        while len(chosen) < most:
            gains = {
                name: sum(tuple(sorted((name, other))) in left for other in chosen)
                for name in names
                if name not in chosen and _fits(name, chosen, apart)
            }
            best = max(gains, key=lambda name: gains[name], default="")
            if not best or gains[best] == 0:
                break
            chosen.add(best)
        found.append(tuple(sorted(chosen)))
        for pair in pairs_within(chosen):
            left.pop(pair, None)
    return found


def _fits(name: str, chosen: Collection[str], apart: Collection[Pair]) -> bool:
    return all(
        FEATURES[name].factor != FEATURES[other].factor and tuple(sorted((name, other))) not in apart
        for other in chosen
    )
