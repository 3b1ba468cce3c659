"""What `Problem.with_` changes: keys of the tables that a problem was made from, or values in their place."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from mbocp._arrays import plain
from mbocp._keys import Table
from mbocp._quantities import Quantity
from mbocp._text import show
from mbocp.exceptions import ProblemError, suggest
from mbocp.problem.document import UNSAID, Document, robot_in
from mbocp.problem.file.goal_table import GoalMemberTable
from mbocp.problem.file.overrides import SHORT, without_rivals
from mbocp.problem.file.path_table import path_tables
from mbocp.problem.file.read_tables import READ, ProblemTable
from mbocp.problem.goals.goal import Goal
from mbocp.problem.limits import Bounds
from mbocp.problem.path import PathConstraint
from mbocp.problem.pipeline import Step
from mbocp.problem.solver import Guess, SolverOptions
from mbocp.problem.timeline.phase import check_phase
from mbocp.problem.timeline.sequence import in_order
from mbocp.problem.timeline.step_counts import scale_lengths
from mbocp.problem.timeline.timeline import Timeline
from mbocp.problem.timeline.times import write_duration
from mbocp.problem.weights import Cost

_TABLES = [
    n for n, info in ProblemTable.model_fields.items() if isinstance(info.default, Table) and n != "horizon"
]
_LISTS = [n for n, info in ProblemTable.model_fields.items() if info.default_factory is list and n != "terms"]
_WHOLE = (*_LISTS, "guess", "self_collision")  # lists, and kinds with what belongs to them
_OBJECTS = {"goal": Goal, "cost": Cost, "limits": Bounds, "guess": Guess, "solver": SolverOptions}
_OPTIONAL = ("ground", "gait", "robust")  # tables that are there or not
_INNER = (
    "is_cycle",
    "phases_of_gait",
    "phases_on_ground",
    "forces_of_feet",
    "free_feet",
    "phases_unweighted",
    "cost_reader",
    "own_path",
    "path_of_others",
)
_ABOUT = ("robot", "terms", "source", "name", "coordinates")


def _table_of(step: Step) -> str:
    """The table that a step reads: the first that it takes."""
    return next((name.removesuffix("_table") for name in step.takes if name.endswith("_table")), "")


# Of each field: its name among what is said, and the table that says it.
_SAID = {name.removeprefix("said_"): (name, _table_of(step)) for step in READ for name in step.gives}
_HORIZON, _INTEGRATOR = (
    [name for name, (_, table) in _SAID.items() if table == one] for one in ("horizon", "integrator")
)
# Of each field that is given as a value, in the place of keys.
FIELDS = {
    name: said
    for name, said in {**_SAID, **{name.removeprefix("said_"): (name, "") for name in UNSAID}}.items()
    if name not in (*_HORIZON, *_INTEGRATOR, *_ABOUT, *_INNER)
} | {"lengths": _SAID["lengths"], "phase": ("said_phase", "phase"), "path": ("own_path", "path")}

Written = Callable[[], Mapping[str, Any]]


def change_document(
    document: Document,
    changes: Mapping[str, Any],
    made: Timeline,
    written: Written,
    paths: tuple[Sequence[object], Sequence[object]] = ((), ()),
) -> tuple[Document, bool]:
    """Return the document with `changes`, and whether tables are among them.

    Parameters
    ----------
    document : Document
    changes : mapping of str
        Fields of `Problem`, or words of `Problem.create`.
    made : Timeline
        That of the problem that was made from the document.
    written : callable
        Returns the tables of that problem: those of values that are changed by their keys are taken from it.
    paths : tuple of two sequences of BoundedTerm
        Its own path constraints, and those of other tables, which stay, whatever path is given; those of a
        profile stay with the profile.

    Raises
    ------
    ProblemError
        If there is no such field or word, or a value is of the wrong kind.
    """
    values = dict(changes)
    if "steps" in values:
        values["num_steps"] = values.pop("steps")
    if "path" in values and _changes_profile(values) and not _is_table("path", values["path"]):
        values["path"] = path_tables(document.robot, _own_rows(values["path"], paths[1]))
    tables = {name: values.pop(name) for name in list(values) if _is_table(name, values[name])}
    _check_words(values)
    changed = _with_tables(document, tables, written)
    changed = _with_horizon(changed, tables, values, made)
    changed = _with_integrator(changed, values)
    given = {FIELDS[name][0]: _value_of(name, values[name]) for name in FIELDS.keys() & values.keys()}
    if "own_path" in given:
        rows = _own_rows(given["own_path"], paths[1])
        given["own_path"] = (*rows, *filter(_is_of_profile, paths[0]))
    if "said_goal" in given:
        given.setdefault("goals", ())  # in the place of several
    if "said_phase" in given:
        given["phases_unweighted"] = given["said_phase"]
    changed = _with_about(changed, values).with_values(given)
    return changed, bool(tables)


def _check_words(values: Mapping[str, Any]) -> None:
    known = (*_HORIZON, *_INTEGRATOR, *_ABOUT, *FIELDS)
    for name, value in values.items():
        if name in _OBJECTS and not isinstance(value, _OBJECTS[name]):
            kind = _OBJECTS[name].__name__
            raise ProblemError(f"{name}: got {show(value)}, expected a table, or a {kind}")
        if name in ("start", "integrator"):
            raise ProblemError(f"{name}: got {show(value)}, expected a table")
        if name not in known:
            words = dict.fromkeys([*_TABLES, *_OPTIONAL, *_LISTS, "steps", *known])
            raise ProblemError(f"{name}: a problem has no such field: {suggest(name, words, 40)}")


def _is_table(name: str, value: Any) -> bool:
    if name in _LISTS:
        is_empty = name == "path" and not len(value)
        return isinstance(value, (list, tuple)) and (
            is_empty or any(isinstance(entry, Mapping) for entry in value)
        )
    return name in (*_TABLES, *_OPTIONAL, "self_collision") and isinstance(value, Mapping)


def _value_of(name: str, value: Any) -> Any:
    if name == "phase":
        return in_order([check_phase(phase) for phase in value])
    if name in _LISTS or name in ("goals", "holds", "releases", "impacts"):
        return tuple(value)
    return np.array(value, dtype=np.float64) if isinstance(value, (np.ndarray, list)) else value


def _with_tables(document: Document, tables: Mapping[str, Any], written: Written) -> Document:
    """Put keys into tables; tables for which values stand are written first."""
    found, values, of_profile = dict(document.tables), dict(document.values), list[Any]()
    for name, value in tables.items():
        stand_in = [key for key, table in FIELDS.values() if table == name and key in values]
        if stand_in:
            found[name] = written().get(name, {})
        if name == "path":
            of_profile = [row for row in found.get(name) or () if row.get("profile")]
        for key in (*stand_in, *(("phases_unweighted",) if name == "phase" else ())):
            values.pop(key, None)
        found[name] = _change_table(name, found.get(name), plain(value))
    if of_profile and "profile" not in found.get("limits", {}):  # of a result, which has them as numbers
        found["path"] = [*found["path"], *of_profile]
    if _changes_profile(tables):
        if (own := values.pop("own_path", None)) is not None:
            found["path"] = path_tables(document.robot, own)
        found["path"] = [row for row in found.get("path", ()) if not row.get("profile")]
    if "phase" in tables:  # it says how long all is, and what is held
        found["horizon"] = _without(found.get("horizon", {}), "duration", "steps", "lengths")
        values = {key: value for key, value in values.items() if key not in ("said_holds", "said_releases")}
        values.pop("said_impacts", None)
    return replace(document, tables=found, values=values)


def _changes_profile(changes: Mapping[str, Any]) -> bool:
    limits = changes.get("limits")
    return isinstance(limits, Mapping) and "profile" in limits


def _own_rows(path: Sequence[Any], others: Sequence[object]) -> list[Any]:
    """Path constraints but those of a profile or of other tables."""
    return [row for row in path if not (_is_of_profile(row) or row in others)]


def _is_of_profile(row: object) -> bool:
    return isinstance(row, PathConstraint) and row.profile is not None


def _change_table(name: str, old: Any, table: Any) -> Any:
    if name in _WHOLE:
        return table
    if old is None or (name == "limits" and "profile" in table):
        old = {}
    if isinstance(old, str):
        old = {SHORT[name]: old}
    if name == "goal" and "any" in {**old, **table}:
        return _goal_of_several(old, table)
    if name in ("start", "goal"):
        old = without_rivals(name, old, table)
    if name == "goal" and "frame" in table and isinstance(old.get("q"), list):  # it gives every joint
        old = _without(old, "q")
    return {**old, **table}


def _goal_of_several(old: Mapping[str, Any], table: Mapping[str, Any]) -> dict[str, Any]:
    """Several goals take the place of what there was; other keys change in each of those that there are."""
    if "any" in table:
        return dict(table)
    others = [without_rivals("goal", member, table) for member in old["any"]]
    of_all = {k: v for k, v in table.items() if k not in GoalMemberTable.model_fields}
    of_each = {k: v for k, v in table.items() if k not in of_all}
    return {**old, **of_all, "any": [{**member, **of_each} for member in others]}


def _without(table: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key not in keys}


def _with_horizon(
    document: Document, tables: Mapping[str, Any], values: Mapping[str, Any], made: Timeline
) -> Document:
    """Steps and duration; one way to say which steps there are takes the place of another."""
    if not (values.keys() & {*_HORIZON, "phase"} or "phase" in tables):
        return document
    has_phases = bool(values["phase"] if "phase" in values else tables.get("phase", made.named_phases))
    table = _horizon_now(document, values, made, has_phases=has_phases)
    if "duration" in values or "duration_range" in values:
        bounds = values.get("duration_range")
        duration = values.get("duration", made.duration)
        table["duration"] = plain(duration) if bounds is None else write_duration(duration, bounds)
    for key, word in (("num_steps", "steps"), ("accuracy", "accuracy")):
        if values.get(key) is not None:
            table = {**_without(table, "steps", "accuracy"), word: plain(values[key])}
    if "controls" in values:
        table["controls"] = values["controls"]
    given = {key: value for key, value in document.values.items() if key != "said_lengths"}
    lengths = None if "phase" in tables else _lengths(values, made, table)
    if lengths is not None:
        given["said_lengths"] = lengths
        if not has_phases:
            table = {**_without(table, "accuracy"), "steps": table.get("steps", made.num_steps)}
    return replace(document, tables={**document.tables, "horizon": table}, values=given)


def _horizon_now(
    document: Document, values: Mapping[str, Any], made: Timeline, *, has_phases: bool
) -> dict[str, Any]:
    """The table with all that it does not leave to phases; without lengths of steps."""
    old = _without(document.tables.get("horizon", {}), "lengths")
    if values.get("phase"):  # they say how long all is
        return _without(old, "duration", "steps", "accuracy")
    if "accuracy" in values:
        old = _without(old, "accuracy")
    if has_phases:
        return old
    steps = {} if "accuracy" in old else {"steps": made.num_steps}
    return {**old, "duration": write_duration(made.duration, made.duration_range), **steps}


def _lengths(values: Mapping[str, Any], made: Timeline, table: Mapping[str, Any]) -> Any:
    """Lengths of the steps that are said, or those from before, as long as these go on."""
    if "lengths" in values:
        return values["lengths"]
    is_other = values.keys() & {"num_steps", "accuracy", "phase"} or isinstance(
        table.get("duration"), Mapping
    )
    if made.given_lengths is None or is_other:
        return None
    duration = table["duration"]
    seconds = Quantity.of(duration, ("s",)) if isinstance(duration, str) else float(duration)
    return None if seconds is None else scale_lengths(made.given_lengths, seconds)


def _with_integrator(document: Document, values: Mapping[str, Any]) -> Document:
    words = {key: values[key] for key in _INTEGRATOR if key in values}
    if not words:
        return document
    rates = words.pop("stabilisation", None)
    words |= {} if rates is None else asdict(rates)
    table = {**document.tables.get("integrator", {}), **plain(words)}
    return replace(document, tables={**document.tables, "integrator": table})


def _with_about(document: Document, values: Mapping[str, Any]) -> Document:
    about = {key: values[key] for key in ("source", "name") if key in values}
    if "robot" in values:
        about["robot"] = robot_in(document, values["robot"])
    if "terms" in values:
        about["terms"] = tuple(values["terms"])
        about["tables"] = _without(document.tables, "terms")
    if "coordinates" in values:
        about["tables"] = {**about.get("tables", document.tables), "coordinates": values["coordinates"]}
    return replace(document, **about) if about else document
