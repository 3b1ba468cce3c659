"""Warnings that point at the line of the user that called mbocp, however deep within it they arise."""

from __future__ import annotations

import sys
import warnings

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
