"""What functions of stages need of free step lengths, see `mbocp.formulation.features.step_lengths`."""

from __future__ import annotations

import casadi as ca

__all__ = ["BEGINS_PHASE", "SPACING", "STEP_SHARE", "STRETCH", "idle_cost", "spacing"]

BEGINS_PHASE = "begins_phase"  # the stage parameter e
STRETCH, SPACING = "stretch", "spacing"  # of given steps that differ: length, and way between middles
STEP_SHARE = "step_share"  # the parameter 1/N


def idle_cost(e: ca.SX, w: ca.SX) -> ca.SX:
    """What makes a control that nothing depends on zero."""
    return (1.0 - e) * w**2 / 2.0


def spacing(h0: ca.SX, h1: ca.SX, has_before: ca.SX) -> ca.SX:
    """From the middle of the step before to the middle of this one; the length of the first step itself."""
    return has_before * (h0 + h1) / 2.0 + (1.0 - has_before) * h1
