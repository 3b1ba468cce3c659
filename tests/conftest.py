"""What tests share: their levels, by where they stand, and stage functions that no compiler makes."""

from __future__ import annotations

import math
import os
from collections.abc import Callable

import casadi as ca
import hypothesis
import pytest

from mbocp.accuracy import flow
from mbocp.formulation import build
from mbocp.programme.compilation import CompiledFunctions
from mbocp.receding import estimator_functions

# A property that takes long on a busy machine is no counterexample.
hypothesis.settings.register_profile("untimed", deadline=None)
hypothesis.settings.load_profile("untimed")

# Results must not depend on when a compiler is through; processes that tests start take it over.
os.environ.setdefault("MBOCP_FUNCTIONS", "compiled")

_MADE: dict[str, CompiledFunctions] = {}


def interpreted_functions(
    key: str,
    build: Callable[[], dict[str, ca.Function]],
    *,
    deadline: float = math.inf,
    at_once: bool = False,
) -> CompiledFunctions:
    if key not in _MADE:
        _MADE[key] = CompiledFunctions.interpret(build())
    return _MADE[key]


@pytest.fixture
def interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Transcribe without a compiler, each shape once; for a few solves that is quicker."""
    for module in (build, flow, estimator_functions):
        monkeypatch.setattr(module, "load_functions", interpreted_functions)
