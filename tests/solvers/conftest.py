import pytest

from mbocp.transcription import programme
from tests.integrators.conftest import interpreted_functions


@pytest.fixture
def interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Transcribe without a compiler, each shape once for all tests."""
    monkeypatch.setattr(programme, "load_functions", interpreted_functions)
