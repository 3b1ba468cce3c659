"""The first complaint of pydantic about tables of robots, in the words of the file."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar

from pydantic import BaseModel, ValidationError

from mbocp._arrays import plain
from mbocp._text import show
from mbocp.exceptions import RobotError, suggest

_Model = TypeVar("_Model", bound=BaseModel)
Allowed: TypeAlias = Callable[[tuple[int | str, ...]], list[str]]  # keys of the table that one stands in


def first_complaint(error: ValidationError, data: Any, allowed: Allowed) -> tuple[str, str]:
    """Key and words of the first complaint."""
    first = error.errors()[0]
    more = f" ({error.error_count() - 1} more)" if error.error_count() > 1 else ""
    return _key(data, first["loc"], absent=first["type"] == "missing"), _reason(first, data, allowed) + more


def refusal(error: ValidationError, where: str, data: Any, allowed: Allowed) -> RobotError:
    """Make the error for a table that stands in no file of its own; `where` names it."""
    key, reason = first_complaint(error, data, allowed)
    return RobotError(f"{'.'.join(word for word in (where, key) if word)}: {reason}")


def read_table(model: type[_Model], value: Any, where: str) -> _Model:
    """Read a table that Python gives; `where` names it.

    Raises
    ------
    RobotError
        For an unknown or missing key or a wrong value, naming it.
    """
    data = plain(value)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise refusal(error, where, data, lambda _: list(model.model_fields)) from error


def _key(data: Any, loc: tuple[int | str, ...], *, absent: bool) -> str:
    """Dotted key as in the file, e.g. constraint[0].frames, without pydantic's tags for unions."""
    parts: list[str] = []
    node, last = data, len(loc) - 1
    for position, step in enumerate(loc):
        if isinstance(step, int):
            parts.append(f"[{step}]")
        elif (absent and position == last) or _has(node, step, is_last=position == last):
            parts.append(f".{step}")
        else:
            continue
        node = _child(node, step)
    return "".join(parts).lstrip(".")


def _has(node: Any, step: str, *, is_last: bool) -> bool:
    """Whether a step leads on: a tag may have the name of a key, which holds no more steps."""
    return isinstance(node, dict) and step in node and (is_last or isinstance(node[step], dict | list))


def _child(node: Any, step: int | str) -> Any:
    if isinstance(node, dict):
        return node.get(step)
    return node[step] if isinstance(node, list) and isinstance(step, int) and step < len(node) else None


def _reason(error: Any, data: Any, allowed: Allowed) -> str:
    kind, context, got = error["type"], error.get("ctx", {}), error["input"]
    if kind == "extra_forbidden":
        return f"unknown key; {suggest(str(error['loc'][-1]), allowed(error['loc']))}"
    if kind == "missing":
        return "this key is required" if isinstance(error["loc"][-1], str) else "this number is missing"
    if kind == "union_tag_not_found":
        return f"type is required: {_plain(context.get('discriminator', 'type'))}"
    if kind == "union_tag_invalid":
        return f"unknown type {show(context['tag'])}, known: {_plain(context['expected_tags'])}"
    if kind == "literal_error":
        what = "unknown type" if error["loc"][-1] == "type" else "got"
        return f"{what} {show(got)}, known: {_plain(context['expected'])}"
    if kind == "model_type":
        return f"got {show(got)}, expected a table"
    message = error["msg"].removeprefix("Value error, ")
    return message if kind == "value_error" else f"got {show(got)}: {message}"


def _plain(text: str) -> str:
    return text.replace("'", "").replace(" or ", ", ")
