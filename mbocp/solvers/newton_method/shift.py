"""The multiple of the identity that a Newton method adds to its Hessian in the states, by control weight.

How it changes is the kernel's to say (`shift.hpp`): a horizon that moves on goes by the same rules.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp.programme.native import kernel

if TYPE_CHECKING:
    from mbocp.programme.native import KernelCare

MAX_SHIFT = 1e10


def bold() -> KernelCare:
    """Rules that find a shift in few factorisations, and leave it soon."""
    return kernel().Care.bold()


def careful() -> KernelCare:
    """Rules for valleys of negative curvature: smaller factors, and larger shifts rather than short steps."""
    return kernel().Care.careful()
