"""Fixtures that others have, too."""

from tests.integrators.conftest import interpreted

__all__ = ["interpreted"]
