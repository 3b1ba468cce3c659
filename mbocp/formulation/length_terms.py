"""What functions of stages need of free step lengths, see `mbocp.formulation.step_lengths`."""

from __future__ import annotations

import casadi as ca

__all__ = ["BEGINS_PHASE", "idle_cost"]

BEGINS_PHASE = "begins_phase"  # the stage parameter e


def idle_cost(e: ca.SX, w: ca.SX) -> ca.SX:
    """What makes a control that nothing depends on zero."""
    return (1.0 - e) * w**2 / 2.0
