"""What docstrings have that Sphinx does not know: keys of references."""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

_KEY = re.compile(r"\[([A-Z][A-Za-z]+\d{4}[a-z]?)\]_")


def _linked(app: Sphinx, what: str, name: str, obj: object, options: Any, lines: list[str]) -> None:
    lines[:] = [_KEY.sub(r":doc:`[\1] </references>`", line) for line in lines]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register it."""
    app.connect("autodoc-process-docstring", _linked, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
