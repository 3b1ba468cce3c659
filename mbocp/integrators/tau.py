"""The schemes of `mbocp.integrators.euler`, as numbers."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

# Appendix B: where in its step a scheme looks at state and forces.
TAU: Mapping[str, float] = MappingProxyType(
    {"se1": 1.0, "se2": 0.0, "midpoint": 0.5, "semi_implicit_euler": 0.0}
)
# Where in its step the velocity is that the configuration moves with.
VELOCITY_TAU: Mapping[str, float] = MappingProxyType({**TAU, "semi_implicit_euler": 1.0})
EULER_SCHEMES = tuple(TAU)
