"""Keys of files, each declared once: name, kind of value, unit, default, check and meaning.

A key is a field of a `Table` that is annotated with a `Key`. Whether a file is right follows from there, and
so do the page of keys and the JSON schema that editors use.
"""

from __future__ import annotations

import re
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from mbocp._json_schema import json_schema_of
from mbocp._measured import KeyUnits

NO_KIND = "no_kind"  # pydantic's errors of values that are of none of the kinds that a key takes
_LINK = re.compile(r"\[([^\]]+)\]\([^)]+\)")
_WORDS = {float: "number", int: "whole number", str: "string", bool: "boolean"}


def without_links(words: str) -> str:
    """Return Markdown with the words of links in their place."""
    return _LINK.sub(r"\1", words)


@dataclass(frozen=True)
class Takes:
    """What a key takes of a kind of value: in words for the page of keys, and as JSON schema.

    Attributes
    ----------
    takes : str
        In words.
    schema : mapping
        Of JSON.
    """

    takes: str
    schema: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Complain with the words that there are, where it takes only some."""
        found, words = handler(source), " | ".join(f'"{word}"' for word in self.schema.get("enum", ()))
        error = core_schema.custom_error_schema
        return error(found, "no_word", custom_error_message=words) if words else found

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Return the schema of the kind, narrowed."""
        return {**handler(schema), **self.schema}


@dataclass(frozen=True)
class Check(Takes):
    """What is checked when the key becomes a value of the problem.

    Attributes
    ----------
    work : callable
        Takes the key's dotted name and a value; returns the value, or raises InvalidValue.
    """

    work: Callable[[str, Any], Any] = field(kw_only=True)


@dataclass(frozen=True)
class Kind:
    """A kind of value: how it is read, and how people write it.

    Attributes
    ----------
    takes : str
        In words, for the page of keys.
    read : callable
        Takes what is written, and returns the value, or raises ValueError.
    written : type
        What people write; beside the annotated type, unless that is Any.
    """

    takes: str
    read: Callable[[Any], Any]
    written: Any

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Read what is written, then check the type."""
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Return the schema of what people write."""
        inner, written = handler(schema), json_schema_of(self.written)
        if written.items() <= inner.items():
            return inner
        return {"anyOf": [written, inner]} if inner else written


@dataclass(frozen=True)
class OneOrSeveral(Kind):
    """A list, of which one entry may stand by itself."""

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Return the schema of one entry, or a list of them."""
        several = handler(schema)
        short = [] if self.written is None else [json_schema_of(self.written)]
        one = {"anyOf": [*short, several["items"]]} if short else several["items"]
        return {"anyOf": [one, {**several, "items": one}]}


@dataclass(frozen=True)
class Key:
    """What is said of a key, beside its name, kind and default.

    Attributes
    ----------
    says, unit : str
        Meaning and unit, in Markdown.
    default, takes : str
        In words, where the value, and the kind, do not say it.
    beside : tuple of str
        Keys that the same line describes.
    weight : str
        Key of the same table without which this one says nothing; then it has to be empty.
    """

    says: str
    unit: str = ""
    default: str = ""
    takes: str = ""
    beside: tuple[str, ...] = ()
    weight: str = ""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Complain once where none of several kinds of values fits, and not once for each."""
        found = handler(source)
        inner: Any = found
        while inner["type"] in ("nullable", "function-before"):
            inner = inner["schema"]
        if inner["type"] == "union":
            inner["custom_error_type"] = NO_KIND
            inner["custom_error_message"] = self.takes or _words(source)
        return found

    @property
    def description(self) -> str:
        """What is said, as sentences for editors."""
        says = without_links(self.says)
        unit, default = f" [{self.unit}]" * bool(self.unit), f" Default: {self.default}." * bool(self.default)
        return f"{says[:1].upper()}{says[1:]}{unit}.{default}"

    def unit_of(self, name: str, row: str) -> str:
        """Return the unit of one of the keys of a row: semicolons part theirs, or those of columns."""
        names, units = (row, *self.beside), self.unit.split("; ")
        return units[names.index(name)] if len(units) == len(names) else self.unit

    def join(self, other: Key) -> Key:
        """Return what is said of a key of several tables."""
        units = dict.fromkeys([*self.unit.split(", "), *other.unit.split(", ")])
        is_said = f"; {other.says};" in f"; {self.says};"
        says = self.says if is_said else f"{self.says}; {other.says}"
        return replace(self, unit=", ".join(units), says=says)


