"""What is said of a problem: the tables of its file, and values that a program gives in their place.

It is all that `Problem.with_` changes. A problem is worked out of it, see `mbocp.problem.resolve`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from pathlib import Path
from typing import Any

import numpy as np

from mbocp._arrays import dataclass, frozen_array, plain
from mbocp._text import printable
from mbocp.exceptions import locate
from mbocp.problem.file.messages import in_file
from mbocp.problem.file.read_tables import READ, ProblemTable, read_tables
from mbocp.problem.pipeline import run_steps
from mbocp.robot import Robot
from mbocp.robot.loading.loaders import load_keys
from mbocp.terms import OwnTerm

UNSAID: dict[str, Any] = {"said_holds": (), "said_releases": (), "said_impacts": ()}  # no table says them


@dataclass(frozen=True, eq=False)
class Document:
    """Tables, and what they are read with.

    Attributes
    ----------
    tables : mapping of str
        As in a problem file, without that of the robot; of plain values.
    robot : Robot
    values : mapping of str
        Arrays and objects that stand for what tables would say, by the names of `mbocp.problem.resolve`.
    terms : tuple of OwnTerm
        Terms of one's own: those that the tables name, and others.
    source : Path, optional
        The file; relative paths are relative to its folder.
    label : str
        What errors call the file.
    name : str
        Of the problem.
    """

    tables: Mapping[str, Any]
    robot: Robot
    values: Mapping[str, Any] = field(default_factory=dict)
    terms: tuple[OwnTerm, ...] = ()
    source: Path | None = None
    label: str = "problem"
    name: str = "problem"

    def with_values(self, values: Mapping[str, Any]) -> Document:
        """Return the document with more values, of which arrays are copied."""
        copies = {
            key: frozen_array(value) if isinstance(value, np.ndarray) else value
            for key, value in values.items()
        }
        return replace(self, values={**self.values, **copies})


def make_document(
    document: Mapping[str, Any],
    *,
    robot: Robot | str | Path | Mapping[str, Any] | None = None,
    source: Path | None = None,
    label: str = "problem",
    name: str = "",
    terms: tuple[OwnTerm, ...] = (),
) -> Document:
    """Check tables, and load the robot that they name, or `robot`, which takes the place of the key.

    Raises
    ------
    ProblemFileError
        If a key is unknown, or a value of the wrong kind.
    MbocpError
        If the robot cannot be loaded.
    """
    tables = dict(plain(document))
    if robot is not None:
        tables["robot"] = "" if isinstance(robot, Robot) else plain(robot)
    loaded = _load(robot, tables, source, label)
    tables.pop("robot", None)
    name = name or (printable(source.stem) if source else "problem")
    return Document(tables, loaded, {}, terms, source, label, name)


def _load(
    robot: Robot | str | Path | Mapping[str, Any] | None,
    tables: Mapping[str, Any],
    source: Path | None,
    label: str,
) -> Robot:
    """Check tables, and load the robot of their key unless it is a `Robot` already."""
    checked = read_tables(tables, label)
    if isinstance(robot, Robot):
        return robot
    with in_file(label), locate("robot"):
        return load_keys(checked["robot"], source.parent if source is not None else None)


def robot_in(document: Document, robot: Robot | str | Path | Mapping[str, Any]) -> Robot:
    """Load a robot to take the place of a document's, named from where its file is; a `Robot` is one already.

    Raises
    ------
    ProblemFileError, MbocpError
        If the robot cannot be loaded.
    """
    if isinstance(robot, Robot):
        return robot
    return _load(None, {**document.tables, "robot": plain(robot)}, document.source, document.label)


def read_document(document: Document, before: tuple[Document, Mapping[str, Any]] | None) -> dict[str, Any]:
    """Return what the tables say, as arrays for the robot.

    Parameters
    ----------
    document : Document
    before : tuple of Document and mapping, optional
        An earlier document with what followed from it: tables that are the same are not read again.
    """
    given = {**UNSAID, **document.values, **_tables(document, before), "robot_of_file": document.robot}
    given["terms_given"] = document.terms
    given["folder"] = document.source.parent if document.source is not None else Path()
    has_cost = "cost" in document.tables
    given["is_cost_left"] = not (has_cost or document.terms or document.tables.get("terms"))
    return run_steps(READ, given, before[1] if before is not None else None)


def _tables(document: Document, before: tuple[Document, Mapping[str, Any]] | None) -> dict[str, Any]:
    """Tables that are checked against the schema, by their names with `_table` behind."""
    tables = document.tables
    known = (
        {}
        if before is None
        else {name: before[1][f"{name}_table"] for name in _same(tables, before[0].tables)}
    )
    others = {name: table for name, table in tables.items() if name not in known}
    checked = read_tables({**others, "robot": ""}, document.label)
    names = (name for name in ProblemTable.model_fields if name != "robot")
    found = {f"{name}_table": known[name] if name in known else checked[name] for name in names}
    return {**found, "coordinates": found.pop("coordinates_table")}


def _same(now: Mapping[str, Any], then: Mapping[str, Any]) -> list[str]:
    """Names of tables that are the same, or not there, in both."""
    names = (name for name in ProblemTable.model_fields if name not in ("robot", "coordinates"))
    return [name for name in names if now.get(name) is then.get(name)]
