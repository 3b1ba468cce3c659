"""Mutations of what TOML and YAML hold, tables, lists, numbers and words; and TOML of it."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Mapping, Sequence
from datetime import date, datetime, time
from random import Random
from typing import Any

from .raw import mutate_bytes, mutate_lines

__all__ = ["DEEP", "Raw", "Vocabulary", "mutate_text", "mutate_toml", "mutate_tree"]

_Path = tuple[Any, ...]
Vocabulary = Sequence[frozenset[str]]  # keys of each table that there is


class Raw(str):
    """Text that is written as it stands."""

    __slots__ = ()


_WORDS = (
    *(
        "",
        " ",
        "x",
        "\x00",
        "a\x00b",
        "\n",
        "\r\n",
        "\x1b[31m",
        "é",
        "\U0001f916",
        "\u202e",
        "None",
        "nan",
        "auto",
        "*",
    ),
    *(
        "..",
        ".",
        "/",
        "~",
        "~nobody_of_that_name/x",
        "a/b",
        "/dev/null",
        "/dev/zero",
        "/proc/self/mem",
        "/etc",
    ),
    *(
        "x" * 300,
        "é" * 5000,
        "x" * 20_000,
        "%s",
        "{0}",
        "{}",
        "\\",
        "'",
        '"',
        "-",
        "--help",
        "a.b.c",
        "0",
        "1e9",
    ),
    *(
        "robot.urdf",
        "x.urdf",
        "x.toml",
        "ur5",
        "panda",
        "hector",
        "rigid_pendulum",
        "chain_3",
        "chain_0",
        "chain_-1",
    ),
    *(
        "chain_99999999999999999999",
        "package://a/b",
        "file:///dev/zero",
        "root_joint",
        "universe",
        "exact",
        "penalty",
    ),
    *(
        "none",
        "midpoint",
        "rk4",
        "se1",
        "se2",
        "natural",
        "joint",
        "ipopt",
        "fatrop",
        "fbsm_newton",
        "monolithic",
    ),
)
_NUMBERS: tuple[Any, ...] = (
    *(
        0,
        1,
        -1,
        2,
        3,
        0.5,
        -0.5,
        7,
        10**6,
        10**9,
        10**12,
        -(10**9),
        2**31,
        2**63 - 1,
        2**63,
        2**64,
        10**30,
        10**400,
    ),
    *(
        0.0,
        -0.0,
        math.nan,
        math.inf,
        -math.inf,
        1e308,
        -1e308,
        1e300,
        1e160,
        1e100,
        1e20,
        1e-20,
        1e-160,
        1e-300,
        5e-324,
    ),
    Raw("9" * 5000),
    Raw("1e999"),
    Raw("0x7fffffffffffffffffff"),
)
_DATES = (
    date(2020, 1, 1),
    datetime(1, 1, 1),
    time(23, 59, 59),
    Raw("2020-13-45"),
    Raw("9999-12-31T23:59:60Z"),
)
DEEP = (20, 200, 3000, 50_000)


def mutate_toml(tree: Mapping[str, Any], random: Random, vocabulary: Vocabulary = ()) -> bytes:
    """TOML of a mutated tree; at times its text is mutated, too."""
    text = _toml(mutate_tree(tree, random, vocabulary)) if random.random() < 0.85 else _toml(tree)
    return mutate_text(text, random, likely=0.12)


def mutate_text(text: str, random: Random, likely: float) -> bytes:
    """Mutate lines and bytes of a text, each with that likelihood."""
    if random.random() < likely:
        text = mutate_lines(text, random)
    data = text.encode("utf-8", errors="surrogatepass")
    return mutate_bytes(data, random) if random.random() < likely else data


# Trees


def mutate_tree(tree: Mapping[str, Any], random: Random, vocabulary: Vocabulary = ()) -> dict[str, Any]:
    """Change one to four places of a tree; `vocabulary` has the keys of its tables."""
    mutated: dict[str, Any] = copy.deepcopy(dict(tree))
    for _ in range(random.choice((1, 1, 1, 2, 2, 4))):
        places = list(_places(mutated))
        if not places:
            break
        random.choice(_TREE)(mutated, random.choice(places), random, vocabulary)
    return mutated


def _places(tree: Any, path: _Path = ()) -> list[_Path]:
    found: list[_Path] = []
    if isinstance(tree, dict):
        items: Any = tree.items()
    elif isinstance(tree, list):
        items = enumerate(tree[:50])
    else:
        return found
    for key, value in items:
        found += [(*path, key), *_places(value, (*path, key))]
    return found


def _holder(tree: Any, path: _Path) -> Any:
    for key in path[:-1]:
        tree = tree[key]
    return tree


def _value(random: Random) -> Any:
    kind = random.random()
    if kind < 0.45:
        return random.choice(_NUMBERS)
    if kind < 0.75:
        return random.choice(_WORDS)
    if kind < 0.8:
        return random.choice((True, False))
    if kind < 0.84:
        return random.choice(_DATES)
    if kind < 0.88:
        depth = random.choice(DEEP)
        return Raw("[" * depth + "]" * depth)
    return random.choice(_SHAPES)


_SHAPES: tuple[Any, ...] = (
    *(
        [],
        {},
        [[]],
        [{}],
        [0],
        [0, 0, 0],
        [[0, 0, 0]],
        [[[1]]],
        ["x"],
        [None],
        [1, "x", True],
        [math.nan] * 6,
    ),
    *({"": 0}, {"x": 1}, {"shoulder": 1}, {"a": {"b": {"c": 1}}}, [0.0] * 1000, {"linspace": [0, 1, 3]}),
    *({"uniform": [0, 1]}, {"linspace": [0, 1, 10**9]}, {"q": [1, 2]}, {"label": "x"}, {"file": "/dev/zero"}),
)


def _set(tree: Any, path: _Path, random: Random, _: Vocabulary) -> None:
    _holder(tree, path)[path[-1]] = _value(random)


def _drop(tree: Any, path: _Path, random: Random, _: Vocabulary) -> None:
    del _holder(tree, path)[path[-1]]


def _key_of(holder: Mapping[str, Any], random: Random, vocabulary: Vocabulary) -> str:
    """A key that such a table may have, mostly; at times of another table."""
    tables = sorted(vocabulary, key=lambda keys: -len(keys & holder.keys()))
    if not tables:
        return "x"
    return random.choice(sorted(tables[0] if random.random() < 0.85 else random.choice(tables)))


def _rename(tree: Any, path: _Path, random: Random, vocabulary: Vocabulary) -> None:
    holder = _holder(tree, path)
    if isinstance(holder, dict):
        key = random.choice((_key_of(holder, random, vocabulary), f"{path[-1]}s", random.choice(_WORDS[:12])))
        holder[key] = holder.pop(path[-1])


def _add(tree: Any, path: _Path, random: Random, vocabulary: Vocabulary) -> None:
    holder = _holder(tree, path)
    if isinstance(holder, dict):
        holder[_key_of(holder, random, vocabulary)] = _value(random)
    elif isinstance(holder, list):
        holder.insert(random.randrange(len(holder) + 1), _value(random))


def _lengthen(tree: Any, path: _Path, random: Random, _: Vocabulary) -> None:
    value = _holder(tree, path)[path[-1]]
    if isinstance(value, list):
        value[:] = random.choice(
            (value + value, value[:-1], value[1:], [], [value], value[::-1], value * 300)
        )
    elif isinstance(value, str):
        _holder(tree, path)[path[-1]] = random.choice(
            (value * 2, value[:-1], value.upper(), f" {value}", [value])
        )
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        _scale(tree, path, random, ())


def _scale(tree: Any, path: _Path, random: Random, _: Vocabulary) -> None:
    value = _holder(tree, path)[path[-1]]
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        factor = random.choice((-1, 0.5, 2, 10, 1e3, 1e-3, 1e6, 1e-6, 1e12, 1e-12))
        try:
            _holder(tree, path)[path[-1]] = random.choice((value * factor, value + 1, str(value), [value]))
        except OverflowError:
            _holder(tree, path)[path[-1]] = 0


def _swap(tree: Any, path: _Path, random: Random, _: Vocabulary) -> None:
    other = random.choice(_places(tree))
    one, two = _holder(tree, path), _holder(tree, other)
    first, second = copy.deepcopy(one[path[-1]]), copy.deepcopy(two[other[-1]])
    one[path[-1]] = second
    if random.random() < 0.5 and path[: len(other)] != other and other[: len(path)] != path:
        two[other[-1]] = first


_TREE = (_set, _set, _set, _drop, _rename, _add, _add, _lengthen, _lengthen, *(_scale,) * 4, _swap)


# Writing


def _toml(tree: Mapping[str, Any]) -> str:
    return "\n".join(f"{_key(key)} = {_inline(value)}" for key, value in tree.items()) + "\n"


def _key(key: Any) -> str:
    return str(key) if str(key).isidentifier() and str(key).isascii() else _quoted(str(key))


def _quoted(text: str) -> str:
    return (
        json.dumps(text).replace("\x7f", "\\u007f") if text.isascii() else '"' + text.replace('"', "") + '"'
    )


def _inline(value: Any) -> str:
    if isinstance(value, Raw):
        return str(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else repr(value).replace("nan", "nan")
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(k)} = {_inline(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_inline(v) for v in value) + "]"
    if isinstance(value, (date, datetime, time)):
        return value.isoformat()
    return "null"
