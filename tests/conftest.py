"""What tests share."""

from __future__ import annotations

import os
import signal

import hypothesis
import pytest

# A property that takes long on a busy machine is no counterexample.
hypothesis.settings.register_profile("untimed", deadline=None)
hypothesis.settings.load_profile("untimed")

# Results must not depend on when a compiler is through; processes that tests start take it over.
os.environ.setdefault("MBOCP_FUNCTIONS", "tapes")


# Tests press Ctrl-C, which what a shell starts in the background ignores.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile stage functions before they are called."""
    monkeypatch.setenv("MBOCP_FUNCTIONS", "compiled")
