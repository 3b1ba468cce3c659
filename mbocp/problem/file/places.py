"""Where keys stand in a TOML text: Python's parser does not say."""

from __future__ import annotations

import re
from typing import NamedTuple, TypeAlias

from mbocp._files import parse_toml

_Path: TypeAlias = tuple[str | int, ...]  # names of tables and keys, indices of lists

_BLANK = re.compile(r"(?:[ \t\n]|#[^\n]*)*")
_STRING = (
    r'"""(?:[^"\\]|\\.|"{1,2}(?!"))*"{3,5}'
    r"|'''(?:[^']|'{1,2}(?!'))*'{3,5}"
    r'|"(?:[^"\\\n]|\\.)*"'
    r"|'[^'\n]*'"
)
_NAME = re.compile(rf"[A-Za-z0-9_-]+|{_STRING}", re.DOTALL)
_SCALAR = re.compile(rf"{_STRING}|[^,\[\]{{}}#\n]+", re.DOTALL)
_PART = re.compile(r"[^.,\[\] ]+")  # of a key in a message: path.0.kind, goal.q[2]


class KeyPosition(NamedTuple):
    """Line and column of a key, from 1."""

    line: int
    column: int


def place_of(text: str, key: str) -> KeyPosition | None:
    """Return where a TOML text has a key, or the innermost table around it that is there.

    Parameters
    ----------
    text : str
        Valid TOML.
    key : str
        As messages name it: names with dots between them, indices as names or in brackets. An index may be
        one too many, where one table stands for a list of them.

    Returns
    -------
    KeyPosition or None
        None where even the first name of the key is not in the text.
    """
    known = _Scanner(text).places
    path: _Path = ()
    for part in _PART.findall(key):
        is_index = part.isdecimal()
        steps: list[_Path] = [(*path, int(part))] if is_index else []
        step = next((one for one in (*steps, (*path, part)) if one in known), None)
        if step is not None:
            path = step
        elif not is_index:
            break
    if not path:
        return None
    offset = known[path]
    return KeyPosition(text.count("\n", 0, offset) + 1, offset - text.rfind("\n", 0, offset))


class _Scanner:
    """Offsets of all keys and entries of lists; `text` is known to be valid."""

    def __init__(self, text: str) -> None:
        self._text, self._at = text, 0
        self._entries: dict[_Path, int] = {}  # of [[tables]], as many as there are so far
        self.places: dict[_Path, int] = {}
        table: _Path = ()
        while self._skip() < len(text):
            if text.startswith("[", self._at):
                table = self._header()
            else:
                self._pair(table)

    def _skip(self) -> int:
        """Go on to what is neither blank nor a comment."""
        self._at = self._after(_BLANK)
        return self._at

    def _after(self, pattern: re.Pattern[str]) -> int:
        found = pattern.match(self._text, self._at)
        assert found is not None, self._at  # the text is valid
        return found.end()

    def _header(self) -> _Path:
        is_entry = self._text.startswith("[[", self._at)
        self._at += 1 + is_entry
        path, offset = self._key(())
        self._at += 1 + is_entry
        if not is_entry:
            return path
        index = self._entries.get(path, 0)
        self._entries[path] = index + 1
        entry: _Path = (*path, index)
        self.places[entry] = offset
        return entry

    def _key(self, path: _Path) -> tuple[_Path, int]:
        """Read a dotted key; return it and where its last part is."""
        while True:
            offset = self._skip()
            self._at = self._after(_NAME)
            name = self._text[offset : self._at]
            path = (*path, parse_toml(f"name = {name}")["name"] if name[0] in "\"'" else name)
            self.places.setdefault(path, offset)
            self._skip()
            if not self._text.startswith(".", self._at):
                return path, offset
            self._at += 1
            if path in self._entries:  # [a.b] below [[a]] belongs to the last of them
                path = (*path, self._entries[path] - 1)

    def _pair(self, table: _Path) -> None:
        path, _ = self._key(table)
        self._at += 1  # =
        self._skip()
        self._value(path)

    def _value(self, path: _Path) -> None:
        if self._text[self._at] not in "[{":
            self._at = self._after(_SCALAR)
            return
        is_list, index = self._text[self._at] == "[", 0
        self._at += 1
        while self._text[self._skip()] not in "]}":
            if self._text[self._at] == ",":
                self._at += 1
            elif is_list:
                entry: _Path = (*path, index)
                self.places[entry] = self._at
                self._value(entry)
                index += 1
            else:
                self._pair(path)
        self._at += 1