def key_of(info: FieldInfo) -> Key | None:
    """Return what is said of a field of a table; None where another key's line says it."""
    return next((item for item in reversed(info.metadata) if isinstance(item, Key)), None)


def keys_of(table: type[BaseModel]) -> dict[str, Key]:
    """Return what is said of the keys of a table, by name."""
    said = {name: key_of(info) for name, info in table.model_fields.items()}
    return {name: key for name, key in said.items() if key is not None}


def checks_of(table: type[BaseModel]) -> dict[str, Callable[[str, Any], Any]]:
    """Return the checks of the keys of a table, by name."""
    fields = table.model_fields.items()
    return {name: item.work for name, info in fields for item in info.metadata if isinstance(item, Check)}


def row_of(name: str, keys: Mapping[str, Key]) -> str | None:
    """Return the key whose line describes a key of this name."""
    return next((first for first, key in keys.items() if name in (first, *key.beside)), None)


class KeyGroup(BaseModel):
    """Some keys of a table, each declared."""

    model_config = ConfigDict(defer_build=True)

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Let keys with a unit take numbers that have one."""
        keys = keys_of(cls)
        for name, info in cls.model_fields.items():
            row = row_of(name, keys)
            kinds = () if get_origin(info.annotation) is dict else get_args(info.annotation)
            if row is not None and str not in (info.annotation, *kinds):
                others = [item for item in info.metadata if not isinstance(item, KeyUnits)]
                measured = KeyUnits(keys[row].unit_of(name, row))
                info.metadata = [*others, measured] if measured.is_known else others

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler, /
    ) -> JsonSchemaValue:
        """Return the schema, in which keys of one line are described alike, and need their weights."""
        found, keys = handler(schema), keys_of(cls)
        table = handler.resolve_ref_schema(found)
        properties, weighed = table["properties"], []
        for name in cls.model_fields:
            if (row := row_of(name, keys)) is not None:
                properties[name] = {**properties[name], "description": keys[row].description}
                if weight := keys[row].weight:
                    then = {"properties": {name: {"type": "object", "maxProperties": 0}}}
                    weighed.append({"if": {"not": {"required": [weight]}}, "then": then})
        if weighed:
            table["allOf"] = weighed
        return found


class Table(KeyGroup):
    """A table of a problem file: keys that it does not have are refused."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, defer_build=True)


def takes_of(info: FieldInfo) -> str:
    """Return in words what a key takes."""
    key = key_of(info)
    return key.takes if key is not None and key.takes else _words(info.annotation, info.metadata)


def default_of(info: FieldInfo) -> str:
    """Return in words what holds where a key is left out."""
    key = key_of(info)
    if key is not None and key.default:
        return key.default
    if info.is_required():
        return "required"
    value = info.get_default(call_default_factory=True)
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return f"{value:g}".replace("e-0", "e-")
    if isinstance(value, BaseModel):
        return ""
    return f'`"{value}"`' if isinstance(value, str) else "none"


def _words(annotation: Any, metadata: Sequence[Any] = ()) -> str:
    """The words of a kind of value, or those of plain types."""
    for item in reversed(metadata):
        if isinstance(item, (Takes, Kind)):
            return item.takes
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _words(arguments[0], arguments[1:])
    if origin is Literal:
        return ", ".join(f'`"{word}"`' for word in arguments)
    if origin in (Union, types.UnionType):
        return ", or ".join(_words(one) for one in arguments if one is not types.NoneType)
    if origin is list:
        of_what = "list" if get_origin(arguments[0]) is list else _words(arguments[0])
        return "tables" if tables_in(annotation) else f"list of {of_what}s"
    return _WORDS.get(annotation, "table")


def tables_in(annotation: Any) -> list[type[BaseModel]]:
    """Return the tables that a key may be."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    found = (table for argument in get_args(annotation) for table in tables_in(argument))
    return list(dict.fromkeys(found))
