"""From the tables of a problem file to a `Problem`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mbocp.problem.document import make_document
from mbocp.problem.file.messages import in_file
from mbocp.problem.problem import Problem
from mbocp.robot import Robot
from mbocp.terms import OwnTerm


def problem_from_tables(
    document: Mapping[str, Any],
    *,
    robot: Robot | str | Path | Mapping[str, Any] | None = None,
    source: Path | None = None,
    label: str = "problem",
    name: str = "",
    terms: Sequence[OwnTerm] = (),
) -> Problem:
    """Validate the tables and make the problem, see `mbocp.problem.document.make_document`."""
    made = make_document(document, robot=robot, source=source, label=label, name=name, terms=tuple(terms))
    with in_file(label):
        return Problem.of(made)
