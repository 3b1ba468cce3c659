"""Tables that have the keys of several: of all terms of the cost, of all kinds of path constraints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from copy import copy
from typing import Any, TypeVar

from pydantic import create_model
from pydantic.fields import FieldInfo

from mbocp._keys import Key, Table, keys_of, row_of

T = TypeVar("T", bound=Table)


def merge_tables(name: str, words: str, parts: Iterable[type[Table]], base: type[T]) -> type[T]:
    """Return `base` with the keys of all `parts`, in order; one that several have is common."""
    fields: dict[str, FieldInfo] = {}
    keys: dict[str, Key] = {}
    for part in parts:
        fields.update((key, info) for key, info in part.model_fields.items() if key not in fields)
        for key, said in keys_of(part).items():
            row = row_of(key, keys)
            keys[row or key] = said if row is None else keys[row].join(said)
    return create_model(
        name, __base__=base, __doc__=words, __module__=__name__, **dict(_annotations(fields, keys))
    )


def _annotations(fields: Mapping[str, FieldInfo], keys: Mapping[str, Key]) -> Iterator[tuple[str, Any]]:
    for name, info in fields.items():
        own = copy(info)
        own.metadata = [item for item in info.metadata if not isinstance(item, Key)]
        own.metadata += [keys[name]] if name in keys else []
        yield name, (own.annotation, own)
