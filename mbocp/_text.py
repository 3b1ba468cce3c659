"""Words of messages: quoted in a few words, however large; and warnings at the line of the user."""

from __future__ import annotations

import math
import reprlib
import sys
import unicodedata
import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

MAX_QUOTE = 200  # characters of one value in a message
MAX_MESSAGE = 4000  # characters of a message
_GAP = " [...] "
_LOG10_2 = math.log10(2.0)
_DIRECTIONS = frozenset("\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
_BITS = 256  # of an integer that is written out


class _Repr(reprlib.Repr):
    """`repr` that looks at a few entries and levels only, so that it ends in time whatever it is given."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 4
        self.maxlist = self.maxtuple = self.maxset = self.maxfrozenset = self.maxdeque = self.maxdict = 12
        self.maxstring = self.maxlong = self.maxother = MAX_QUOTE

    def repr_int(self, x: int, level: int) -> str:
        """An integer; Python itself refuses to print one of more than 4300 digits."""
        if x.bit_length() <= _BITS:
            return repr(x)
        return f"an integer of about {int(x.bit_length() * _LOG10_2) + 1} digits"


_REPR = _Repr()


def show(value: Any, limit: int = MAX_QUOTE) -> str:
    """`repr(value)` for a message, with at most `limit` characters and in bounded time.

    Parameters
    ----------
    value : Any
        What a user's file or option said: text, numbers, lists and tables of any size and depth.
    limit : int, optional
        Longest text that is returned [characters].
    """
    return shorten(_REPR.repr(value), limit)


def list_names(names: Sequence[str], most: int) -> str:
    """The first `most` names, quoted, with commas between them, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(show(name) for name in names[:most]) + more


def find_repeated(names: Iterable[str]) -> list[str]:
    """Find the names that occur more than once, each once, in their order."""
    return [name for name, count in Counter(names).items() if count > 1]


def quote_all(names: Iterable[str]) -> str:
    """Names of a model, which are short, quoted, with commas between them."""
    return ", ".join(map(repr, names))


def has_control_characters(text: str) -> bool:
    """Whether a text would do more to a terminal than print: it has an escape, a NUL, a line end, ..."""
    return any(unicodedata.category(character) == "Cc" for character in text)


def printable(text: str, keep: str = "") -> str:
    """A text on one line that only prints: what would do more to a terminal or a program is escaped.

    Control characters but those to `keep`, lone surrogates, and what turns the direction of writing around.
    """
    return "".join(c if c in keep or _only_prints(c) else c.encode("unicode_escape").decode() for c in text)


def _only_prints(character: str) -> bool:
    return unicodedata.category(character) not in ("Cc", "Cs") and character not in _DIRECTIONS


def shorten(text: str, limit: int = MAX_QUOTE) -> str:
    """`text` itself, or its beginning and end with "[...]" between them if it is longer than `limit`."""
    if len(text) <= limit:
        return text
    end = max((limit - len(_GAP)) // 4, 0)
    return text[: limit - len(_GAP) - end] + _GAP + text[len(text) - end :]


def reads_as_number(text: str) -> bool:
    """Whether a text in a table of numbers is one, and not a heading."""
    try:
        float(text)
    except ValueError:
        return False
    return True


_INNER = (
    "mbocp",
    "dataclasses",
)  # packages of frames that are no user's; generated `__init__` have mbocp's globals


def warn_caller(message: str | Warning, category: type[Warning] = UserWarning) -> None:
    """Warn at the innermost line outside mbocp; where there is none, at the outermost."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).partition(".")[0] in _INNER:
        level, frame = level + 1, frame.f_back
    warnings.warn(message, category, stacklevel=level)
