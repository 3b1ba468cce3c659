"""`Problem.with_`: a problem with other fields, or other keys of the tables that it was made from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from functools import partial
from typing import Any, TypeVar

from mbocp._text import shown
from mbocp.exceptions import ProblemError, suggest
from mbocp.problem.cost import Cost
from mbocp.problem.default_scheme import AUTO_SCHEME
from mbocp.problem.file.overrides import plain
from mbocp.problem.file.read import from_tables
from mbocp.problem.file.tables import ProblemFields, tables_of
from mbocp.problem.goals.goal import Goal
from mbocp.problem.guess import Guess
from mbocp.problem.limits import Bounds
from mbocp.problem.solver import SolverOptions
from mbocp.problem.timeline.duration import duration_from
from mbocp.problem.timeline.named_phase import horizon_of
from mbocp.problem.timeline.phase_holds import takes_switches
from mbocp.problem.timeline.step_counts import FIRST_STEPS
from mbocp.problem.timeline.step_table import scaled_lengths

__all__ = ["changed", "written_tables"]

P = TypeVar("P", bound=ProblemFields)

_TABLES = ("start", "goal", "cost", "limits", "guess", "integrator", "solver")
_VALUES = {"goal": Goal, "cost": Cost, "limits": Bounds, "guess": Guess, "solver": SolverOptions}
_SWITCHES = ("holds", "releases", "impacts")
_RATES = {"v": "p", "p": "v"}  # of start and goal: one takes the place of the other


def changed(problem: P, changes: Mapping[str, Any]) -> P:
    """Return the problem with `changes`: fields of `Problem`, or words of `Problem.create`.

    Raises
    ------
    ProblemError
        If there is no such field or word, or a value is of the wrong kind.
    """
    values = dict(changes)
    if "steps" in values:
        values["num_steps"] = values.pop("steps")
    tables = {name: values.pop(name) for name in list(values) if _is_table(name, values[name])}
    if "duration" in values:
        written = plain(values.pop("duration"))
        values = {**duration_from(written), **values}
        if tables:  # at once: what they ask for may need it
            tables["horizon"] = {"duration": written}
    if values.get("accuracy") is not None and not values.get("phase", problem.phase):
        values.setdefault("num_steps", FIRST_STEPS)
    values = {**_new_lengths(problem, values), **values}
    if values.get("phase"):
        whole = horizon_of(values["phase"])
        values = {
            "num_steps": whole.steps,
            "duration": whole.duration,
            "duration_range": whole.duration_range,
            **dict.fromkeys(_SWITCHES, ()),  # those of the phases before
            **values,
        }
    if isinstance(values.get("goal"), Goal):
        values.setdefault("goals", ())  # in the place of several
    if problem.chooses_scheme and "scheme" not in tables.get("integrator", ()):
        values.setdefault("scheme", AUTO_SCHEME)  # what suits may be another now
    known = [field.name for field in fields(problem) if field.init]
    for name, value in values.items():
        if name in _VALUES and not isinstance(value, _VALUES[name]):
            raise ProblemError(f"{name}: got {shown(value)}, expected a table, or a {_VALUES[name].__name__}")
        if name in ("start", "integrator"):
            raise ProblemError(f"{name}: got {shown(value)}, expected a table")
        if name not in known:
            words = [*_TABLES, "phase", "via", "path", "obstacle", "steps", *known]
            raise ProblemError(
                f"{name}: a problem has no such field: {suggest(name, dict.fromkeys(words), 40)}"
            )
    made = _with_tables(problem, tables) if tables else problem
    return replace(made, **values) if values or made is problem else made  # what has been made is checked


def _new_lengths(problem: ProblemFields, values: Mapping[str, Any]) -> dict[str, Any]:
    """Lengths of steps where their number or the duration changes."""
    if problem.lengths is None or not values.keys() & {"num_steps", "duration", "accuracy", "phase"}:
        return {}
    if values.keys() & {"num_steps", "accuracy", "phase"} or values.get("duration_range") is not None:
        return {"lengths": None}
    return {"lengths": scaled_lengths(problem.lengths, float(values["duration"]))}


def _is_table(name: str, value: Any) -> bool:
    if name in ("phase", "via", "path", "obstacle"):
        return isinstance(value, (list, tuple)) and any(isinstance(entry, Mapping) for entry in value)
    return name in _TABLES and isinstance(value, Mapping)


def _goal_of_several(old: Mapping[str, Any], table: Mapping[str, Any]) -> dict[str, Any]:
    """Several goals take the place of what there was; other keys change in each of those that there are."""
    if "any" in table:
        return dict(table)
    others = [{k: v for k, v in member.items() if _RATES.get(k) not in table} for member in old["any"]]
    return {"any": [{**member, **table} for member in others]}


def _maker(problem: P, tables: Mapping[str, Any]) -> Callable[..., P]:
    """What makes the changed problem; holds that no phase says have no table, and are kept."""
    if "phase" in tables or takes_switches(problem.phase):
        return type(problem)
    return partial(type(problem), **{name: getattr(problem, name) for name in _SWITCHES})


def written_tables(problem: ProblemFields) -> dict[str, Any]:
    """Tables of a problem as they are read from its file: without what is None, and without empty tables."""
    return {name: table for name, table in _without_none(plain(tables_of(problem))).items() if table != {}}


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(entry) for key, entry in value.items() if entry is not None}
    return [_without_none(entry) for entry in value] if isinstance(value, list) else value


def _with_tables(problem: P, tables: Mapping[str, Any]) -> P:
    """Take the problem's tables as a file has them, put keys into them, and read them again."""
    document = written_tables(problem)
    if problem.chooses_scheme:
        document["integrator"]["scheme"] = AUTO_SCHEME
    for name, value in tables.items():
        table = plain(value)
        if name in ("phase", "via", "path", "obstacle", "guess"):  # lists, and a kind with what belongs to it
            document[name] = table
            if name == "phase" and "horizon" not in tables:  # it says how long all is
                del document["horizon"]
            continue
        old = document.get(name, {})
        if name == "goal" and "any" in {**old, **table}:
            document[name] = _goal_of_several(old, table)
            continue
        if name in ("start", "goal"):
            old = {key: entry for key, entry in old.items() if _RATES.get(key) not in table}
        if name == "goal" and "frame" in table and isinstance(old.get("q"), list):  # it gives every joint
            del old["q"]
        document[name] = {**old, **table}
    return from_tables(
        _maker(problem, tables),
        document,
        robot=problem.robot,
        source=problem.source,
        label=problem.name,
        name=problem.name,
        terms=problem.terms,
    )
