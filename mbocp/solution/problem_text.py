"""What the text of a solved problem says of its integrator and its limits."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from mbocp._arrays import Array

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["integrator_of", "limits_of"]

_KEYS = {"limits_u": "effort", "limits_v": "velocity", "limits_q": "position"}


def integrator_of(problem_text: str) -> dict[str, Any]:
    """`coordinates` and what the integrator is, of a problem file; "" and 1 if the text is not TOML."""
    problem = _parsed(problem_text)
    if problem is None:
        return {"coordinates": "", "scheme": "", "lie": "", "substeps": 1, "rotations": ""}
    written, robot = problem.get("integrator", {}), problem.get("robot", {})
    rotations = robot.get("rotations", "quaternion") if isinstance(robot, dict) else "quaternion"
    return {
        "coordinates": str(problem.get("coordinates", "joint")),
        "scheme": str(written.get("scheme", "se1")),
        "lie": str(written.get("lie", "munthe_kaas")),
        "substeps": int(written.get("substeps", 1)),
        "rotations": str(rotations),
    }


def limits_of(problem_text: str) -> dict[str, Array]:
    """`limits_u`, `limits_v` and `limits_q`, shape (2, n), as far as the text has them as lists of pairs.

    That is how `mbocp.problem.problem_to_toml` writes them; what needs a robot to be understood is left out.
    """
    written = (_parsed(problem_text) or {}).get("limits", {})
    return {
        name: np.array(written[key], dtype=np.float64).T
        for name, key in _KEYS.items()
        if _pairs(written, key)
    }


@lru_cache(maxsize=4)
def _parsed(problem_text: str) -> dict[str, Any] | None:
    try:
        document: dict[str, Any] = tomllib.loads(problem_text)
    except tomllib.TOMLDecodeError:
        return None
    return document


def _pairs(written: Mapping[str, Any], key: str) -> bool:
    rows = written.get(key)
    return isinstance(rows, list) and all(isinstance(row, list) and len(row) == 2 for row in rows)
