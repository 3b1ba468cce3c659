"""Problem files: from TOML to a `Problem`."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mbocp.exceptions import ProblemFileError
from mbocp.problem.build import problem_from_tables
from mbocp.problem.overrides import apply_overrides
from mbocp.problem.problem import Problem

if sys.version_info >= (3, 11):
    import tomllib
else:  # pragma: no cover
    import tomli as tomllib

__all__ = ["load_document", "load_problem", "parse_problem"]


def load_problem(path: str | Path, overrides: Mapping[str, Any] | Sequence[str] = ()) -> Problem:
    """Read a problem file.

    Parameters
    ----------
    path : str or Path
        TOML file; relative paths in it are relative to its folder.
    overrides : mapping or sequence of str
        Values that replace or add keys: ``{"horizon.steps": 200}`` or ``["horizon.steps=200"]``.

    Raises
    ------
    ProblemFileError
        If the file is missing, is not TOML, or has a wrong key or value: the message names file and key, what
        was got and what is allowed.
    """
    path = Path(path)
    return _problem(load_document(path), overrides, path)


def load_document(path: Path, what: str = "a problem file") -> dict[str, Any]:
    """Read the tables of a problem file, or of `what` else is TOML, not looking at what is in them.

    Raises
    ------
    ProblemFileError
        If the file is missing or is not TOML.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise ProblemFileError(path, "no such file") from error
    except IsADirectoryError as error:
        raise ProblemFileError(path, f"is a folder, expected {what} (TOML)") from error
    except UnicodeDecodeError as error:
        raise ProblemFileError(path, f"is not a text file in UTF-8, expected {what} (TOML)") from error
    except OSError as error:
        raise ProblemFileError(path, f"cannot be read: {error.strerror}") from error
    return _parse(text, path)


def parse_problem(
    text: str, overrides: Mapping[str, Any] | Sequence[str] = (), *, source: Path | None = None
) -> Problem:
    """Read a problem from TOML text; `source` is the file it came from, if there is one."""
    return _problem(_parse(text, source if source is not None else "<text>"), overrides, source)


def _parse(text: str, label: Path | str) -> dict[str, Any]:
    try:
        document: dict[str, Any] = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        lines = text.splitlines() or [""]
        end = f"at the end, line {len(lines)}, column {len(lines[-1]) + 1}"
        message = str(error).replace("at end of document", end)
        raise ProblemFileError(label, f"malformed TOML: {message}") from error
    return document


def _problem(
    document: Mapping[str, Any], overrides: Mapping[str, Any] | Sequence[str], source: Path | None
) -> Problem:
    label = str(source) if source is not None else "<text>"
    return problem_from_tables(apply_overrides(document, overrides), source=source, label=label)
