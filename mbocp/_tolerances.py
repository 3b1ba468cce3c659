"""Tolerances of mechanics and problems that mean the same wherever they are asked for."""

from __future__ import annotations

RANK_TOLERANCE = 1e-9  # singular values below this part of the largest count as zero: rows depend
ARRIVAL_TOLERANCE = 1e-6  # [rad, m] from the configuration that a search or a closed path was to reach
STAYS = 1e-9  # [rad, m] that an impact may move by: the round-off of its row
BOUND_TOLERANCE = 1e-9  # [m, rad, m/s, rad/s] by which a start may miss its bound
DIRECTION_TOLERANCE = 1e-9  # relative, of drives: their columns are sums of products of a few rotations
# By which path constraints may be left between nodes: what arms are exact by on a path [m, rad], ...
PATH_TOLERANCES = {"m": 5e-4, "rad": 5e-3}
PATH_TOLERANCE_PART = 0.01  # ... and a part of a limit of another unit
