"""Stage functions of many shapes without compiling any: CasADi's virtual machine is fast enough for a few."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection

import casadi as ca
import pytest

from mbocp.formulation import build
from mbocp.programme.compilation import CompiledFunctions

_MADE: dict[str, CompiledFunctions] = {}


def interpreted_functions(
    key: str,
    build: Callable[[], dict[str, ca.Function]],
    *,
    of_end: bool = False,
    in_lanes: Collection[str] = (),
    deadline: float = math.inf,
) -> CompiledFunctions:
    if key not in _MADE:
        texts = {name: function.serialize() for name, function in build().items()}
        _MADE[key] = CompiledFunctions(None, texts, compiled_now=False)
    return _MADE[key]


@pytest.fixture
def interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Transcribe without a compiler, each shape once for all tests."""
    monkeypatch.setattr(build, "load_functions", interpreted_functions)
