"""Mutations of YAML: of what it holds, and of what it has beyond that."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import time
from random import Random
from typing import Any

import yaml

from .raw import EXTREMES
from .trees import DEEP, Raw, Vocabulary, mutate_text, mutate_tree

__all__ = ["count_entries", "mutate_yaml"]

_MOST_ENTRIES = 50_000  # of a file that is mutated as a tree; mutated again, an alias bomb is a text


def mutate_yaml(tree: Mapping[str, Any], random: Random, vocabulary: Vocabulary = ()) -> bytes:
    """YAML of a mutated tree, with what YAML has beyond it: aliases, tags, dates, several documents.

    Raises
    ------
    ValueError
        If the aliases of the tree stand for more than anybody could write.
    """
    if count_entries(tree) > _MOST_ENTRIES:
        raise ValueError("too many entries")
    mutated = mutate_tree(tree, random, vocabulary) if random.random() < 0.8 else tree
    text = yaml.safe_dump(
        _plain(mutated), allow_unicode=True, default_flow_style=random.choice((True, False, None))
    )
    if random.random() < 0.35:
        text = random.choice(_YAML)(text, random)
    return mutate_text(text, random, likely=0.12)


def count_entries(tree: Any, seen: dict[int, float] | None = None) -> float:
    """Entries of a tree, aliases as often as they are used; infinite where one holds itself."""
    known = {} if seen is None else seen
    if not isinstance(tree, (dict, list)):
        return 1.0
    if id(tree) not in known:
        known[id(tree)] = math.inf  # until all that is in it is counted
        inner = tree.values() if isinstance(tree, dict) else tree
        known[id(tree)] = 1.0 + sum(count_entries(value, known) for value in inner)
    return known[id(tree)]


def _plain(value: Any) -> Any:
    """Without `Raw`, which YAML's writer does not know."""
    if isinstance(value, Raw):
        return f"RAW{value[:200]}" if len(value) > 300 else str(value)
    if isinstance(value, dict):
        return {key: _plain(v) for key, v in value.items()}
    if isinstance(value, list):
        return [_plain(v) for v in value]
    return value.isoformat() if isinstance(value, time) else value


def _bomb(text: str, random: Random) -> str:
    width, depth = random.choice((2, 9)), random.choice((3, 9, 12))
    lines = ["b0: &b0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"b{i}: &b{i} [{', '.join([f'*b{i - 1}'] * width)}]" for i in range(1, depth)]
    key = random.choice(("closed_loop", "name_mot", "type", "extra", "joint_name"))
    return "\n".join([*lines, f"{key}: *b{depth - 1}", text])


def _nested(text: str, random: Random) -> str:
    depth = random.choice(DEEP)
    key = random.choice(("closed_loop", "name_mot", "extra"))
    return (
        f"{text}\n{key}: {'[' * depth}{']' * depth}\n"
        if random.random() < 0.5
        else f"{key}: {'{a: ' * depth}"
    )


def _tagged(text: str, random: Random) -> str:
    return text.replace(": ", f": {random.choice(_TAGS)} ", 1)


def _scalar(text: str, random: Random) -> str:
    key = random.choice(("closed_loop", "name_mot", "type", "joint_type", "? [a, b]", "<<", "1", "null"))
    return f"{text}\n{key}: {random.choice(_SCALARS)}\n"


_TAGS = (
    "!!python/object/apply:os.getpid []",
    "!!binary",
    "!!set",
    "!!omap",
    "!!float",
    "!!timestamp",
    "!x",
    "&a",
)
_SCALARS = (
    *EXTREMES,
    "2020-13-45",
    "2020-01-01",
    "2020-01-01 25:61:00",
    "12:30:45",
    "!!float x",
    "!!int 1e",
    "*none",
)
_YAML = (
    _bomb,
    _nested,
    _tagged,
    _scalar,
    _scalar,
    lambda text, _: f"{text}\n---\n{text}",
    lambda text, _: f"\t{text}",
)
