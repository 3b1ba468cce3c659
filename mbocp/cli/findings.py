"""What `mbocp check --json` found: errors and warnings, with their places in files."""

from __future__ import annotations

import contextlib
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mbocp._files import parse_toml, read_text
from mbocp._text import MAX_MESSAGE, shorten
from mbocp.exceptions import MbocpError, ProblemFileError, Unreadable, key_in
from mbocp.problem.file.overrides import parse_override
from mbocp.problem.file.places import KeyPosition, place_of
from mbocp.problem.reasons.cause import Cause

_MALFORMED = re.compile(r"malformed TOML: .*line (\d+), column (\d+)", re.DOTALL)
# Messages say what is wrong, then what is right.
_ADVICE = re.compile(r"(?:[,;:] |\()((?:expected|did you mean|valid names|allowed) .*)", re.DOTALL)


Finding = dict[str, str | int | None]


class Findings:
    """Errors and warnings about a problem file and changes of its keys.

    Each is a table. Its "code" is the class of the error or warning; "impossible" or "doubtful" for what
    arithmetic says against a problem, and "odd" for what is odd in a robot's file. Its "key" is dotted or
    None, "line" and "column" are those of the key in "file", from 1, or None where it is not there. Its
    "message" is without file and key, and "advice" is the part of it that says what to do, or None.
    """

    def __init__(self, file: Path, settings: Sequence[str]) -> None:
        self._file, self._settings = file, settings
        self._texts: dict[Path, str] = {}
        self.errors: list[Finding] = []
        self.warnings: list[Finding] = []

    @contextlib.contextmanager
    def record_warnings(self) -> Iterator[None]:
        """Keep the warnings that arise; they are shown, too."""
        with warnings.catch_warnings():
            show = warnings.showwarning

            def keep(message: Warning | str, category: type[Warning], *args: Any, **kwargs: Any) -> None:
                words = str(message)
                self.warnings.append(self._make_finding(category.__name__, key_in(words), words, self._file))
                show(message, category, *args, **kwargs)

            warnings.showwarning = keep
            yield

    def add_error(self, error: MbocpError) -> None:
        """Add an error, or each of the mistakes that it names."""
        code, path = type(error).__name__, getattr(error, "path", self._file)
        if isinstance(error, ProblemFileError):
            mistakes: Sequence[tuple[str | None, str]] = error.mistakes
        else:
            mistakes = [(error.key, str(error))]
        self.errors += [self._make_finding(code, key, words, path) for key, words in mistakes]

    def add_causes(self, causes: Sequence[Cause]) -> None:
        """Add what arithmetic says against a problem."""
        for cause in causes:
            code = "impossible" if cause.is_certain else "doubtful"
            self.warnings.append(self._make_finding(code, None, cause.words, self._file))

    def add_oddities(self, oddities: Sequence[str]) -> None:
        """Add what is odd in the robot's file."""
        self.warnings += [self._make_finding("odd", None, words, self._file) for words in oddities]

    def to_dict(self, exit_status: int) -> dict[str, Any]:
        """Return what is printed."""
        return {
            "status": "error" if self.errors else "ok",
            "exit_status": exit_status,
            "errors": self.errors,
            "warnings": self.warnings,
        }

    def _make_finding(self, code: str, key: str | None, words: str, path: Path) -> Finding:
        message = words.removeprefix(f"{self._file}: ").removeprefix(f"{path}: ")
        message = shorten(message.removeprefix(f"{key}: "), MAX_MESSAGE)
        place = self._place(key, message, path)
        line, column = (None, None) if place is None else place
        where: Finding = {"key": key, "file": str(path), "line": line, "column": column}
        return {"code": code, **where, "message": message, "advice": _advice(message)}

    def _place(self, key: str | None, message: str, path: Path) -> KeyPosition | None:
        if key is None:
            found = _MALFORMED.match(message)
            return None if found is None else KeyPosition(int(found[1]), int(found[2]))
        if path == self._file and any(_touches(setting, key) for setting in self._settings):
            return None
        return place_of(self._text(path), key)

    def _text(self, path: Path) -> str:
        """The text of a TOML file; empty of one that is none."""
        if path not in self._texts:
            try:
                text = read_text(path)
                parse_toml(text)
            except Unreadable:  # as a URDF is
                text = ""
            self._texts[path] = text
        return self._texts[path]


def _advice(message: str) -> str | None:
    found = _ADVICE.search(message)
    if found is None:
        return message.partition("; ")[2] or None
    return found[1].removesuffix(")") if found[0].startswith("(") else found[1]


def _touches(setting: str, key: str) -> bool:
    """Whether a change sets a key, one in it, or one around it."""
    try:
        changed = ".".join(parse_override(setting)[0])
    except ProblemFileError:  # which is an error of its own
        return False
    return f"{key}.".startswith(f"{changed}.") or f"{changed}.".startswith(f"{key}.")
