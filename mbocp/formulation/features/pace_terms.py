"""What functions of stages need of paces along followed paths, see `mbocp.formulation.features.progress`."""

from __future__ import annotations

import casadi as ca

__all__ = ["ADVANCES", "resting_cost"]

ADVANCES = "advances"  # the stage parameters e


def resting_cost(e: ca.SX, w: ca.SX) -> ca.SX:
    """What makes paces that nothing depends on zero."""
    return ca.dot(e == 0, w**2) / 2.0
