"""Which integrator a solution is from, as the text of its problem says."""

from __future__ import annotations

import sys
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["integrator_of"]


def integrator_of(problem_text: str) -> dict[str, Any]:
    """`scheme`, `lie`, `substeps` and `rotations` of a problem file; "" and 1 if the text is not TOML."""
    try:
        problem = tomllib.loads(problem_text)
    except tomllib.TOMLDecodeError:
        return {"scheme": "", "lie": "", "substeps": 1, "rotations": ""}
    written, robot = problem.get("integrator", {}), problem.get("robot", {})
    rotations = robot.get("rotations", "quaternion") if isinstance(robot, dict) else "quaternion"
    return {
        "scheme": str(written.get("scheme", "se1")),
        "lie": str(written.get("lie", "munthe_kaas")),
        "substeps": int(written.get("substeps", 1)),
        "rotations": str(rotations),
    }
