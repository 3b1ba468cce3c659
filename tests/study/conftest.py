from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mbocp.study import Study

EXAMPLES = Path(__file__).parents[2] / "examples"

PENDULUM: dict[str, Any] = {
    "robot": {"name": "rigid_pendulum", "gravity": [0, 0, -9.81]},
    "horizon": {"duration": 1.0, "steps": 10},
    "start": {"q": [5, 0, 0], "p": [0, 10, 0]},
    "goal": {"q": [0, 0, -5], "p": [0, 0, 0]},
    "guess": {"u": [0, -2, 0]},
    "integrator": {"scheme": "se1"},
}

MakeStudy = Callable[..., Study]


@pytest.fixture
def make() -> MakeStudy:
    """Make a study of the pendulum from tables; keys that TOML writes in quotes come as they are."""

    def maker(**tables: Any) -> Study:
        return Study.from_tables({"problem": PENDULUM, **tables})

    return maker
