"""These tests compile nothing."""

from __future__ import annotations

import pytest

from mbocp.formulation import build
from tests.integrators.conftest import interpreted_functions


@pytest.fixture(autouse=True)
def interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build, "load_functions", interpreted_functions)
