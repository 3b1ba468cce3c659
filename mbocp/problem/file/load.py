"""Problem files: from TOML to a `Problem`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mbocp._files import RESULT_SUFFIXES, is_file, parse_toml, read_text
from mbocp.exceptions import ProblemFileError, Unreadable
from mbocp.problem.file.build import problem_from_tables
from mbocp.problem.file.overrides import apply_overrides
from mbocp.problem.file.sample import is_robot_file, smallest_problem
from mbocp.problem.problem import Problem
from mbocp.terms import OwnTerm


def load_problem(
    path: str | Path,
    overrides: Mapping[str, Any] | Sequence[str] = (),
    *,
    terms: Sequence[OwnTerm] = (),
) -> Problem:
    """Read a problem file.

    Parameters
    ----------
    path : str or Path
        TOML file; relative paths in it are relative to its folder.
    overrides : mapping or sequence of str
        Values that replace or add keys: ``{"horizon.steps": 200}`` or ``["horizon.steps=200"]``.
    terms : sequence of OwnTerm
        Terms of one's own, see `mbocp.terms.own`: those that `[[terms]]` names, and others.

    Raises
    ------
    ProblemFileError
        If the file is missing, is not TOML, or has a wrong key or value: the message names file and key, what
        was got and what is allowed. Of a result, `Solution.load_problem` gives the problem.
    """
    path = Path(path)
    if path.suffix.lower() in RESULT_SUFFIXES and is_file(path):
        reason = (
            f"is a result, expected a problem file (TOML): mbocp.Solution.load({str(path)!r}).load_problem()"
        )
        raise ProblemFileError(path, f"{reason} is the problem that it solves")
    if is_robot_file(path) and is_file(path):
        reason = (
            f"is a robot, expected a problem file (TOML): `mbocp new {path}` writes one with comments; the "
            "smallest one for it, to be put beside it:"
        )
        raise ProblemFileError(path, f"{reason}\n{smallest_problem(path)}")
    return _problem(load_document(path), overrides, path, terms)


def load_document(path: Path, what: str = "a problem file") -> dict[str, Any]:
    """Read the tables of a problem file, or of `what` else is TOML, not looking at what is in them.

    Raises
    ------
    ProblemFileError
        If the file is missing or is not TOML.
    """
    try:
        text = read_text(path, expected=f"{what} (TOML)")
    except Unreadable as error:
        raise ProblemFileError(path, error.reason) from error
    return _parse(text, path)


def parse_problem(
    text: str,
    overrides: Mapping[str, Any] | Sequence[str] = (),
    *,
    source: Path | None = None,
    terms: Sequence[OwnTerm] = (),
) -> Problem:
    """Read a problem from TOML text; `source` is the file it came from, if there is one."""
    return _problem(_parse(text, source if source is not None else "<text>"), overrides, source, terms)


def _parse(text: str, label: Path | str) -> dict[str, Any]:
    try:
        return parse_toml(text)
    except Unreadable as error:
        raise ProblemFileError(label, error.reason) from error


def _problem(
    document: Mapping[str, Any],
    overrides: Mapping[str, Any] | Sequence[str],
    source: Path | None,
    terms: Sequence[OwnTerm],
) -> Problem:
    label = str(source) if source is not None else "<text>"
    return problem_from_tables(apply_overrides(document, overrides), source=source, label=label, terms=terms)
