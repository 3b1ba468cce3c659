"""Terms of one's own in the text of a problem: name, digest and numbers, without the function."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from mbocp._arrays import frozen_array
from mbocp._keys import Key, Table
from mbocp._merged import merge_tables
from mbocp._text import warn_caller
from mbocp.exceptions import ProblemError
from mbocp.problem._checks import ProblemWarning, choice
from mbocp.robot import Robot
from mbocp.terms.own import ROLES, OwnTerm
from mbocp.terms.span import Span, SpanKeys
from mbocp.terms.written import Bound, Finite, VectorOrNumber


class TermHead(Table):
    """Keys of a term of one's own."""

    name: Annotated[str, Key("which term, and a digest of its function", beside=("role", "digest"))]
    role: Annotated[str, choice(ROLES)]
    digest: str
    weight: Annotated[
        Finite | None,
        Key(
            "its numbers",
            "",
            "those of the term",
            "numbers, string, lists, table",
            ("unit", "lower", "upper", "parameters"),
        ),
    ] = None
    unit: str | None = None
    lower: list[Bound] | None = None
    upper: list[Bound] | None = None
    parameters: dict[str, VectorOrNumber] = Field(default_factory=dict)


TermTable = merge_tables(
    "TermTable",
    "What the text of a problem says of a term of one's own, whose function it does not hold.",
    (SpanKeys,),
    TermHead,
)


def terms_from(
    robot: Robot, terms_table: Sequence[TermHead], terms_given: Sequence[OwnTerm]
) -> tuple[OwnTerm, ...]:
    """Terms with the numbers of the tables, then those of `terms_given` that no table names.

    Raises
    ------
    ProblemError
        If a table names a term that is not given: its function is not in the text.
    """
    by_name = {term.name: term for term in terms_given}
    found = [_term(robot, table, by_name.get(table.name)) for table in terms_table]
    named = {table.name for table in terms_table}
    return (*found, *(term for term in terms_given if term.name not in named))


def _term(robot: Robot, table: TermHead, given: OwnTerm | None) -> OwnTerm:
    what = ROLES.get(table.role, table.role)
    if given is None or given.role != table.role:
        raise ProblemError(
            f"terms: {table.name!r} is missing, a {what} of one's own (digest {table.digest[:8]}): its "
            "function is Python, which the text of a problem does not hold; load the problem in Python with "
            f"terms=[...] and a term of this name, or take it out of [[terms]]"
        )
    if set(table.parameters) != set(given.parameters):
        got, expected = (", ".join(names) or "none" for names in (table.parameters, given.parameters))
        raise ProblemError(f"terms: {table.name}: parameters: got {got}, expected {expected}")
    changes: dict[str, Any] = {
        "parameters": {name: frozen_array(value) for name, value in table.parameters.items()}
    }
    if table.weight is not None:
        changes["weight"] = table.weight
    if table.unit is not None:
        changes["unit"] = table.unit
    if given.role == "path":
        changes["span"] = Span.read(table)
    for side in ("lower", "upper"):
        if getattr(table, side) is not None:
            changes[side] = frozen_array(getattr(table, side))
    term = replace(given, **changes)
    if term.digest(robot) != table.digest:
        warn_caller(
            f"terms: {table.name!r} is not the one that the text was written with: its expression has "
            f"another digest ({term.digest(robot)[:8]}, and not {table.digest[:8]})",
            ProblemWarning,
        )
    return term


def write_term(robot: Robot, term: OwnTerm) -> dict[str, Any]:
    """Return the table `[[terms]]` of a term."""
    table: dict[str, Any] = {"name": term.name, "role": term.role, "digest": term.digest(robot)}
    if term.role in ("running", "terminal"):
        table["weight"] = term.weight
    if term.role == "path":
        lower, upper = term.bounds(robot)
        table |= {"unit": term.unit, "lower": lower, "upper": upper, **term.span.write()}
    if term.parameters:
        table["parameters"] = {name: np.asarray(value) for name, value in term.parameters.items()}
    return table
