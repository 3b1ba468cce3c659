"""Derivatives of an optimal motion in the numbers of its problem."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.sensitivity.derivatives import DegenerateLimitWarning as DegenerateLimitWarning
    from mbocp.sensitivity.derivatives import Sensitivities as Sensitivities
    from mbocp.sensitivity.derivatives import sensitivities as sensitivities


__getattr__ = names_of(__name__, __file__)
