"""JSON schemas of what is written in files, which name the key that is wrong.

A key may take a table, a list, a number or a word. An editor that finds none of several alternatives right
cannot say which was meant; alternatives of different types are therefore one schema, whose keywords are of
one type each.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

_LIMITS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}
_KEYWORDS = {
    "object": {"properties", "additionalProperties", "required", "propertyNames"},
    "array": {"items", "minItems", "maxItems"},
    "string": {"pattern", "minLength"},
    "number": {*_LIMITS.values()},
    "boolean": set(),
}
_KINDS = {bool: "boolean", int: "number", float: "number", str: "string"}
_SAID = ("title", "description", "default")
_TABLES = "#/$defs/"


class _Generator(GenerateJsonSchema):
    """JSON schemas of what TOML can say: it has no null, and a table that is left out needs no default."""

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        if isinstance(schema.get("default"), (bool, int, float, str)):
            return super().default_schema(schema)
        return self.generate_inner(schema["schema"])

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def json_schema_of(kind: Any) -> dict[str, Any]:
    """Return the JSON schema of what a type, or a table, is written as."""
    return TypeAdapter(kind).json_schema(schema_generator=_Generator)


def unite(schema: Mapping[str, Any]) -> dict[str, Any]:
    """Return a schema in which alternatives of different types are one, at any depth."""
    united: dict[str, Any] = _unite(schema, schema["$defs"])
    return united


def _unite(schema: Any, tables: Mapping[str, Any]) -> Any:
    if isinstance(schema, list):
        return [_unite(entry, tables) for entry in schema]
    if not isinstance(schema, Mapping):
        return schema
    if isinstance(schema.get("anyOf"), list):
        return _of_alternatives(schema, tables)
    return {
        key if isinstance(entry, Mapping) else _LIMITS.get(key, key): _unite(entry, tables)
        for key, entry in schema.items()
    }


def _of_alternatives(schema: Mapping[str, Any], tables: Mapping[str, Any]) -> dict[str, Any]:
    """Keywords of the alternatives that alone are of their types; the others stay alternatives."""
    found: dict[str, Any] = {key: entry for key, entry in schema.items() if key != "anyOf"}
    alternatives = [_unite(one, tables) for one in _alternatives(schema, tables)]
    counts = Counter(kind for one in alternatives for kind in _kinds(one))
    types: list[str] = []
    others = []
    for one in alternatives:
        kinds = _kinds(one)
        keywords = {key: entry for key, entry in one.items() if key not in ("type", *_SAID)}
        if keywords.keys() <= set().union(*(_KEYWORDS[kind] for kind in kinds)) - found.keys() and all(
            counts[kind] == 1 for kind in kinds
        ):
            types += _types(one)
            found |= keywords
        else:
            others.append(one)
    if not others:
        return {**found, "type": types}
    return {**found, "anyOf": [{"type": types}, *others] if types else others}


def _alternatives(schema: Mapping[str, Any], tables: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield them without alternatives and references of their own."""
    if "$ref" in schema:
        yield from _alternatives(tables[schema["$ref"].removeprefix(_TABLES)], tables)
    elif "anyOf" in schema:
        for one in schema["anyOf"]:
            yield from _alternatives(one, tables)
    else:
        yield dict(schema)


def _types(schema: Mapping[str, Any]) -> list[str]:
    found = schema["type"]
    return found if isinstance(found, list) else [found]


def _kinds(schema: Mapping[str, Any]) -> set[str]:
    """Types of which a value may be; whole numbers are numbers."""
    if "type" in schema:
        return {"number" if one == "integer" else one for one in _types(schema)}
    values = schema["enum"] if "enum" in schema else [schema["const"]]
    return {_KINDS[type(value)] for value in values}
