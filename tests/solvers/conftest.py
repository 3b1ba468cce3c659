import pytest

from mbocp.formulation import build
from tests.integrators.conftest import interpreted_functions


@pytest.fixture
def interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Transcribe without a compiler, each shape once for all tests."""
    monkeypatch.setattr(build, "load_functions", interpreted_functions)
