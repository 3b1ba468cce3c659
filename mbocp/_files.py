"""Reading a file that a user names: a regular file of bounded size, as text in UTF-8 or as TOML.

A folder, a pipe or a device is refused before anything is read; what cannot be read ends in one kind of
error, `Unreadable`, whose `reason` the caller puts into an error of its own layer.
"""

from __future__ import annotations

import os
import re
import stat
import sys
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from mbocp._text import shorten, show
from mbocp.exceptions import Unreadable

if sys.version_info >= (3, 11):
    import tomllib
else:  # pragma: no cover
    import tomli as tomllib

MEGABYTE = 2**20
RESULT_SUFFIXES = (".h5", ".hdf5")  # of results of a solve
TEXT_LIMIT = 4 * MEGABYTE  # of problem, study and robot files [bytes]; the largest that we know has 50 kB
XML_LIMIT = 16 * MEGABYTE  # of files of robots in XML [bytes]; the largest that we know has 0.4 MB
MAX_LEVELS = 64  # of tables and lists within each other
_TOO_DEEP = f"lists or tables are nested more than {MAX_LEVELS} deep"
_INTEGERS = range(-(2**63), 2**63)  # what TOML lets an integer be
_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
# tomllib takes time quadratic in the number of parts of a dotted key.
_PART = r"""(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')[ \t]*"""
_SAID_TWICE = re.compile(
    r"Cannot (?:overwrite|declare|mutate).*\((?P<at>.*line (?P<line>\d+), column \d+)\)", re.DOTALL
)
_LONG_KEY = re.compile(rf"(?m)^[ \t\[]*(?:{_PART}\.[ \t]*){{{MAX_LEVELS}}}")


def path_of(name: str | Path) -> Path:
    """A path with ~ and ~user expanded; that of an unknown user stays as it stands."""
    return Path(os.path.expanduser(name))  # noqa: PTH111  # Path.expanduser raises RuntimeError


def is_file(path: Path) -> bool:
    """Whether it is a file; False, too, for a name that no file can have (too long, with a NUL)."""
    return os.path.isfile(path)  # noqa: PTH113  # Path.is_file raises OSError


def is_folder(path: Path) -> bool:
    """Whether it is a folder; False, too, for a name that no folder can have."""
    return os.path.isdir(path)  # noqa: PTH112  # Path.is_dir raises OSError


def read_bytes(path: str | Path, *, expected: str = "a file", limit: int = TEXT_LIMIT) -> bytes:
    """Read a regular file of at most `limit` bytes.

    Parameters
    ----------
    path : str or Path
    expected : str, optional
        What the file should be, for the message: "a problem file (TOML)".
    limit : int, optional
        Largest size [bytes].

    Raises
    ------
    Unreadable
        If there is no such file, if it is a folder, pipe or device, may not be read, or is too large.
    """
    try:
        # Non-blocking: to open a pipe that nobody writes to would take for ever.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0))
    except FileNotFoundError as error:
        raise Unreadable("no such file") from error
    except OSError as error:
        raise Unreadable(f"cannot be read: {error.strerror}") from error
    except ValueError as error:  # a NUL in the name, or half of a surrogate pair
        raise Unreadable(f"cannot be read: this is no name of a file ({error})") from error
    try:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            kind = next((name for test, name in _KINDS if test(status.st_mode)), "no regular file")
            raise Unreadable(f"is {kind}, expected {expected}")
        content = b""
        if status.st_size <= limit:  # else it is not even read
            with os.fdopen(handle, "rb", closefd=False) as file:
                content = file.read(limit + 1)
    except OSError as error:
        raise Unreadable(f"cannot be read: {error.strerror}") from error
    finally:
        os.close(handle)
    size = max(status.st_size, len(content))
    if size > limit:
        raise Unreadable(
            f"has {size / MEGABYTE:.1f} MB, expected {expected} of at most {limit / MEGABYTE:g} MB"
        )
    return content


