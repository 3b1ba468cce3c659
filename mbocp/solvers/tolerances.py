"""The tolerance that solvers share."""

from __future__ import annotations

SOLVER_TOLERANCE = 1e-9  # of residual and increment, unless the problem says otherwise: the paper's
