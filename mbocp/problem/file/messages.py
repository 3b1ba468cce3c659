"""Errors of a problem file: they name the file and key, the value, and the allowed values."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from pydantic import BaseModel, ValidationError

from mbocp._keys import NO_KIND, tables_in
from mbocp._text import show
from mbocp.exceptions import DimensionMismatch, InvalidValue, MbocpError, ProblemError, ProblemFileError


@contextmanager
def in_file(path: str) -> Iterator[None]:
    """Name the file in every error from the block.

    Errors of a class of their own (an unknown robot, an inconsistent start) keep it; what is only a wrong
    value becomes a `ProblemFileError`.
    """
    try:
        yield
    except ProblemFileError:
        raise
    except MbocpError as error:
        if isinstance(error, (DimensionMismatch, InvalidValue)) or type(error) is ProblemError:
            key, message = error.key, str(error)
            raise ProblemFileError(path, message.removeprefix(f"{key}: "), key) from error
        error.put_into(path)
        raise


def schema_error(path: str, model: type[BaseModel], error: ValidationError) -> ProblemFileError:
    """Translate everything that pydantic complains about; the first complaint is the error's key."""
    # A misspelt key explains a missing one, so it comes first.
    items = sorted(error.errors(), key=lambda item: item["type"] == "missing")
    keys = (".".join(str(part) for part in item["loc"] if part not in _HIDDEN) for item in items)
    found = [(key, _reason(model, item)) for key, item in zip(keys, items, strict=True)]
    key, reason = found[0]
    return ProblemFileError(path, reason, key, found[1:])


_TOOL = "where a tool should be is the table [goal.frame], with name, position and orientation"
_LOAD = (
    "what some phases carry is a [[robot.part]] with its mass, which [[phase.hold]] joins to the tool; what "
    "all carry is [[robot.payload]]"
)
# What is wanted, and would otherwise be sent to a key of the same name that means something else.
_NOT_THERE = {"phase.payload": _LOAD} | dict.fromkeys(("goal.position", "goal.pose", "goal.point"), _TOOL)

_REPEATED = frozenset(
    {"goal.any", "goal.any.frame", "start.frame", "phase"}
    | {f"phase.{table}" for table in ("limits", "cost", "path", "via", "via.frame", "hold", "release")}
)  # keys that another table has alike
_MAX_VALUE_LENGTH = 60  # characters of a value
_MOST_PLACES = 3  # of a key, that a message names
_HIDDEN = frozenset({"qp"})  # where a plain list of weights lands

# Words of other tools, each with the keys of the same meaning; the first that the table has is named.
OTHER_WORDS = {
    **dict.fromkeys(("torque", "torques", "force", "tau"), ("effort",)),
    **dict.fromkeys(("speed", "speeds", "vel", "velocities", "v", "qd"), ("velocity", "v")),
    **dict.fromkeys(("q", "joints", "qpos", "pos", "positions", "position"), ("position", "q")),
    **dict.fromkeys(("acc", "accel", "accelerations", "qdd", "a"), ("acceleration", "a")),
    **dict.fromkeys(("torque_rate", "torque_rates"), ("effort_rate",)),
    **dict.fromkeys(("xyz", "translation"), ("position",)),
    **dict.fromkeys(("quaternion", "quat", "rotation"), ("orientation",)),
    **dict.fromkeys(("tool", "tcp", "pose", "end_effector", "link"), ("frame", "payload", "name")),
    **dict.fromkeys(("kind", "type", "name", "method", "algorithm"), ("shape", "scheme", "method", "kind")),
    **dict.fromkeys(("urdf", "path", "file", "model", "frame"), ("name",)),
    **dict.fromkeys(("time", "tf", "t_f"), ("duration",)),
    **dict.fromkeys(("n", "nodes", "intervals"), ("steps",)),
    **dict.fromkeys(("clearance", "distance"), ("margin",)),
    "tol": ("tolerance",),
    "smoothness": ("control_rate",),
}
# The paper's letters, for those who write them.
_LETTERS = {
    "alpha": "cost.effort",
    "beta": "cost.tracking",
    "beta_T": "cost.terminal",
    "gamma": "goal.enforce",
    "Q": "cost.tracking_weights",
    "y_d": "goal",
    "y_0": "start",
    "T": "horizon.duration",
    "N": "horizon.steps",
    "dt": "horizon.steps",
}


def _reason(model: type[BaseModel], item: Mapping[str, Any]) -> str:
    kind, loc, got = item["type"], item["loc"], item["input"]
    if kind == "extra_forbidden":
        return _unknown_key(model, loc, got)
    if kind == "missing":
        return "this key is missing"
    if kind == "value_error":
        return str(item["ctx"]["error"])
    expected = _EXPECTED.get(kind, _INPUT.sub("a number ", item["msg"]))
    if kind == "list_type" and isinstance(got, Mapping):
        expected = f"tables, each [[{'.'.join(part for part in loc if isinstance(part, str))}]]"
    if kind == NO_KIND:
        expected = f"a {item['msg']}"
    if kind == "literal_error":
        expected = InvalidValue.of_literal(item).expected
    if kind in ("too_short", "too_long"):
        expected = f"a list of {item['ctx'].get('min_length', item['ctx'].get('max_length'))}"
    return f"got {show(got, _MAX_VALUE_LENGTH)}, expected {expected}"


_INPUT = re.compile("^Input should be (?=greater|less)")
_EXPECTED = {
    "bool_type": "true or false",
    "float_type": "a number",
    "int_from_float": "a whole number",
    "int_type": "a whole number",
    "list_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "string_type": "a string",
}


def _unknown_key(model: type[BaseModel], loc: Sequence[str | int], got: Any) -> str:
    """Say where a stray key belongs: near misses in its table, then the same word in another table."""
    *above, name = (str(part) for part in loc if not isinstance(part, int))  # path.0.x is in [[path]]
    tables = dict(_tables(model))
    valid = tables.get(".".join(above), [])
    where = f"allowed in [{'.'.join(above)}]" if above else "allowed here"
    listed = f"{where}: {', '.join(valid)}"
    if name in _LETTERS:
        return f"unknown key, did you mean {_LETTERS[name]}? ({listed})"
    if (advice := _NOT_THERE.get(".".join([*above, name]).replace("goal.any.", "goal."))) is not None:
        return f"unknown key; {advice} ({listed})"
    others = {table: keys for table, keys in tables.items() if table not in _REPEATED}
    elsewhere = [f"{table}.{name}" if table else name for table, keys in others.items() if name in keys]
    same = [repr(word) for word in OTHER_WORDS.get(name, ()) if word in valid][:1]
    near = [repr(word) for word in difflib.get_close_matches(name, valid, n=1)]
    if likely := same or elsewhere[:_MOST_PLACES] or near:
        return f"unknown key, did you mean {' or '.join(likely)}? ({listed})"
    if isinstance(got, Mapping) and "name" in valid:
        return f"unknown key; if it is a name, write name = {show(name)} among its keys ({listed})"
    return f"unknown key ({listed})"


def _tables(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, list[str]]]:
    yield prefix, [name for name in model.model_fields if name not in _HIDDEN]
    for name, field in model.model_fields.items():
        for inner in tables_in(field.annotation)[:1]:
            yield from _tables(inner, f"{prefix}.{name}" if prefix else name)
