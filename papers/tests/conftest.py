"""The command line, with the command that this package adds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from typer.testing import CliRunner

from mbocp.cli.app import app_for

Run = Callable[..., Any]  # of arguments to what a CliRunner returns


@pytest.fixture
def run() -> Run:
    return lambda *words: CliRunner().invoke(app_for(words), list(map(str, words)))