def read_text(path: str | Path, *, expected: str = "a text file", limit: int = TEXT_LIMIT) -> str:
    """Read a text in UTF-8, without byte order mark and with plain line ends.

    Parameters and errors are those of `read_bytes`.
    """
    try:
        content = read_bytes(path, expected=expected, limit=limit)
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if content.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
            raise Unreadable(f"is a text file in UTF-16, expected {expected}: save it in UTF-8") from error
        raise Unreadable(f"is not a text file in UTF-8, expected {expected}") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


_BEFORE_ROOT = re.compile(r"(?:\s+|<\?.*?\?>|<!--.*?-->|<!DOCTYPE[^>]*>)*<([A-Za-z_][\w.-]*)", re.DOTALL)


def root_tag(path: str | Path) -> str:
    """The tag of the root element of an XML file; empty if it cannot be read or has none."""
    try:
        found = _BEFORE_ROOT.match(read_text(path, limit=XML_LIMIT))
    except Unreadable:  # whoever reads the file says why
        return ""
    return "" if found is None else found[1]


def read_toml(path: str | Path, *, expected: str = "a TOML file") -> dict[str, Any]:
    """Read a TOML file; `expected` and errors are those of `read_bytes`, errors of `parse_toml`, too."""
    return parse_toml(read_text(path, expected=expected))


def parse_toml(text: str) -> dict[str, Any]:
    """Tables of a TOML text.

    Integers are those of 64 bits, as TOML demands (Python's parser takes longer ones, which no float can
    hold), and tables and lists go at most `MAX_LEVELS` deep.

    Raises
    ------
    Unreadable
        If it is not TOML, with line and column; if it is nested too deeply, or has a longer integer.
    """
    if _LONG_KEY.search(text):
        raise Unreadable(f"malformed TOML: a key of more than {MAX_LEVELS} parts")
    try:
        document: dict[str, Any] = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        lines = text.splitlines() or [""]
        end = f"at the end, line {len(lines)}, column {len(lines[-1]) + 1}"
        reason = str(error).replace("at end of document", end)
        raise Unreadable(f"malformed TOML: {_SAID_TWICE.sub(partial(_say_once, lines), reason)}") from error
    except RecursionError as error:
        raise Unreadable(f"malformed TOML: {_TOO_DEEP}") from error
    except ValueError as error:  # Python refuses to convert more than 4300 digits
        raise Unreadable(f"malformed TOML: an integer that does not fit into 64 bits ({error})") from error
    for path, value in _walk(document):
        if len(path) > MAX_LEVELS:
            raise Unreadable(f"malformed TOML: {_join(path)}: {_TOO_DEEP}")
        if isinstance(value, int) and value not in _INTEGERS:
            raise Unreadable(
                f"malformed TOML: {_join(path)}: got {show(value)}, expected an integer of 64 "
                "bits; write a large number as a float, 1e20"
            )
    return document


def _say_once(lines: list[str], found: re.Match[str]) -> str:
    """Words for a line that names what stands above it, in place of those of Python's parser."""
    line = lines[int(found["line"]) - 1].strip()
    name, dot, _ = line.lstrip("[ ").partition("=")[0].strip("] ").partition(".")
    more = f", and {name} as the table [{name}], not as {name} = ..." if dot or line.startswith("[") else ""
    return f"{shorten(line)} gives again what lines above it give (at {found['at']}); give each once{more}"


def _join(path: tuple[str, ...]) -> str:
    return shorten(".".join(path).replace(".[", "["))


def _walk(document: dict[str, Any]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Keys that lead to a value, and the value, for everything in a document, without recursion."""
    stack: list[tuple[tuple[str, ...], Any]] = [((), document)]
    while stack:
        path, value = stack.pop()
        yield path, value
        if isinstance(value, dict):
            stack += [((*path, name), inner) for name, inner in value.items()]
        elif isinstance(value, list):
            stack += [((*path, f"[{number}]"), inner) for number, inner in enumerate(value)]
